"""The position of the cursor in a document, even if the text cannot be parsed."""
