"""Robots: grippers measured on their models, and arms solved by inverse kinematics."""
