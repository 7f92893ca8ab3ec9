"""A tabletop to look at: every primitive, a turned mug of a mesh with a texture, and a drawer that is open."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np

from simfoundry.geometry.frames import Array, Pose, frozen_array, look_at, quat_from_rpy
from simfoundry.geometry.shapes import Box, Capsule, Cylinder, Geometry, Mesh, Primitive, Sphere
from simfoundry.scene.model import Camera, Collider, Joint, JointType, Light, Link, Scene, SceneObject, Visual

INERTIA = frozen_array(np.diag([2e-4, 3e-4, 4e-4]))


def rgba(text: str, alpha: float = 1.0) -> Array:
    return frozen_array([*(int(text[k : k + 2], 16) / 255 for k in (0, 2, 4)), alpha])


def box(x: float, y: float, z: float) -> Box:
    return Box(frozen_array([x, y, z]))


def pose(x: float, y: float, z: float, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> Pose:
    return Pose.of([x, y, z], quat_from_rpy(roll, pitch, yaw))


def link(name: str, parts: Sequence[tuple[Geometry, Array, Pose]], hull: Primitive | None = None) -> Link:
    visuals = tuple(Visual(f"part{k}", shape, color, X_LG) for k, (shape, color, X_LG) in enumerate(parts))
    solids = [(shape, X_LG) for shape, _, X_LG in parts if not isinstance(shape, Mesh)]
    solids = solids if hull is None else [(hull, Pose.of())]
    colliders = tuple(Collider(f"part{k}", shape, 0.5, 0.0, X_LG) for k, (shape, X_LG) in enumerate(solids))
    return Link(name, 0.2, frozen_array([0.0, 0.0, 0.0]), INERTIA, visuals, colliders)


def one(name: str, shape: Geometry, color: Array, X_WO: Pose, fixed: bool = False) -> SceneObject:
    return SceneObject(name, name, fixed, X_WO, (link("body", [(shape, color, Pose.of())]),))


def label_png(width: int = 512, height: int = 256) -> bytes:
    """A label whose four quarters differ, so that a mirrored or turned texture shows."""
    from PIL import Image, ImageDraw, ImageFont

    image = Image.new("RGB", (width, height), (238, 228, 205))
    draw = ImageDraw.Draw(image)
    draw.rectangle([0, 0, width, height // 6], fill=(178, 58, 46))
    draw.rectangle([0, height - height // 8, width, height], fill=(46, 86, 120))
    for k in range(2):
        left = k * width // 2
        draw.text((left + 34, 66), "SOUP", fill=(60, 40, 35), font=ImageFont.load_default(84))
        draw.ellipse([left + 12, 160, left + 42, 190], fill=(214, 160, 50))
    buffer = io.BytesIO()
    image.save(buffer, format="PNG")
    return buffer.getvalue()


def tin(radius: float, height: float, segments: int = 64) -> Mesh:
    """An open tube with its label around it; u runs counter-clockwise seen from above, v up."""
    turn = 2 * np.pi * np.arange(segments + 1) / segments
    ring = np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)
    low = np.column_stack([ring, np.full(segments + 1, -height / 2)])
    high = np.column_stack([ring, np.full(segments + 1, height / 2)])
    u = np.arange(segments + 1) / segments
    uv = np.concatenate([np.column_stack([u, np.zeros_like(u)]), np.column_stack([u, np.ones_like(u)])])
    a, b = np.arange(segments), np.arange(segments) + 1
    c, d = b + segments + 1, a + segments + 1
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]).astype(np.int32)
    return Mesh(frozen_array(np.concatenate([low, high])), faces, frozen_array(uv), label_png())


def cabinet() -> SceneObject:
    wood, front, metal = rgba("8a5a3c"), rgba("a8744f"), rgba("b9bcc2")
    walls = [
        (box(0.20, 0.012, 0.15), wood, pose(0, 0.114, 0)),
        (box(0.20, 0.012, 0.15), wood, pose(0, -0.114, 0)),
        (box(0.20, 0.24, 0.012), wood, pose(0, 0, 0.081)),
        (box(0.20, 0.24, 0.012), wood, pose(0, 0, -0.081)),
        (box(0.012, 0.216, 0.15), wood, pose(0.094, 0, 0)),
    ]
    tray = [
        (box(0.012, 0.212, 0.14), front, pose(-0.094, 0, 0)),
        (box(0.17, 0.206, 0.008), wood, pose(-0.003, 0, -0.06)),
        (box(0.17, 0.008, 0.07), wood, pose(-0.003, 0.099, -0.025)),
        (box(0.17, 0.008, 0.07), wood, pose(-0.003, -0.099, -0.025)),
        (box(0.018, 0.07, 0.012), metal, pose(-0.108, 0, 0.03)),
    ]
    slide = Joint(
        "drawer", JointType.PRISMATIC, "frame", "tray", Pose.of(), frozen_array([-1.0, 0.0, 0.0]), (0.0, 0.16), 1.0
    )
    return SceneObject(
        "cabinet",
        "cabinet",
        True,
        pose(0.72, -0.22, 0.087, yaw=-0.35),
        (link("frame", walls), link("tray", tray)),
        (slide,),
    )


def tabletop(lights: tuple[Light, ...] = ()) -> Scene:
    """Ten objects on a table whose top is z = 0; the drawer is shut and ``cabinet.drawer`` opens it."""
    soup = tin(0.034, 0.10)
    can = link(
        "body",
        [
            (soup, rgba("ffffff"), Pose.of()),
            (Cylinder(0.0335, 0.004), rgba("c6c9ce"), pose(0, 0, 0.048)),
            (Cylinder(0.0335, 0.004), rgba("c6c9ce"), pose(0, 0, -0.048)),
        ],
        Cylinder(0.034, 0.10),
    )
    objects = (
        one("table", box(0.9, 1.2, 0.04), rgba("b89878"), pose(0.5, 0, -0.02), fixed=True),
        cabinet(),
        SceneObject("soup", "can", False, pose(0.52, 0.02, 0.05, yaw=2.6), (can,)),
        one("plate", Cylinder(0.095, 0.012), rgba("e9eef2"), pose(0.42, 0.26, 0.006)),
        one("apple", Sphere(0.036), rgba("b8322a"), pose(0.42, 0.26, 0.048)),
        one("block", box(0.05, 0.05, 0.05), rgba("3f7fb5"), pose(0.34, -0.06, 0.025, yaw=0.6)),
        one("brick", box(0.09, 0.045, 0.03), rgba("e0a93b"), pose(0.36, 0.075, 0.015, yaw=-0.4)),
        one("pill", Capsule(0.018, 0.07), rgba("4c9a6a"), pose(0.37, -0.19, 0.018, 0, np.pi / 2, 0.9)),
        one("jar", Cylinder(0.04, 0.11), rgba("5b4a86"), pose(0.66, 0.17, 0.055)),
        one("lid", Cylinder(0.043, 0.018), rgba("d8d3c8"), pose(0.66, 0.17, 0.119)),
    )
    return Scene("tabletop", frozen_array([0, 0, -9.81]), objects, (front_camera(),), lights)


def front_camera(width: int = 640, height: int = 480) -> Camera:
    """Looks at the table from above the robot."""
    f = 0.95 * width
    return Camera(
        "front",
        width,
        height,
        f,
        f,
        (width - 1) / 2,
        (height - 1) / 2,
        look_at(np.array([-0.28, 0.34, 0.58]), np.array([0.49, 0.0, 0.02])),
    )
