"""Small scenes, built by hand, that exercise every field of :class:`Scene`: rotations and inertias without symmetry,
centers of mass and colliders away from their frames, joints with limits, damping, friction and non-zero positions."""

from __future__ import annotations

import math
import struct
import zlib

import numpy as np

from simfoundry.geometry.frames import Array, Pose, frozen_array, look_at, quat_from_rpy
from simfoundry.geometry.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Geometry, Mesh, Primitive, Sphere
from simfoundry.scene.model import (
    Camera,
    Collider,
    Joint,
    JointType,
    Light,
    LightType,
    Link,
    Relation,
    Scene,
    SceneObject,
    Visual,
)

GRAVITY = frozen_array([0.0, 0.0, -9.81])


def pose(x: float, y: float, z: float, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> Pose:
    """A pose from a position [m] and fixed-axis angles [rad]."""
    return Pose.of([x, y, z], quat_from_rpy(roll, pitch, yaw))


def rgba(r: float, g: float, b: float, a: float = 1.0) -> Array:
    return frozen_array([r, g, b, a], (4,))


def box(x: float, y: float, z: float) -> Box:
    return Box(frozen_array([x, y, z], (3,)))


def checker_png(cells: int = 4, cell: int = 4) -> bytes:
    """A small RGB checkerboard whose first cell is red, so that a flipped texture shows."""
    side = cells * cell
    pixels = np.zeros((side, side, 3), dtype=np.uint8)
    grid = (np.arange(side) // cell)[:, None] + (np.arange(side) // cell)[None, :]
    pixels[grid % 2 == 0] = (230, 200, 120)
    pixels[:cell, :cell] = (255, 0, 0)
    rows = b"".join(b"\x00" + row.tobytes() for row in pixels)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows, 9)) + chunk(b"IEND", b"")


def wedge_mesh(x: float, y: float, z: float, shift: float = 0.0, textured: bool = False) -> Mesh:
    """A ramp-shaped convex prism of extents ``x, y, z`` [m], its low edge at +x; its frame is not at its centroid."""
    vertices = [[0, 0, 0], [x, 0, 0], [0, y, 0], [x, y, 0], [0, 0, z], [0, y, z]]
    offset = np.array([shift, 0.3 * shift, 0.0])
    faces = [[0, 2, 1], [1, 2, 3], [0, 4, 2], [2, 4, 5], [0, 1, 4], [2, 5, 3], [1, 3, 4], [3, 5, 4]]
    uv = [[0, 0], [1, 0], [0, 0.5], [1, 0.5], [0, 1], [0.25, 1]]
    return Mesh(
        vertices=frozen_array(np.array(vertices) + offset),
        faces=np.array(faces, dtype=np.int32),
        uv=frozen_array(uv) if textured else None,
        texture=checker_png() if textured else None,
    )


def skewed_inertia(a: float, b: float, c: float, *rpy: float) -> Array:
    """An inertia with principal moments ``a, b, c`` [kg m^2] about axes turned by roll, pitch, yaw [rad]."""
    rotation = pose(0, 0, 0, *rpy).rotation
    inertia = rotation @ np.diag([a, b, c]) @ rotation.T
    return frozen_array((inertia + inertia.T) / 2)


def primitive_inertia(shape: Primitive, mass: float) -> Array:
    """Inertia of a solid primitive about its center [kg m^2], shape (3, 3)."""
    match shape:
        case Box(size=size):
            x, y, z = size
            moments = mass / 12 * np.array([y * y + z * z, x * x + z * z, x * x + y * y])
        case Sphere(radius=r):
            moments = np.full(3, 0.4 * mass * r * r)
        case Cylinder(radius=r, height=h):
            side = mass * (3 * r * r + h * h) / 12
            moments = np.array([side, side, mass * r * r / 2])
        case Ellipsoid(radii=radii):
            moments = mass / 5 * np.sum(radii**2) - mass / 5 * radii**2
        case Cone(radius=r, height=h):
            side = mass * (4 * r * r + h * h) * 3 / 80 + mass * h * h / 16
            moments = np.array([side, side, 0.3 * mass * r * r])
        case Capsule(radius=r, height=h):
            volumes = np.array([math.pi * r * r * h, 4 / 3 * math.pi * r**3])
            tube, caps = mass * volumes / volumes.sum()
            side = tube * (3 * r * r + h * h) / 12 + caps * (0.4 * r * r + h * h / 4 + 3 * h * r / 8)
            moments = np.array([side, side, tube * r * r / 2 + caps * 0.4 * r * r])
    return frozen_array(np.diag(moments))


def solid(
    name: str,
    shape: Primitive,
    X_WO: Pose,
    *,
    mass: float = 0.2,
    friction: float = 0.5,
    restitution: float = 0.0,
    fixed: bool = False,
    color: Array | None = None,
) -> SceneObject:
    """An object of one link that is one solid primitive, centered on its frame."""
    link = Link(
        name="body",
        mass=mass,
        com=frozen_array([0, 0, 0]),
        inertia=primitive_inertia(shape, mass),
        visuals=(Visual("shape", shape, rgba(0.6, 0.5, 0.4) if color is None else color),),
        colliders=(Collider("shape", shape, friction, restitution),),
    )
    return SceneObject(name, category=name, fixed=fixed, X_WO=X_WO, links=(link,))


def scene_of(*objects: SceneObject, name: str = "small", gravity: Array = GRAVITY) -> Scene:
    return Scene(name=name, gravity=gravity, objects=objects)


def primitives_scene() -> Scene:
    """A fixed table with one free object of each primitive, apart from each other, with one friction everywhere."""
    return scene_of(
        solid("table", box(1.4, 0.7, 0.04), pose(0.45, 0, -0.02, yaw=0.1), mass=27.44, fixed=True),
        solid("crate", box(0.08, 0.06, 0.05), pose(0.3, 0.1, 0.025, yaw=0.7), mass=0.1),
        solid("ball", Sphere(0.03), pose(0.5, 0.15, 0.03, 0.3, -0.4, 0.9), mass=0.05),
        solid("can", Cylinder(0.03, 0.11), pose(0.5, -0.15, 0.055, yaw=-0.6), mass=0.35),
        solid("pill", Capsule(0.02, 0.06), pose(0.7, 0.05, 0.02, math.pi / 2, 0.0, 0.4), mass=0.08),
        name="primitives",
    )


def textured_object() -> SceneObject:
    """A free link with a textured visual mesh, two convex colliders and a primitive, all away from the link frame."""
    link = Link(
        name="body",
        mass=0.31,
        com=frozen_array([0.021, -0.013, 0.034]),
        inertia=skewed_inertia(4.1e-4, 6.3e-4, 7.9e-4, 0.4, -0.7, 1.1),
        visuals=(
            Visual("skin", wedge_mesh(0.10, 0.06, 0.05, textured=True), rgba(0.9, 0.9, 1.0), pose(-0.03, 0.01, 0.0)),
            Visual("knob", Sphere(0.012), rgba(0.1, 0.2, 0.8, 0.5), pose(0.02, 0.0, 0.06, 0.2, 0.3, 0.5)),
        ),
        colliders=(
            Collider("ramp", wedge_mesh(0.10, 0.06, 0.05), 0.35, 0.1, pose(-0.03, 0.01, 0.0, 0.0, 0.0, 0.2)),
            Collider("heel", wedge_mesh(0.03, 0.05, 0.02, shift=0.01), 0.35, 0.1, pose(-0.05, 0.0, 0.01, 0.3, 0.2, 1)),
            Collider("knob", Sphere(0.012), 0.6, 0.1, pose(0.02, 0.0, 0.06)),
        ),
    )
    return SceneObject("wedge", "door_stop", False, pose(0.3, -0.2, 0.12, 0.5, -0.3, 2.1), (link,))


def _part(name: str, shape: Geometry, X_LG: Pose, friction: float) -> tuple[Visual, Collider]:
    return Visual(name, shape, rgba(0.7, 0.55, 0.35), X_LG), Collider(name, shape, friction, 0.0, X_LG)


def _cabinet_carcass() -> Link:
    """The carcass of :func:`cabinet`: 0.40 x 0.50 x 0.60 m, open toward -x, its frame at the middle of its floor."""
    walls = {
        "floor": (box(0.40, 0.50, 0.02), pose(0, 0, 0.01)),
        "roof": (box(0.40, 0.50, 0.02), pose(0, 0, 0.59)),
        "back": (box(0.02, 0.50, 0.56), pose(0.19, 0, 0.30)),
        "left": (box(0.38, 0.02, 0.56), pose(-0.01, 0.24, 0.30)),
        "right": (box(0.38, 0.02, 0.56), pose(-0.01, -0.24, 0.30)),
    }
    parts = [_part(name, shape, X_LG, 0.4) for name, (shape, X_LG) in walls.items()]
    return Link(
        name="carcass",
        mass=12.5,
        com=frozen_array([0.02, 0.003, 0.31]),
        inertia=skewed_inertia(0.61, 0.52, 0.47, 0.05, 0.1, -0.2),
        visuals=tuple(v for v, _ in parts),
        colliders=tuple(c for _, c in parts),
    )


def cabinet(fixed: bool = True) -> SceneObject:
    """A cabinet with a sliding drawer, a hinged door and a handle welded to the door; both joints stand open."""
    tray = _part("tray", box(0.34, 0.44, 0.20), pose(0.01, 0.0, 0.002, 0.0, 0.0, 0.0), 0.4)
    panel = _part("panel", box(0.44, 0.30, 0.02), pose(0.22, 0.15, 0.0), 0.4)
    grip = _part("grip", Capsule(0.008, 0.08), pose(0.0, 0.0, 0.01, 0.6, 0.2, 0.1), 0.8)
    drawer = Link("drawer", 1.7, frozen_array([0.011, -0.004, -0.02]),
                  skewed_inertia(0.021, 0.017, 0.031, 0.2, 0.1, 0.3), tray[:1], tray[1:])  # fmt: skip
    door = Link("door", 0.9, frozen_array([0.21, 0.15, 0.001]),
                skewed_inertia(0.0068, 0.0145, 0.0212, 0.02, -0.03, 0.04), panel[:1], panel[1:])  # fmt: skip
    handle = Link("handle", 0.07, frozen_array([0.001, 0.002, 0.012]),
                  skewed_inertia(4e-5, 3.8e-5, 9e-6, 0.5, 0.2, 0.1), grip[:1], grip[1:])  # fmt: skip
    # The drawer's frame is turned half a turn, so that it opens along its own +x, which is the cabinet's -x.
    slide = Joint(
        "slide", JointType.PRISMATIC, "carcass", "drawer", pose(-0.02, 0, 0.14, yaw=math.pi),
        frozen_array([1.0, 0.0, 0.0]), limits=(0.0, 0.28), damping=4.0, friction=1.5, armature=0.05, position=0.07,
    )  # fmt: skip
    # The door's frame stands on its right edge: x runs up, y across the opening, and it turns about an axis in between
    # the coordinate axes by a little, as hinges fitted to a picture do.
    hinge_axis = np.array([1.0, 0.02, -0.05])
    hinge = Joint(
        "hinge", JointType.REVOLUTE, "carcass", "door", pose(-0.22, -0.23, 0.30, 0.0, -math.pi / 2, 0.03),
        frozen_array(hinge_axis / np.linalg.norm(hinge_axis)), limits=(-0.1, 1.9), damping=0.12, friction=0.06,
        armature=0.002, position=0.6,
    )  # fmt: skip
    weld = Joint(
        "weld", JointType.FIXED, "door", "handle", pose(0.2, 0.26, 0.02, 0.1, 0.2, -0.3), frozen_array([0.0, 0.0, 1.0])
    )
    X_WO = pose(1.3, 0.4, 0.01, 0.02, -0.03, 0.8)
    return SceneObject("cabinet", "cabinet", fixed, X_WO, (_cabinet_carcass(), drawer, door, handle),
                       (slide, hinge, weld))  # fmt: skip


def fan() -> SceneObject:
    """A free-standing object with a continuous joint, whose root frame is far from its center of mass."""
    post = _part("post", Cylinder(0.02, 0.2), pose(0.05, 0.02, 0.1), 0.5)
    blade = _part("blade", box(0.16, 0.02, 0.004), pose(0.01, 0.0, 0.0, 0.3, 0.0, 0.0), 0.5)
    base = Link("base", 0.8, frozen_array([0.05, 0.021, 0.06]), skewed_inertia(0.0031, 0.0034, 0.0012, 0.1, 0.2, 0.3),
                post[:1], post[1:])  # fmt: skip
    rotor = Link("rotor", 0.06, frozen_array([0.003, 0.001, 0.0]),
                 skewed_inertia(2.2e-6, 1.29e-4, 1.3e-4, 0.1, 0.05, 0.2), blade[:1], blade[1:])  # fmt: skip
    axis = np.array([0.1, 0.95, 0.2])
    spin = Joint("spin", JointType.CONTINUOUS, "base", "rotor", pose(0.05, -0.03, 0.19, 0.2, 0.1, -0.3),
                 frozen_array(axis / np.linalg.norm(axis)), damping=0.0004, friction=0.0002, position=2.3)  # fmt: skip
    return SceneObject("fan", "fan", False, pose(-0.5, 0.3, 0.4, 0.3, 0.7, -1.2), (base, rotor), (spin,))


def cameras() -> tuple[Camera, ...]:
    """Two cameras with unequal focal lengths and principal points away from the middle of the picture."""
    eye = look_at(np.array([0.1, 0.9, 0.6]), np.array([0.45, 0.0, 0.0]))
    side = look_at(np.array([-0.4, -0.5, 0.3]), np.array([0.5, 0.1, 0.1]))
    return (
        Camera("exterior_left", 1280, 720, 733.0, 731.5, 648.25, 351.75, eye),
        Camera("side", 640, 480, 612.0, 598.0, 300.5, 251.0, side),
    )


def lights() -> tuple[Light, ...]:
    """One light of each kind."""
    return (
        Light("sun", LightType.DISTANT, 0.6, frozen_array([1.0, 0.95, 0.9]), pose(0, 0, 3, 0.4, -0.3, 0.2)),
        Light("lamp", LightType.POINT, 0.3, frozen_array([1.0, 0.8, 0.6]), pose(0.2, 0.4, 1.1)),
        Light("sky", LightType.DOME, 0.2, frozen_array([0.8, 0.9, 1.0]), pose(0, 0, 0)),
    )


def full_scene() -> Scene:
    """Everything at once: primitives, a textured mesh, articulated objects, cameras, lights, mixed frictions."""
    base = primitives_scene()
    slippery = solid("puck", Cylinder(0.04, 0.02), pose(0.8, -0.2, 0.01, yaw=1.0), friction=0.1, restitution=0.4)
    return Scene(
        name="full",
        gravity=GRAVITY,
        objects=(*base.objects, slippery, textured_object(), cabinet(), fan()),
        cameras=cameras(),
        lights=lights(),
        relations=(Relation("OnTop", ("crate", "table")), Relation("Open", ("cabinet.slide",))),
    )


def all_scenes() -> dict[str, Scene]:
    """Every scene of this module by name; a free cabinet besides, as a moving articulated root."""
    free_cabinet = scene_of(cabinet(fixed=False), name="free_cabinet", gravity=frozen_array([0.3, -0.2, -9.7]))
    textured = scene_of(textured_object(), name="textured")
    scenes = (primitives_scene(), textured, free_cabinet, scene_of(fan(), name="fan"), full_scene())
    return {scene.name: scene for scene in scenes}
