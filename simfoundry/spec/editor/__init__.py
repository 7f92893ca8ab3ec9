"""Support for writing documents: JSON Schemas, snippets, templates, and the reference page."""
