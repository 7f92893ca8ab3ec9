"""Runs: candidates by number, worker pools, the log, and reports on what was accepted."""
