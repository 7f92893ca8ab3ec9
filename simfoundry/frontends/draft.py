"""Drafts: the intermediate form between imported files and documents, with links, joints, and parts in SI units.

Drafts are mutable while a file is read, and use the names in the file.
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
"""Names of a body and of one of its links."""


@dataclass(frozen=True)
class ImportOptions:
    """Options of an import: package folders by name, and whether existing files are overwritten."""

    packages: Mapping[str, Path] = field(default_factory=dict)
    force: bool = False
    scene: Path | None = None
    """Scene document of an imported task."""
    bound: Mapping[str, str] = field(default_factory=dict)
    """Objects of that scene by their names in a BDDL task."""
    density: float | None = None
    """Density [kg/m^3] of links without a mass; None for the density of water, the default of simulators."""


DEFAULTS = ImportOptions()


class ImportNoteKind(StrEnum):
    """Kinds of differences between the file and the documents."""

    DROPPED = "dropped"
    CHANGED = "changed"
    ASSUMED = "assumed"


@dataclass(frozen=True)
class ImportNote:
    """Element that could not be imported unchanged.

    ``what`` identifies it in the file, ``why`` is the reason, which is the same for all elements of that kind, and
    ``detail`` is specific to this element.
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
    """Mesh file with its associated files.

    ``files`` contains names and bytes, the mesh first; ``scale`` is in meters per unit; ``source`` is the original file
    if it is identical to the first one, so that a document nearby can refer to it directly.
    """

    files: dict[str, bytes]
    scale: float = 1.0
    source: Path | None = None


@dataclass
class ContactDraft:
    """Contact parameters of a part or a link; None if unspecified. ``torsional`` and ``rolling`` are in meters."""

    friction: float | None = None
    restitution: float | None = None
    torsional: float | None = None
    rolling: float | None = None

    def or_else(self, other: ContactDraft) -> ContactDraft:
        """Return these parameters, with unspecified ones taken from ``other``."""
        given = {f.name: value for f in fields(self) if (value := getattr(self, f.name)) is not None}
        return replace(other, **given)


@dataclass(eq=False)
class PartDraft:
    """Part of a link with its pose in the link frame; ``use`` is `both`, `visual` or `collision`."""

    name: str
    geometry: PrimitiveShape | MeshDraft
    use: str = "both"
    X_LG: Pose = IDENTITY
    color: Rgba | None = None
    contact: ContactDraft = field(default_factory=ContactDraft)

    @property
    def collides(self) -> bool:
        """Return True if the part is collision geometry."""
        return self.use != "visual"


@dataclass(eq=False)
class LinkDraft:
    """Rigid body.

    ``mass`` [kg], ``com`` [m] and ``inertia`` [kg m^2] (about the center of mass, in link axes) are None if the file
    does not specify them; the mass then follows from ``density`` [kg/m^3] and the parts.
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
    """Author of an assumed mass or density if the file has none."""

    @property
    def colliders(self) -> list[PartDraft]:
        """Return the parts that are collision geometry."""
        return [part for part in self.parts if part.collides]


@dataclass(eq=False)
class MimicDraft:
    """Mimic joint: its position is ``multiplier`` times the position of its leader, plus ``offset``."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(eq=False)
class DriveDraft:
    """Joint drive: ``stiffness`` and ``damping`` about ``target`` [rad or m], up to ``force_limit`` [N m or N]."""

    stiffness: float = 0.0
    damping: float = 0.0
    target: float | None = None
    force_limit: float | None = None


@dataclass(eq=False)
class JointDraft:
    """Joint at the origin of its child; ``X_PC`` is the child frame in the parent frame at zero, ``axis`` in the child.

    ``type`` is fixed, revolute, continuous, prismatic, ball, or free; ``limits`` are in rad or m; ``closed`` is the
    limit at which the joint is closed, `lower` or `upper`, if the file specifies it.
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
    """State of a ball or free joint: the pose of the child frame relative to its zero pose."""


@dataclass(eq=False)
class BodyDraft:
    """Object with one or more links; ``root`` is the root link, ``X_WO`` the pose of its frame in the world."""

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
    """Note on its origin, for users and for tasks that refer to this name."""
    exact: bool = False
    """True if its names are valid scene names and must be kept unchanged."""

    def carrier(self, link: str) -> JointDraft | None:
        """Return the parent joint of a link."""
        return next((j for j in self.joints if j.child == link), None)

    @property
    def link_order(self) -> list[str]:
        """Return the names of the links, the root first."""
        return [self.root, *(name for name in self.links if name != self.root)]


@dataclass(eq=False)
class CameraDraft:
    """Pinhole camera: size, focal lengths, and principal point [px]; the pose uses the OpenCV axes."""

    name: str
    size: tuple[int, int]
    fx: float
    fy: float
    X_WC: Pose
    cx: float | None = None
    cy: float | None = None
    mount: LinkPath | None = None
    """Body and link to which the camera is attached; its pose is then in the link frame."""


@dataclass(eq=False)
class LightDraft:
    """Light of a scene."""

    name: str
    type: str
    intensity: float = 1.0
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    direction: tuple[float, float, float] = (0.0, 0.0, -1.0)
    xyz: tuple[float, float, float] = (0.0, 0.0, 2.0)


@dataclass(eq=False)
class RobotDraft:
    """Known robot, with the pose of its base and the fields that differ from the defaults."""

    name: str
    model: str
    X_WB: Pose
    changed: Mapping[str, Any] = field(default_factory=dict)


@dataclass(eq=False)
class ModelDraft:
    """Content of one file, with ``notes`` on elements that documents cannot express."""

    name: str
    format: str
    bodies: list[BodyDraft] = field(default_factory=list)
    cameras: list[CameraDraft] = field(default_factory=list)
    lights: list[LightDraft] = field(default_factory=list)
    robots: list[RobotDraft] = field(default_factory=list)
    gravity: tuple[float, float, float] | None = None
    relations: list[str] = field(default_factory=list)
    background: MeshDraft | None = None
    """Visual background, in the world frame."""
    no_contact: list[tuple[LinkPath, LinkPath]] = field(default_factory=list)
    """Pairs of links of different bodies without contact."""
    notes: list[ImportNote] = field(default_factory=list)
    density: float | None = None
    """Density [kg/m^3] that the user sets for links without a mass; None for the default of the format."""

    def dropped(self, what: str, why: str, detail: str = "") -> None:
        """Record an element that is omitted."""
        self.notes.append(ImportNote(ImportNoteKind.DROPPED, what, why, detail))

    def changed(self, what: str, why: str, detail: str = "") -> None:
        """Record an element that is expressed differently than in the file."""
        self.notes.append(ImportNote(ImportNoteKind.CHANGED, what, why, detail))

    def assumed(self, what: str, why: str, detail: str = "") -> None:
        """Record a value that the file does not specify and that is assumed."""
        self.notes.append(ImportNote(ImportNoteKind.ASSUMED, what, why, detail))

    def free_name(self, wish: str) -> str:
        """Return a name for another body: ``wish``, with a number appended if a body already has that name."""
        return free_name(wish, {body.name for body in self.bodies})


def free_name(wish: str, taken: set[str] | list[str]) -> str:
    """Return ``wish``, with a number appended if the name is taken."""
    name, count = wish, 1
    while name in taken:
        count += 1
        name = f"{wish}_{count}"
    return name
