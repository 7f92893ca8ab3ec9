"""Simulators that hold a scene, behind one protocol."""

from collections.abc import Callable

from simfoundry.errors import MissingEngineError
from simfoundry.scene.model import Scene
from simfoundry.worlds.base import (
    Contact,
    JointFacts,
    LinkFacts,
    World,
    read_back,
)
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.pybullet_world import PybulletWorld

ENGINES: dict[str, Callable[[Scene], World]] = {"mujoco": MujocoWorld, "pybullet": PybulletWorld}


def open_world(scene: Scene, engine: str) -> World:
    """A world of ``scene`` in the simulator called ``engine``; MissingEngineError says how to install it."""
    return ENGINES[engine](scene)


__all__ = [
    "ENGINES",
    "Contact",
    "JointFacts",
    "LinkFacts",
    "MissingEngineError",
    "MujocoWorld",
    "PybulletWorld",
    "World",
    "open_world",
    "read_back",
]
