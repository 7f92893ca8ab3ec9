"""The language server behind ``simfoundry lsp``: diagnostics, completion, navigation and edits for editors."""
