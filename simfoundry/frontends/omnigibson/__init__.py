"""The authors' release in: scenes of OmniGibson and their tasks."""
