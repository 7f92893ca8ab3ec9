"""Lints: what a document may say, and what yet will not work; judged on a sketch, without a simulator."""
