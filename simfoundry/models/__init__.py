"""Clients for third-party models, each in a small module that is loaded on demand."""
