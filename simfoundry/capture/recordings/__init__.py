"""Recordings of depth cameras: Record3D, ROS 1 and 2 bags, and those of RealSense cameras."""
