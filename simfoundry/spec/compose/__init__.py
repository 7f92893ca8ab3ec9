"""Composition: documents joined with their bases, and everything that they reuse written out."""
