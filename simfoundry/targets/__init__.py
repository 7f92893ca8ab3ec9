"""Targets: simulators as data. A profile names a backend and says what its simulator does with the files."""
