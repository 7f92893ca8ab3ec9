"""Robots: gripper geometry measured from robot models, and inverse kinematics of arms."""
