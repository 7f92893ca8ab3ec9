"""Drafts, the intermediate representation between imported files and documents, in SI units.

Drafts are mutable while a file is being read. They use the names in the file, which
:class:`~simfoundry.frontends.names.NameTable` converts to valid document names.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.names import free_name
from simfoundry.frontends.shapes import PrimitiveShape, Rgba
from simfoundry.geometry.frames import IDENTITY, Array, Pose
from simfoundry.scene.model import Mimic
from simfoundry.spec.models.joint import DriveSpec
from simfoundry.spec.models.robot import GainsSpec, RobotSpec
from simfoundry.spec.models.shapes import BoxShape

# Limit [m] for sliding joints that have no limits: far beyond any table, but small enough for single precision.
UNLIMITED_SLIDE_M = 1000.0

# Size [m] of the box that represents an infinite plane.
#
# Its width and depth are the maximum allowed in documents, and it is thick enough to prevent tunneling.
GROUND = (20.0, 20.0, 0.1)

# The name of a body and the name of one of its links.
LinkPath = tuple[str, str]

# Contact parameters that a file specifies, by material key.
#
# The keys are ``friction``, ``restitution``, ``torsional_friction`` [m] and ``rolling_friction`` [m].
Contact = dict[str, float]


@dataclass(frozen=True)
class ImportOptions:
    """Options for importing a file.

    Attributes:
        packages: Package folders, keyed by package name.
        force: True if existing files may be replaced.
        scene: Scene document for an imported task.
        bound: Scene objects that the user assigned to names in a BDDL task.
        density: Density [kg/m^3] of links without a mass, or None for the density of water, which simulators use by
            default.
    """

    packages: Mapping[str, Path] = field(default_factory=dict)
    force: bool = False
    scene: Path | None = None
    bound: Mapping[str, str] = field(default_factory=dict)
    density: float | None = None


DEFAULTS = ImportOptions()


class ImportNoteKind(StrEnum):
    """Kinds of differences between an imported file and its documents."""

    DROPPED = "dropped"
    CHANGED = "changed"
    ASSUMED = "assumed"


@dataclass(frozen=True)
class ImportNote:
    """A note on an element that could not be imported unchanged.

    ``what`` identifies the element in the file. ``why`` is the reason, which is the same for all similar elements, and
    ``detail`` contains information that is specific to this element.
    """

    kind: ImportNoteKind
    what: str
    why: str
    detail: str = ""

    def to_json(self) -> dict[str, str]:
        """Return a plain mapping for the ``--json`` output."""
        return {key: str(value) for key, value in asdict(self).items() if value}


@dataclass(eq=False)
class MeshDraft:
    """A mesh file with its associated files, such as materials and textures.

    ``files`` maps file names to contents, with the mesh first, and ``scale`` is in meters per unit. ``source`` is the
    original file if its content is unchanged, so a document in the same project can refer to it directly.
    """

    files: dict[str, bytes]
    scale: float = 1.0
    source: Path | None = None


@dataclass(eq=False)
class TextureDraft:
    """The image of a primitive as the content of a PNG file, with its name and the width of one repetition [m]."""

    name: str
    png: bytes
    size: float | None = None


@dataclass(eq=False)
class PartDraft:
    """A part of a link, with its pose in the link frame.

    ``use`` is `both`, `visual` or `collision`. ``texture`` is the image of a primitive; a mesh contains its own.
    """

    name: str
    geometry: PrimitiveShape | MeshDraft
    use: str = "both"
    X_LG: Pose = IDENTITY
    color: Rgba | None = None
    contact: Contact = field(default_factory=dict)
    texture: TextureDraft | None = None
    native: dict[str, Any] = field(default_factory=dict)

    @property
    def collides(self) -> bool:
        """Return True if the part is collision geometry."""
        return self.use != "visual"


@dataclass(eq=False)
class LinkDraft:
    """A rigid body.

    ``mass`` [kg], ``com`` [m] and ``inertia`` [kg m^2] (about the center of mass, in link axes) are None if the file
    does not specify them. A missing mass is computed from ``density`` [kg/m^3] and the parts. ``gravity_compensation``
    is in [0, 1]. ``assumed`` is the source to record in the document for an assumed mass or density, or an empty string
    if the file specifies the value.
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
    gravity_compensation: float = 0.0
    native: dict[str, Any] = field(default_factory=dict)

    @property
    def colliders(self) -> list[PartDraft]:
        """Return the parts that are collision geometry."""
        return [part for part in self.parts if part.collides]


@dataclass(eq=False)
class JointDraft:
    """A joint located at the origin of its child link.

    ``X_PC`` is the pose of the child frame in the parent frame at joint position zero, and ``axis`` is expressed in the
    child frame. ``type`` is fixed, revolute, continuous, prismatic, ball, or free. ``limits`` and ``position`` are in
    radians or meters; the state of a ball or free joint is stored in ``motion`` instead, as the pose of the child frame
    relative to its zero pose. ``effort`` [N m or N] and ``velocity`` [rad/s or m/s] are the largest force and speed, or
    None if they are unlimited. ``closed`` is the limit at which the joint is closed, `lower` or `upper`, or None if the
    file does not specify it.
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
    effort: float | None = None
    velocity: float | None = None
    mimic: Mimic | None = None
    drive: DriveSpec | None = None
    closed: str | None = None
    position: float = 0.0
    motion: Pose = IDENTITY
    native: dict[str, Any] = field(default_factory=dict)


@dataclass(eq=False)
class AttachmentDraft:
    """A site, an actuator or a sensor of a body, with its ``data`` in the words of documents.

    ``place`` is the key that names what it is attached to, which ``target`` names as in the file.
    """

    name: str
    data: dict[str, Any]
    place: str
    target: str


@dataclass(frozen=True, eq=False)
class CompiledName:
    """A reference in native data to an element, which is replaced by the name of the element in the compiled file.

    ``kind`` is body, joint, geom, site, actuator or sensor. ``owner`` is the name of the body draft, and ``element`` is
    the name of the element in the draft, or the part for a geom.
    """

    kind: str
    owner: str
    element: Any


@dataclass(eq=False)
class BodyDraft:
    """An object with one or more links.

    ``root`` is the name of the root link, and ``X_WO`` is the pose of its frame in the world. ``note`` tells users
    where the object came from, and identifies it in tasks that use its original name. ``exact`` is True if all names in
    the body come from a scene and must be kept unchanged.
    """

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
    exact: bool = False
    sites: list[AttachmentDraft] = field(default_factory=list)
    actuators: list[AttachmentDraft] = field(default_factory=list)
    sensors: list[AttachmentDraft] = field(default_factory=list)

    def carrier(self, link: str) -> JointDraft | None:
        """Return the joint that connects a link to its parent, or None if the link is the root."""
        return next((j for j in self.joints if j.child == link), None)

    @property
    def joint_groups(self) -> list[list[JointDraft]]:
        """Return the joints by child. Several joints with the same child are the axes of one joint, in order."""
        return [[j for j in self.joints if j.child == child] for child in dict.fromkeys(j.child for j in self.joints)]

    @property
    def link_order(self) -> list[str]:
        """Return the link names, with the root first."""
        return [self.root, *(name for name in self.links if name != self.root)]


@dataclass(eq=False)
class CameraDraft:
    """A pinhole camera.

    The image size, focal lengths, and principal point are in pixels, and the pose uses OpenCV axes. ``mount`` is the
    body and link to which the camera is attached; the pose is then expressed in the link frame.
    """

    name: str
    size: tuple[int, int]
    fx: float
    fy: float
    X_WC: Pose
    cx: float | None = None
    cy: float | None = None
    mount: LinkPath | None = None


@dataclass(eq=False)
class LightDraft:
    """A light in a scene. ``panorama`` is the file name and the content of the image of a dome light."""

    name: str
    type: str
    intensity: float = 1.0
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    direction: tuple[float, float, float] = (0.0, 0.0, -1.0)
    xyz: tuple[float, float, float] = (0.0, 0.0, 2.0)
    panorama: tuple[str, bytes] | None = None


@dataclass(eq=False)
class RobotDraft:
    """A draft of a known robot, with the pose of its base.

    ``changed`` contains the fields that differ from the model's defaults.
    """

    name: str
    model: str
    X_WB: Pose
    changed: Mapping[str, Any] = field(default_factory=dict)


@dataclass(eq=False)
class ModelDraft:
    """The content of an imported file.

    ``background`` is a visual mesh in the world frame. ``no_contact`` lists pairs of links in different bodies that do
    not collide, and ``notes`` lists all differences between the file and the documents. ``density`` [kg/m^3] applies to
    links without a mass, or is None for the default of the format. ``native`` is what only the file's own format knows
    of the scene, in which case numbers are exact, or None if the importer does not keep such data.
    """

    name: str
    format: str
    bodies: list[BodyDraft] = field(default_factory=list)
    cameras: list[CameraDraft] = field(default_factory=list)
    lights: list[LightDraft] = field(default_factory=list)
    robots: list[RobotDraft] = field(default_factory=list)
    gravity: tuple[float, float, float] | None = None
    relations: list[str] = field(default_factory=list)
    background: MeshDraft | None = None
    no_contact: list[tuple[LinkPath, LinkPath]] = field(default_factory=list)
    notes: list[ImportNote] = field(default_factory=list)
    density: float | None = None
    options: dict[str, Any] = field(default_factory=dict)
    native: dict[str, Any] | None = None

    def dropped(self, what: str, why: str, detail: str = "") -> None:
        """Record an element that is omitted."""
        self.notes.append(ImportNote(ImportNoteKind.DROPPED, what, why, detail))

    def inexpressible(self, what: str, detail: str = "") -> None:
        """Record an element that is omitted because the scene language cannot express it."""
        self.dropped(what, "the scene language cannot express it", detail)

    def changed(self, what: str, why: str, detail: str = "") -> None:
        """Record an element that is expressed differently in the documents than in the file."""
        self.notes.append(ImportNote(ImportNoteKind.CHANGED, what, why, detail))

    def assumed(self, what: str, why: str, detail: str = "") -> None:
        """Record a value that was assumed because the file does not specify it."""
        self.notes.append(ImportNote(ImportNoteKind.ASSUMED, what, why, detail))

    def plane(self, what: str, width: float = 0.0, depth: float = 0.0) -> tuple[BoxShape, Pose]:
        """Return a box that represents a plane, and the pose of the box in the plane frame.

        ``width`` and ``depth`` [m] are the size of the plane, where zero means infinite.
        """
        box = (width or GROUND[0], depth or GROUND[1], GROUND[2])
        self.changed(what, f"the plane is represented by a box of {box[0]:g} x {box[1]:g} m")
        return BoxShape(box=box), Pose.of([0, 0, -GROUND[2] / 2])

    def unlimited_slide(self, what: str) -> tuple[float, float]:
        """Record that a prismatic joint has no limits, and return the limits [m] that are used instead."""
        self.changed(what, f"documents require limits, so the missing limits were set to ±{UNLIMITED_SLIDE_M:g} m")
        return -UNLIMITED_SLIDE_M, UNLIMITED_SLIDE_M

    def free_name(self, wish: str) -> str:
        """Return an unused body name: ``wish``, with a number appended if another body already has that name."""
        return free_name(wish, {body.name for body in self.bodies})


def robot_draft(path: Path, name: str, words: Mapping[str, Any], X_WB: Pose) -> RobotDraft:
    """Return a draft of a robot from a compiled file.

    Args:
        path: File to name in error messages.
        name: Name of the robot.
        words: Data about the robot from the compiled file.
        X_WB: Pose of the robot's base in the world.

    Raises:
        ImportRefusedError: If the data is invalid or the robot model is unknown.
    """
    try:
        spec = RobotSpec.model_validate(words)
    except ValidationError as error:
        message = f"robot `{name}` has invalid data for a compiled file: {error.errors()[0]['msg']}"
        raise ImportRefusedError(path, message) from None
    known = spec.known()
    if known is None or not isinstance(spec.model, str):
        raise ImportRefusedError(path, f"robot `{name}` has an unknown model: {spec.model!r}")
    usual: dict[str, Any] = {"joints": dict(known.home), "gains": GainsSpec().model_dump()}
    usual |= {"reach": known.reach, "opening": known.opening}
    given = spec.model_dump(include=set(usual), exclude_none=True)
    changed = {field: value for field, value in given.items() if value != usual[field] and value != "home"}
    return RobotDraft(name, spec.model, X_WB, changed)
