"""Changes to documents: differences, three-way merges, migration and formatting."""
