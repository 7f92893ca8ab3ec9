"""Robots, including gripper geometry measured from robot models, and the inverse kinematics of arms."""
