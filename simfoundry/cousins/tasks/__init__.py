"""Task cousins: other feasible tasks in a scene, proposed from its affordances or by a model, and verified."""
