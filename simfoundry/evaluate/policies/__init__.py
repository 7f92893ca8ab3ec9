"""Policies, in this process or behind a server, that produce actions."""
