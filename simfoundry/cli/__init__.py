"""The ``simfoundry`` command: one module per command, without logic of its own."""
