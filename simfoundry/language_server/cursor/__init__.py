"""Where in a document the cursor is, also in a text that cannot be parsed."""
