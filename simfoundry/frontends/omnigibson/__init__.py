"""Importer of OmniGibson scenes and their tasks from the authors' release."""
