"""The axis `vary` of recipes: values in the scene that are drawn at random."""
