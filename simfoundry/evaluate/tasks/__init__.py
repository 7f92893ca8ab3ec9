"""Tasks prepared for rollouts: lowered scenes, starts of steps, and robots that can act."""
