"""Training: a small flow-matching baseline, and configurations for the trainers of other policies."""
