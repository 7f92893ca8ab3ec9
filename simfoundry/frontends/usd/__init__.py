"""USD importer: any stage as a new document, or a compiled stage back into its document (``compiled``)."""
