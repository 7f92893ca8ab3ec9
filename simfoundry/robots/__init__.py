"""Robots: a YAML file each, what their hands can do, and arms solved by inverse kinematics."""
