"""What ``python -m tests.corpora.captures`` is made of: documents, commands, truth, worlds and the table."""
