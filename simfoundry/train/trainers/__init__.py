"""Training configurations for LeRobot, openpi and GR00T, generated from a built dataset."""
