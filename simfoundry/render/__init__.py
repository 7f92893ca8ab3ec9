"""Pictures of scenes without a display."""
