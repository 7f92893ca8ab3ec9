"""File formats of datasets: LeRobot, robomimic and RLDS, each of which writes and reads."""
