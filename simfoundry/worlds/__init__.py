"""Simulators that hold a scene, behind one protocol."""

from importlib import import_module

from simfoundry.errors import MissingEngineError, SimfoundryError
from simfoundry.scene.model import Scene
from simfoundry.targets.find import find_target, target_names
from simfoundry.worlds.base import Contact, World


class UnknownWorldError(SimfoundryError):
    """A name of no simulator that scenes can be run in here."""


def world_names() -> tuple[str, ...]:
    """The simulators that scenes can be run in: the targets whose profile names a ``world``."""
    return tuple(name for name in target_names() if find_target(name).profile.world is not None)


def open_world(scene: Scene, engine: str) -> World:
    """Open ``scene`` in the simulator called ``engine``.

    Raises :class:`UnknownWorldError`, and :class:`MissingEngineError`, which says how to install it.
    """
    world = _world_class(engine)
    if world is None:
        raise UnknownWorldError(f"no world runs in `{engine}`; there are: {', '.join(world_names())}")
    module, _, name = world.partition(":")
    opened: World = getattr(import_module(module), name)(scene)
    return opened


def is_world(engine: str) -> bool:
    """Return whether scenes can be run in the simulator called ``engine``."""
    return _world_class(engine) is not None


def _world_class(engine: str) -> str | None:
    return find_target(engine).profile.world if engine in target_names() else None


__all__ = ["Contact", "MissingEngineError", "World", "is_world", "open_world", "world_names"]
