"""Simulators that hold a scene, behind a common protocol."""

from importlib import import_module

from simfoundry.errors import MissingEngineError, SimfoundryError
from simfoundry.scene.model import Scene
from simfoundry.targets.find import find_target, target_names
from simfoundry.worlds.base import Contact, World


class UnknownWorldError(SimfoundryError):
    """An unknown simulator name; the message lists the valid names."""


def world_names() -> tuple[str, ...]:
    """Return the simulators in which scenes can be run: the targets whose profile names a ``world``."""
    return tuple(name for name in target_names() if find_target(name).profile.world is not None)


def open_world(scene: Scene, engine: str) -> World:
    """Open ``scene`` in the simulator called ``engine``.

    Raises :class:`UnknownWorldError`, or :class:`MissingEngineError`, which explains how to install it.
    """
    module, _, name = find_world(engine).partition(":")
    opened: World = getattr(import_module(module), name)(scene)
    return opened


def find_world(engine: str) -> str:
    """Return the class of the simulator called ``engine``; raise :class:`UnknownWorldError` for any other name."""
    world = find_target(engine).profile.world if engine in target_names() else None
    if world is None:
        raise UnknownWorldError(f"scenes cannot be run in `{engine}`; the simulators are: {', '.join(world_names())}")
    return world


__all__ = ["Contact", "MissingEngineError", "UnknownWorldError", "World", "find_world", "open_world", "world_names"]
