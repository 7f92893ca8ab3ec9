"""Digital cousins: recipes that produce variants of a scene, each of them placed, settled and checked."""
