"""The tasks of foundation models: for each its contract, the protocol that implementations follow, and its client."""
