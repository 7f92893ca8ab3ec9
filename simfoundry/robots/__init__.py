"""Gripper geometry measured from robot models, and inverse kinematics of robot arms."""
