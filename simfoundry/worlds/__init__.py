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
    world = _world_class(engine)
    if world is None:
        raise UnknownWorldError(f"scenes cannot be run in `{engine}`; the simulators are: {', '.join(world_names())}")
    module, _, name = world.partition(":")
    opened: World = getattr(import_module(module), name)(scene)
    return opened


def is_world(engine: str) -> bool:
    """Return true if scenes can be run in the simulator called ``engine``."""
    return _world_class(engine) is not None


def _world_class(engine: str) -> str | None:
    return find_target(engine).profile.world if engine in target_names() else None


__all__ = ["Contact", "MissingEngineError", "World", "is_world", "open_world", "world_names"]
