"""Help for writing documents: JSON Schemas, snippets, starting files and the reference."""
