"""Three-way merge of documents by meaning."""
