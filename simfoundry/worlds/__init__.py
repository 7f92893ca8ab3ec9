"""Worlds, which are simulators that run a scene behind a common interface."""

from importlib import import_module

from simfoundry.errors import MissingEngineError, SimfoundryError
from simfoundry.scene.model import Scene
from simfoundry.targets.find import find_target, find_targets, target_names
from simfoundry.worlds.base import Contact, World


class UnknownWorldError(SimfoundryError):
    """Raised if no simulator has the given name. The message lists the valid names."""


def world_names() -> tuple[str, ...]:
    """Return the names of the simulators that can run scenes.

    These are all targets whose profile specifies a ``world`` and can be used.
    """
    return tuple(target.name for target in find_targets(target_names())[0] if target.profile.world is not None)


def open_world(scene: Scene, engine: str) -> World:
    """Open ``scene`` in the simulator called ``engine``.

    Raises:
        UnknownWorldError: If no simulator has this name.
        MissingEngineError: If the simulator is not installed. The message explains how to install it.
    """
    module, _, name = find_world(engine).partition(":")
    opened: World = getattr(import_module(module), name)(scene)
    return opened


def find_world(engine: str) -> str:
    """Return the world class of the simulator called ``engine``.

    Raises:
        UnknownWorldError: If no simulator has this name.
    """
    world = find_target(engine).profile.world if engine in target_names() else None
    if world is None:
        raise UnknownWorldError(f"scenes cannot be run in `{engine}`; available simulators: {', '.join(world_names())}")
    return world


__all__ = ["Contact", "MissingEngineError", "UnknownWorldError", "World", "find_world", "open_world", "world_names"]
