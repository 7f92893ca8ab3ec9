"""Digital cousins: documents that rewrite documents, each variant placed, settled and checked."""
