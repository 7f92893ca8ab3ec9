"""Semantic three-way merge of documents."""
