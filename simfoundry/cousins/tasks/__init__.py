"""Task cousins, which are other feasible tasks in a scene.

They are derived from the affordances of the scene or proposed by a model, and then verified.
"""
