"""What the frontends read before it becomes documents: bodies of links, joints and parts, in SI units.

Drafts may be changed while a file is read; names are still those of the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.geometry.frames import IDENTITY, Array, Pose
from simfoundry.spec.models.base import BoxShape, CapsuleShape, CylinderShape, SphereShape

PrimitiveShape = BoxShape | SphereShape | CylinderShape | CapsuleShape
Rgba = tuple[float, float, float, float]
Place = tuple[str, str]
"""A body and a link of it, by name."""


class NoteKind(StrEnum):
    """How what the documents say differs from what the file said."""

    DROPPED = "dropped"
    CHANGED = "changed"
    ASSUMED = "assumed"


@dataclass(frozen=True)
class Note:
    """One thing that could not be taken over as it stood.

    ``what`` it is in the file, ``why``, the same for all things of that kind, and the ``detail`` of this one.
    """

    kind: NoteKind
    what: str
    why: str
    detail: str = ""

    def to_json(self) -> dict[str, str]:
        """A plain mapping for ``--json``."""
        shown = {"kind": str(self.kind), "what": self.what, "why": self.why, "detail": self.detail}
        return {key: value for key, value in shown.items() if value}


@dataclass(eq=False)
class MeshDraft:
    """A mesh file with what belongs to it.

    ``files`` holds name and bytes, the mesh first; ``scale`` [m per unit]; ``source`` is the file that the first of
    them equals, so that a document nearby may name it where it lies.
    """

    files: dict[str, bytes]
    scale: float = 1.0
    source: Path | None = None


@dataclass(eq=False)
class PartDraft:
    """A piece of a link, posed in it; ``use`` is `both`, `visual` or `collision`."""

    name: str
    geometry: PrimitiveShape | MeshDraft
    use: str = "both"
    X_LG: Pose = IDENTITY
    color: Rgba | None = None
    friction: float | None = None
    restitution: float | None = None
    torsional: float | None = None
    rolling: float | None = None
    """Resistance against spinning and rolling [m]."""


@dataclass(eq=False)
class LinkDraft:
    """A rigid body.

    ``mass`` [kg], ``com`` [m] and ``inertia`` [kg m^2], about the centre of mass in link axes, are None where the file
    does not give them; ``density`` [kg/m^3] then weighs the parts. ``frame_only``: it may melt into its neighbour.
    """

    name: str
    parts: list[PartDraft] = field(default_factory=list)
    mass: float | None = None
    com: Array | None = None
    inertia: Array | None = None
    density: float | None = None
    friction: float | None = None
    restitution: float | None = None
    torsional: float | None = None
    rolling: float | None = None
    collision: str = "hull"
    assumed: str = ""
    """Who assumed the mass or density, where the file gives none."""


@dataclass(eq=False)
class MimicDraft:
    """A joint that follows another: ``multiplier`` times its position, plus ``offset``."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(eq=False)
class DriveDraft:
    """A motor: ``stiffness`` and ``damping`` about ``target`` [rad or m], up to ``force_limit`` [N m or N]."""

    stiffness: float = 0.0
    damping: float = 0.0
    target: float | None = None
    force_limit: float | None = None


@dataclass(eq=False)
class JointDraft:
    """A joint at the origin of its child: ``X_PC`` the child's frame in the parent's at zero, ``axis`` in the child's.

    ``type`` is one of fixed, revolute, continuous, prismatic, ball, free; ``limits`` [rad or m]; ``closed`` is the one
    at which it is closed, `lower` or `upper`, where that is said.
    """

    name: str
    type: str
    parent: str
    child: str
    X_PC: Pose = IDENTITY
    axis: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    limits: tuple[float, float] | None = None
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    mimic: MimicDraft | None = None
    drive: DriveDraft | None = None
    closed: str | None = None
    position: float = 0.0
    motion: Pose = IDENTITY
    """The state of a ball or free joint: the pose of the child's frame in where it is at zero."""


@dataclass(eq=False)
class BodyDraft:
    """A thing of one or more links, of which ``root`` carries the others; ``X_WO`` is the pose of its frame."""

    name: str
    root: str
    links: dict[str, LinkDraft]
    joints: list[JointDraft] = field(default_factory=list)
    fixed: bool = False
    X_WO: Pose = IDENTITY
    category: str | None = None
    no_contact: list[tuple[str, str]] = field(default_factory=list)
    labels: tuple[str, ...] = ()
    note: str = ""
    """Where it comes from, for people and for tasks that call it so."""
    exact: bool = False
    """Whether its names are those of a scene, so that they are to come through as they are."""

    def carrier(self, link: str) -> JointDraft | None:
        """The joint whose child a link is."""
        return next((j for j in self.joints if j.child == link), None)


@dataclass(eq=False)
class CameraDraft:
    """A pinhole camera: size [px], focal lengths and principal point [px], pose with OpenCV's axes."""

    name: str
    size: tuple[int, int]
    fx: float
    fy: float
    X_WC: Pose
    cx: float | None = None
    cy: float | None = None
    mount: tuple[str, str] | None = None
    """Body and link that carry it; its pose is then in the link's frame."""


@dataclass(eq=False)
class LightDraft:
    """A light as the language has it."""

    name: str
    type: str
    intensity: float = 1.0
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    direction: tuple[float, float, float] = (0.0, 0.0, -1.0)
    xyz: tuple[float, float, float] = (0.0, 0.0, 2.0)


@dataclass(eq=False)
class RobotDraft:
    """A robot that the language knows, with the pose of its base, and the fields in which it is not as usual."""

    name: str
    model: str
    X_WB: Pose
    changed: Mapping[str, Any] = field(default_factory=dict)


@dataclass(eq=False)
class Draft:
    """All that one file says, and ``notes`` on what it says beyond that."""

    name: str
    format: str
    bodies: list[BodyDraft] = field(default_factory=list)
    cameras: list[CameraDraft] = field(default_factory=list)
    lights: list[LightDraft] = field(default_factory=list)
    robots: list[RobotDraft] = field(default_factory=list)
    gravity: tuple[float, float, float] | None = None
    relations: list[str] = field(default_factory=list)
    background: MeshDraft | None = None
    """What is seen around everything, in the frame of the world."""
    no_contact: list[tuple[Place, Place]] = field(default_factory=list)
    """Links of different bodies that pass through each other."""
    notes: list[Note] = field(default_factory=list)
    description: str = ""
    density: float | None = None
    """Density [kg/m^3] that the user gives to what states no mass; None for what the format takes."""

    def dropped(self, what: str, why: str, detail: str = "") -> None:
        """Note what is left out."""
        self.notes.append(Note(NoteKind.DROPPED, what, why, detail))

    def changed(self, what: str, why: str, detail: str = "") -> None:
        """Note what is said in another way than the file says it."""
        self.notes.append(Note(NoteKind.CHANGED, what, why, detail))

    def assumed(self, what: str, why: str, detail: str = "") -> None:
        """Note what the file does not say, and what is taken for it."""
        self.notes.append(Note(NoteKind.ASSUMED, what, why, detail))
