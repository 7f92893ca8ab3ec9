"""Public API for editing documents in place, and for compiling, simulating and judging scenes.

Import it as ``simfoundry``.
"""
