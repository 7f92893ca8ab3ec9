"""The robots whose models lie in the development data."""

from tests.robots.conftest import droid, own_models, robot_data, yam

__all__ = ["droid", "own_models", "robot_data", "yam"]
