"""Ways to reach models: HTTP, a process in another environment, and recorded answers."""
