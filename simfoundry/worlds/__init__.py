"""Simulators that hold a scene, behind one protocol."""

from simfoundry.worlds.base import (
    Contact,
    JointFacts,
    LinkFacts,
    MissingEngineError,
    World,
    read_back,
)
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.pybullet_world import PybulletWorld

__all__ = [
    "Contact",
    "JointFacts",
    "LinkFacts",
    "MissingEngineError",
    "MujocoWorld",
    "PybulletWorld",
    "World",
    "read_back",
]
