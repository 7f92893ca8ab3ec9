"""Files, processes and optional packages: what every other package may rest on."""
