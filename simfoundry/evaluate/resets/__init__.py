"""Initial states of rollouts: the reset grid, object placement, settling, and caching."""
