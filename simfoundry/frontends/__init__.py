"""Importers from other formats to specs: URDF, MJCF, USD, BDDL, and OmniGibson scenes and tasks."""
