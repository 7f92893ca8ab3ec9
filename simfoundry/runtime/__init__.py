"""Files, processes and optional packages: the foundation of all other packages."""
