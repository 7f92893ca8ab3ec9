"""Scene to files: one module a target format, each a pure function."""
