"""Git support: documents at revisions, their history, and an external diff driver."""
