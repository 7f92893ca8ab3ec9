"""Sites, actuators and sensors, which are attached to links and joints, and data that only one format knows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from simfoundry.geometry.frames import Pose
from simfoundry.geometry.shapes import Mesh

Attributes = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Site:
    """A named frame on a ``link``, with its pose in the link's frame."""

    name: str
    link: str
    X_LS: Pose
    mjcf: Attributes = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Actuator:
    """An actuator of a joint, whose force at the joint is ``gear`` times its own force.

    ``type`` is `motor`, `position` or `velocity`. Gains and ranges are those of the document, and ``control`` is the
    initial control. Ranges are None if they are unlimited.
    """

    name: str
    type: str
    joint: str
    gear: float = 1.0
    kp: float = 0.0
    kv: float = 0.0
    control: float = 0.0
    control_range: tuple[float, float] | None = None
    force_range: tuple[float, float] | None = None
    mjcf: Attributes = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Sensor:
    """A sensor at a site, a joint or a link: ``place`` is one of these words, and ``target`` is the name of it."""

    name: str
    type: str
    place: str
    target: str
    noise: float = 0.0
    cutoff: float = 0.0
    mjcf: Attributes = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class NativeAttributes:
    """The MJCF attributes of an object's elements, by name; those of parts by link and part.

    ``meshes`` contains the whole meshes of parts that collide but are not shown, of which the scene has only hulls.
    """

    links: Mapping[str, Attributes] = field(default_factory=dict)
    joints: Mapping[str, Attributes] = field(default_factory=dict)
    parts: Mapping[tuple[str, str], Attributes] = field(default_factory=dict)
    meshes: dict[tuple[str, str], Mesh] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.links or self.joints or self.parts)


@dataclass(frozen=True)
class Options:
    """Options of the simulation: the time step [s] and the iterations of the solver. None is the target's default."""

    timestep: float | None = None
    solver_iterations: int | None = None
