"""Targets: simulators described as data. A profile names a backend and states what its simulator does with the
files."""
