"""The language: typed documents, their text, and everything that can be wrong with them."""
