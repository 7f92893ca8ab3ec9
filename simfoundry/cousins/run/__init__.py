"""Runs: numbered candidates, worker pools, the log, and reports on accepted cousins."""
