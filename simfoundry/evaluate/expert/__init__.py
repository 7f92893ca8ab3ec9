"""A scripted expert policy: it plans grasps and paths on the true state, and acts through the interface of any
policy.
"""
