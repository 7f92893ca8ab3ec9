"""Geoms in a scene that are not of its objects: those of robots, whose contacts stay what MuJoCo makes of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.backends.mjcf.restitution import solref
from simfoundry.backends.mjcf.surfaces import Surface
from simfoundry.backends.robot_models.mujoco_robot import read_robot
from simfoundry.geometry.frames import Array
from simfoundry.scene.model import Scene
from simfoundry.scene.robot import mujoco_model

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_SOLIMP = (0.9, 0.95, 0.001, 0.5, 2.0)
"""MuJoCo's own impedance of a contact, which the scene's geoms have."""

_BITS = 31
"""Bits of masks that there are, without the sign."""


@dataclass(frozen=True)
class Guests:
    """Geoms by row: ``masks`` (contype and conaffinity), shape (n, 2); ``priority`` and ``condim``, shape (n,);
    ``friction``, shape (n, 3); whether the contact is as soft as the scene's (``usual``), shape (n,)."""

    masks: Ints = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    priority: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    condim: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    friction: Array = field(default_factory=lambda: np.zeros((0, 3)))
    usual: Bools = field(default_factory=lambda: np.zeros(0, dtype=bool))

    def decide_over(self, surface: Surface) -> bool:
        """Whether all of them make the same contact with a surface of their own priority as with one of a lower.

        The same within 0.4 %, by which other surfaces soften the fingers, whose stiffness has a weight of a thousand.
        """
        if not len(self.priority):
            return True
        least = [surface.friction, surface.spinning, surface.rolling]
        dimensions = 6 if surface.rolling else 4 if surface.spinning else 3
        sliding = self.friction[:, 0] >= least[0]
        resisting = (self.condim >= dimensions) & np.all(self.friction[:, 1:] >= least[1:], axis=1)
        damped = self.usual & (solref(surface.restitution) == solref(0.0))
        return bool(np.all((self.priority > 0) | ((self.priority == 0) & sliding & resisting & damped)))

    def free_bits(self) -> list[int]:
        """Bits of masks that none of them has; none at all where one hears but is not heard by the first bit."""
        if np.any((self.masks[:, 1] & 1 != 0) & (self.masks[:, 0] & 1 == 0)):
            return []
        return [bit for bit in (1 << k for k in range(1, _BITS)) if not np.any(self.masks & bit)]


def guests_of(scene: Scene) -> Guests:
    """The geoms of all robots of a scene that touch anything."""
    models = [
        read_robot(r, native, f"{r.name}.").model for r in scene.robots if (native := mujoco_model(r)) is not None
    ]
    if not models:
        return Guests()
    felt = [(m.geom_contype != 0) | (m.geom_conaffinity != 0) for m in models]

    def rows(values: Iterable[Any]) -> Any:
        return np.concatenate([value[chosen] for value, chosen in zip(values, felt, strict=True)])

    return Guests(
        rows(np.stack([m.geom_contype, m.geom_conaffinity], axis=1) for m in models),
        rows(m.geom_priority for m in models),
        rows(m.geom_condim for m in models),
        rows(m.geom_friction for m in models),
        rows(
            np.all(np.isclose(m.geom_solref, solref(0.0)), axis=1) & np.all(np.isclose(m.geom_solimp, _SOLIMP), axis=1)
            for m in models
        ),
    )
