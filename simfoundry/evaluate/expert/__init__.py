"""A scripted expert policy that plans grasps and paths from the true state and acts like any other policy."""
