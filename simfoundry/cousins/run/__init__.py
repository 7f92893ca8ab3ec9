"""Runs of recipes: numbered candidates, worker pools, the log, and reports on the accepted cousins."""
