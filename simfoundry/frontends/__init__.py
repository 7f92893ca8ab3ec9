"""Importers that convert URDF, MJCF, USD, BDDL and OmniGibson files to SimFoundry documents."""
