"""The files that a reconstruction writes, and the edits that people make in them."""
