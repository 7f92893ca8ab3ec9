"""Policies: in-process and remote sources of actions."""
