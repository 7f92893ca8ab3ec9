"""Trials in a scene that do not change its text: physics, policies and recordings.

Physics and policies run in processes of their own, so that none of them can block or crash the studio.
"""
