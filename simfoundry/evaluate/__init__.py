"""Tasks in worlds: how rollouts start, what policies see and do, and how well they do it."""
