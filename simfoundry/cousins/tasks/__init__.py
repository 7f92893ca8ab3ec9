"""Task cousins: other feasible tasks in a scene, derived from its affordances or proposed by a model, then verified."""
