"""Drafts: bodies of links, joints and parts in SI units, between a file that is read and the documents made of it.

Drafts may be changed while a file is read; names are still those of the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.geometry.frames import IDENTITY, Array, Pose
from simfoundry.spec.models.base import BoxShape, CapsuleShape, CylinderShape, SphereShape

PrimitiveShape = BoxShape | SphereShape | CylinderShape | CapsuleShape
Rgba = tuple[float, float, float, float]
LinkPath = tuple[str, str]
"""A body and a link of it, by name."""


@dataclass(frozen=True)
class ImportOptions:
    """Options of an import: folders of packages by name, and whether files that exist are replaced."""

    packages: Mapping[str, Path] = field(default_factory=dict)
    force: bool = False
    scene: Path | None = None
    """The scene document that a task is for."""
    bound: Mapping[str, str] = field(default_factory=dict)
    """Objects of that scene by the names that a task of BDDL has for them."""
    density: float | None = None
    """Density [kg/m^3] of links that state no mass; None for that of water, which simulators take."""


DEFAULTS = ImportOptions()


class ImportNoteKind(StrEnum):
    """Differences between the file and the documents."""

    DROPPED = "dropped"
    CHANGED = "changed"
    ASSUMED = "assumed"


@dataclass(frozen=True)
class ImportNote:
    """One element that could not be taken over unchanged.

    ``what`` names it in the file, ``why`` is the same for everything of that kind, ``detail`` is that of this one.
    """

    kind: ImportNoteKind
    what: str
    why: str
    detail: str = ""

    def to_json(self) -> dict[str, str]:
        """Return a plain mapping for ``--json``."""
        return {key: str(value) for key, value in asdict(self).items() if value}


@dataclass(eq=False)
class MeshDraft:
    """A mesh file with the files that belong to it.

    ``files`` holds name and bytes, the mesh first; ``scale`` [m per unit]; ``source`` is the file that the first of
    them equals, so that a document nearby may name it where it lies.
    """

    files: dict[str, bytes]
    scale: float = 1.0
    source: Path | None = None


@dataclass
class ContactDraft:
    """Contact parameters of a part or a link; None where nothing is stated. ``torsional`` and ``rolling`` in metres."""

    friction: float | None = None
    restitution: float | None = None
    torsional: float | None = None
    rolling: float | None = None

    def or_else(self, other: ContactDraft) -> ContactDraft:
        """Return the parameters of this one, or those of the other where this one says nothing."""
        given = {f.name: value for f in fields(self) if (value := getattr(self, f.name)) is not None}
        return replace(other, **given)


@dataclass(eq=False)
class PartDraft:
    """A piece of a link, posed in it; ``use`` is `both`, `visual` or `collision`."""

    name: str
    geometry: PrimitiveShape | MeshDraft
    use: str = "both"
    X_LG: Pose = IDENTITY
    color: Rgba | None = None
    contact: ContactDraft = field(default_factory=ContactDraft)

    @property
    def collides(self) -> bool:
        """Return whether the part takes part in contact."""
        return self.use != "visual"


@dataclass(eq=False)
class LinkDraft:
    """A rigid body.

    ``mass`` [kg], ``com`` [m] and ``inertia`` [kg m^2], about the centre of mass in link axes, are None where the file
    does not give them; ``density`` [kg/m^3] then weighs the parts.
    """

    name: str
    parts: list[PartDraft] = field(default_factory=list)
    mass: float | None = None
    com: Array | None = None
    inertia: Array | None = None
    density: float | None = None
    contact: ContactDraft = field(default_factory=ContactDraft)
    collision: str = "hull"
    assumed: str = ""
    """Author of an assumed mass or density, where the file gives none."""

    @property
    def colliders(self) -> list[PartDraft]:
        """Return the parts that take part in contact."""
        return [part for part in self.parts if part.collides]


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

    ``type`` is one of fixed, revolute, continuous, prismatic, ball, free; ``limits`` [rad or m]; ``closed`` names the
    limit at which it is closed, `lower` or `upper`, where the file says so.
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
    """The state of a ball or free joint: the pose of the child's frame in its frame at zero."""


@dataclass(eq=False)
class BodyDraft:
    """An object of one or more links, of which ``root`` carries the others; ``X_WO`` is the pose of its frame."""

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
    """Its origin, for people and for tasks that use this name."""
    exact: bool = False
    """True if its names are those of a scene, so that they come through unchanged."""

    def carrier(self, link: str) -> JointDraft | None:
        """Return the joint whose child a link is."""
        return next((j for j in self.joints if j.child == link), None)

    @property
    def link_order(self) -> list[str]:
        """Return the names of the links, the root first."""
        return [self.root, *(name for name in self.links if name != self.root)]


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
    mount: LinkPath | None = None
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
    """A robot that the language knows, with the pose of its base, and the fields that differ from its defaults."""

    name: str
    model: str
    X_WB: Pose
    changed: Mapping[str, Any] = field(default_factory=dict)


@dataclass(eq=False)
class ModelDraft:
    """The content of one file, with ``notes`` on what the language cannot express."""

    name: str
    format: str
    bodies: list[BodyDraft] = field(default_factory=list)
    cameras: list[CameraDraft] = field(default_factory=list)
    lights: list[LightDraft] = field(default_factory=list)
    robots: list[RobotDraft] = field(default_factory=list)
    gravity: tuple[float, float, float] | None = None
    relations: list[str] = field(default_factory=list)
    background: MeshDraft | None = None
    """The visual surroundings, in the frame of the world."""
    no_contact: list[tuple[LinkPath, LinkPath]] = field(default_factory=list)
    """Links of different bodies that pass through each other."""
    notes: list[ImportNote] = field(default_factory=list)
    density: float | None = None
    """Density [kg/m^3] that the user gives to links without a mass; None for that of the format."""

    def dropped(self, what: str, why: str, detail: str = "") -> None:
        """Note something that is left out."""
        self.notes.append(ImportNote(ImportNoteKind.DROPPED, what, why, detail))

    def changed(self, what: str, why: str, detail: str = "") -> None:
        """Note something that is expressed in another way than in the file."""
        self.notes.append(ImportNote(ImportNoteKind.CHANGED, what, why, detail))

    def assumed(self, what: str, why: str, detail: str = "") -> None:
        """Note something that the file does not say, with the value taken for it."""
        self.notes.append(ImportNote(ImportNoteKind.ASSUMED, what, why, detail))

    def free_name(self, wish: str) -> str:
        """Return a name for another body: the wish, with a number behind it where a body has that name."""
        return free_name(wish, {body.name for body in self.bodies})


def free_name(wish: str, taken: set[str] | list[str]) -> str:
    """Return the wish, with a number behind it where the name is taken; the first of several stays without one."""
    name, count = wish, 1
    while name in taken:
        count += 1
        name = f"{wish}_{count}"
    return name
