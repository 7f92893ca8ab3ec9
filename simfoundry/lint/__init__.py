"""Lints: what a document says that is allowed, and yet will not work; judged on a sketch, without opening a simulator."""
