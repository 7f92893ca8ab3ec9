"""A scripted policy that cheats: it sees the true state, plans grasps and paths on it, and acts as any policy does."""
