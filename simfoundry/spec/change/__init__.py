"""Changes of documents: differences, three-way merges, migration and formatting."""
