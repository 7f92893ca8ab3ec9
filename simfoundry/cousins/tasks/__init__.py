"""Task cousins: other things that can be done in a scene, proposed from its affordances or by a model, and proved."""
