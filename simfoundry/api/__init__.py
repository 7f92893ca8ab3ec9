"""Public API: documents to edit in place, compile, open and judge. Import it as ``simfoundry``."""
