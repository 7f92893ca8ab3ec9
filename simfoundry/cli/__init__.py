"""The ``simfoundry`` command, with one module for each group of related subcommands."""
