"""Measurement and evaluation of predicates: bodies and states of a scene, terms with margins, and the judge."""
