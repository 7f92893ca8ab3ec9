"""Adapters to third-party models, each in one small module that is loaded on demand."""
