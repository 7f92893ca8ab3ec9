"""The images of a capture: read from files, recordings and other data sets, checked, registered and fused."""
