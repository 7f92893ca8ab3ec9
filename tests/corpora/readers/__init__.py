"""Scripts that load a dataset with a real reader, each in an environment that has only the reader."""
