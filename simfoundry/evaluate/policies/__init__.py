"""Policies that produce actions, either in this process or on a server."""
