"""Drafts: the intermediate form between imported files and documents, with links, joints, and parts in SI units.

Drafts are mutable while a file is read, and use the names in the file; :class:`NameTable` converts them to names of
documents.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.geometry.frames import IDENTITY, Array, Pose
from simfoundry.scene.model import Mimic
from simfoundry.spec.models.asset import DriveSpec
from simfoundry.spec.models.base import WORLD, BoxShape, CapsuleShape, CylinderShape, SphereShape
from simfoundry.spec.models.robot import RobotSpec

LONGEST = 64
"""Largest length of a name in documents."""


def plain_name(text: str, otherwise: str = "thing") -> str:
    """Return the valid document name that is closest to a text."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z][a-z])", "_", text)
    ascii_only = unicodedata.normalize("NFKD", spaced).encode("ascii", "ignore").decode().lower()
    name = re.sub(r"[^a-z0-9]+", "_", ascii_only).strip("_")
    if not name:
        return otherwise
    return (name if name[0].isalpha() else f"{otherwise}_{name}")[:LONGEST].rstrip("_")


class NameTable:
    """Unique names for the elements of one kind; ``renamed`` contains names that had to change.

    The name ``world`` is never used, because formats reserve it for the static world.
    """

    def __init__(self, otherwise: str = "thing") -> None:
        self.otherwise = otherwise
        self.taken: set[str] = {WORLD}
        self.renamed: dict[str, str] = {}

    def name(self, text: str) -> str:
        """Return a unique name for an element called ``text``."""
        plain = plain_name(text, self.otherwise)
        name, count = plain, 1
        while name in self.taken:
            count += 1
            name = f"{plain[: LONGEST - 5]}_{count}"
        self.taken.add(name)
        if name != text:
            self.renamed[text] = name
        return name


UNLIMITED_SLIDE_M = 1000.0
"""Limits [m] that represent none: far beyond any table, and small enough for single precision."""

GROUND = (20.0, 20.0, 0.1)
"""Size [m] of the box that represents an infinite plane, with its top in the plane: the maximum in documents, and thick
enough that nothing tunnels through it."""

PrimitiveShape = BoxShape | SphereShape | CylinderShape | CapsuleShape
Rgba = tuple[float, float, float, float]
LinkPath = tuple[str, str]
"""Names of a body and of one of its links."""

Contact = dict[str, float]
"""Specified contact parameters by their keys in a material: ``friction``, ``restitution``, and ``torsional_friction``
and ``rolling_friction`` [m]."""


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


@dataclass(eq=False)
class PartDraft:
    """Part of a link with its pose in the link frame; ``use`` is `both`, `visual` or `collision`."""

    name: str
    geometry: PrimitiveShape | MeshDraft
    use: str = "both"
    X_LG: Pose = IDENTITY
    color: Rgba | None = None
    contact: Contact = field(default_factory=dict)

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
    contact: Contact = field(default_factory=dict)
    collision: str = "hull"
    assumed: str = ""
    """Author of an assumed mass or density if the file has none."""

    @property
    def colliders(self) -> list[PartDraft]:
        """Return the parts that are collision geometry."""
        return [part for part in self.parts if part.collides]


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
    mimic: Mimic | None = None
    drive: DriveSpec | None = None
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

    def inexpressible(self, what: str, detail: str = "") -> None:
        """Record an element that is omitted because the scene language has no construct for it."""
        self.dropped(what, "the scene language cannot express it", detail)

    def changed(self, what: str, why: str, detail: str = "") -> None:
        """Record an element that is expressed differently than in the file."""
        self.notes.append(ImportNote(ImportNoteKind.CHANGED, what, why, detail))

    def assumed(self, what: str, why: str, detail: str = "") -> None:
        """Record a value that the file does not specify and that is assumed."""
        self.notes.append(ImportNote(ImportNoteKind.ASSUMED, what, why, detail))

    def plane(self, what: str, width: float = 0.0, depth: float = 0.0) -> tuple[BoxShape, Pose]:
        """Return a box that represents a plane, infinite along zero sizes [m], and its pose in the plane's frame."""
        box = (width or GROUND[0], depth or GROUND[1], GROUND[2])
        self.changed(what, f"a box of {box[0]:g} x {box[1]:g} m stands for it")
        return BoxShape(box=box), Pose.of([0, 0, -GROUND[2] / 2])

    def unlimited_slide(self, what: str) -> tuple[float, float]:
        """Return limits [m] for a prismatic joint without limits, because documents require them."""
        self.changed(what, f"it has no limits; {UNLIMITED_SLIDE_M:g} m to either side stand for that")
        return -UNLIMITED_SLIDE_M, UNLIMITED_SLIDE_M

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


def robot_draft(path: Path, name: str, words: Mapping[str, Any], X_WB: Pose) -> RobotDraft:
    """Return a robot with the fields that differ from its model; raises :class:`ImportRefusedError`."""
    try:
        spec = RobotSpec.model_validate(words)
    except ValidationError as error:
        reason = error.errors()[0]["msg"]
        raise ImportRefusedError(path, f"robot `{name}` is not as compiled files have it: {reason}") from None
    known = spec.known()
    if known is None or not isinstance(spec.model, str):
        raise ImportRefusedError(path, f"robot `{name}` is of a kind that is not known: {spec.model!r}")
    usual = {"joints": dict(known.home), "reach": known.reach, "opening": known.opening}
    given = spec.model_dump(include=set(usual), exclude_none=True)
    changed = {field: value for field, value in given.items() if value != usual[field] and value != "home"}
    return RobotDraft(name, spec.model, X_WB, changed)
