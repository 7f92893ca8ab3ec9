"""Tasks as rollouts need them: lowered scenes, starts of steps, robots that can act."""
