"""Random valid documents."""

from __future__ import annotations

import math
from typing import Any

from hypothesis import strategies as st

from simfoundry.spec.models.asset import AssetSpec, Inertial, LinkSpec, PartSpec
from simfoundry.spec.models.base import FARTHEST, CameraPose, Estimate, Material, PoseSpec
from simfoundry.spec.models.capture import MAX_FOCAL
from simfoundry.spec.models.joint import DriveSpec, JointSpec, MimicSpec
from simfoundry.spec.models.origin import Origin
from simfoundry.spec.models.reuse import FramedPose
from simfoundry.spec.models.scene import Degrees, ObjectSpec, SceneSpec
from simfoundry.spec.models.shapes import (
    BoxShape,
    CapsuleShape,
    CompoundPart,
    CompoundShape,
    ConeShape,
    CylinderShape,
    EllipsoidShape,
    Lathe,
    LatheShape,
    OpenBox,
    OpenBoxShape,
    Prism,
    PrismShape,
    Round,
    SphereShape,
)
from simfoundry.spec.models.surroundings import CameraSpec, LightSpec

NAMES = st.from_regex(r"[a-z][a-z0-9_]{0,12}", fullmatch=True) | st.sampled_from(
    ["true", "null", "on", "no", "y", "e1"]
)
PART_NAMES = NAMES | st.tuples(NAMES, NAMES).map(".".join)
TEXTS = st.text(st.characters(codec="utf-8"), max_size=60) | st.sampled_from(
    [
        "",
        " ",
        "12",
        "true",
        "a: b",
        "# a",
        "- a",
        "OnTop(a, b)",
        "(",
        "a\n\nb ",
        "\u2028",
        "\x85",
        "\ufeffx",
        "{",
        "*a",
        "...",
    ]
)
NUMBERS = st.floats(-1e4, 1e4) | st.floats(-1e300, 1e300) | st.integers(-99, 99).map(float)
POSITIVE = st.floats(1e-12, 1e4) | st.floats(1e-3, 1e300)
COORDINATES = st.floats(-1e4, 1e4) | st.floats(-FARTHEST, FARTHEST) | st.integers(-99, 99).map(float)
LENGTHS = st.floats(1e-12, 1e4) | st.floats(1e-3, FARTHEST)
FRACTIONS = st.floats(0, 1)
VEC3 = POINT3 = st.tuples(COORDINATES, COORDINATES, COORDINATES)
INERTIAS = st.tuples(*[st.floats(1, 1.9)] * 3, *[st.floats(-0.01, 0.01)] * 3)
COLORS = st.tuples(FRACTIONS, FRACTIONS, FRACTIONS) | st.tuples(FRACTIONS, FRACTIONS, FRACTIONS, FRACTIONS)


def maybe(strategy: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.none() | strategy


def _unit(values: tuple[float, float, float, float]) -> tuple[float, ...]:
    norm = math.hypot(*values)
    return tuple(v / norm for v in values)


QUATERNIONS = st.tuples(*[st.floats(0.1, 1)] * 4).map(_unit)


def _poses(kind: type[PoseSpec], **more: st.SearchStrategy[Any]) -> st.SearchStrategy[PoseSpec]:
    return st.one_of(
        st.builds(kind, xyz=POINT3, **more),
        st.builds(kind, xyz=POINT3, yaw_deg=NUMBERS, **more),
        st.builds(kind, xyz=POINT3, rpy_deg=VEC3, **more),
        st.builds(kind, xyz=POINT3, quat_wxyz=QUATERNIONS, **more),
    )


POSES = _poses(PoseSpec)
FRAMED_POSES = _poses(FramedPose, frame=st.none() | NAMES)
ROUNDS = st.builds(Round, radius=LENGTHS, height=LENGTHS)
PART_SHAPES = st.one_of(
    st.builds(EllipsoidShape, ellipsoid=st.tuples(LENGTHS, LENGTHS, LENGTHS)),
    st.builds(ConeShape, cone=ROUNDS),
    st.builds(
        lambda x, y, z, share: OpenBoxShape(open_box=OpenBox(size=(x, y, z), wall=share * min(x, y, z))),
        *(st.floats(1e-6, FARTHEST),) * 3,
        st.floats(0.01, 0.49),
    ),
    st.builds(BoxShape, box=st.tuples(LENGTHS, LENGTHS, LENGTHS)),
    st.builds(SphereShape, sphere=LENGTHS),
    st.builds(CylinderShape, cylinder=ROUNDS),
    st.builds(CapsuleShape, capsule=ROUNDS),
    st.builds(
        LatheShape,
        lathe=st.builds(
            Lathe, profile=st.lists(st.tuples(st.floats(0, 9), COORDINATES), min_size=3, max_size=30).map(tuple)
        ),
    ),
    st.builds(
        PrismShape,
        prism=st.builds(
            Prism,
            outline=st.lists(st.tuples(COORDINATES, COORDINATES), min_size=3, max_size=30).map(tuple),
            height=LENGTHS,
        ),
    ),
)
SHAPES = PART_SHAPES | st.builds(
    CompoundShape,
    compound=st.dictionaries(
        NAMES,
        st.builds(
            CompoundPart,
            shape=PART_SHAPES,
            pose=POSES,
            material=st.none() | NAMES,
            color=st.none() | COLORS,
        ),
        min_size=1,
        max_size=4,
    ),
)
QUANTITIES = POSITIVE | st.builds(
    lambda low, middle, high, source: Estimate(value=middle, range=(low, high), source=source),
    st.floats(1e-9, 1),
    st.floats(1, 2),
    st.floats(2, 1e6),
    TEXTS,
)
ORIGINS = st.builds(
    Origin, capture=maybe(TEXTS), fit_error=maybe(st.floats(0, 9)), confidence=maybe(FRACTIONS), note=maybe(TEXTS)
)
MATERIALS = st.dictionaries(
    NAMES,
    st.builds(
        Material,
        density=maybe(POSITIVE),
        friction=st.floats(0, 9),
        torsional_friction=st.floats(0, 1),
        rolling_friction=st.floats(0, 1),
        restitution=FRACTIONS,
        color=maybe(COLORS),
    ),
    max_size=3,
)
BODY: dict[str, st.SearchStrategy[Any]] = {
    "material": maybe(NAMES),
    "friction": maybe(st.floats(0, 9)),
    "restitution": maybe(FRACTIONS),
    "color": maybe(COLORS),
    "collision": st.sampled_from(["auto", "hull", "decompose", "none"]),
    "solid": st.sampled_from(["exact", "hull"]),
}
OBJECT = {
    **BODY,
    "visual": maybe(TEXTS),
    "category": maybe(NAMES),
    "fixed": st.booleans(),
    "pose": FRAMED_POSES,
    "joints": st.dictionaries(NAMES, NUMBERS | st.builds(Degrees, deg=NUMBERS) | POSES, max_size=3),
    "origin": maybe(ORIGINS),
}
OBJECTS = st.one_of(
    st.builds(ObjectSpec, shape=SHAPES, mass=maybe(QUANTITIES), **OBJECT),
    st.builds(ObjectSpec, asset=TEXTS, scale=POSITIVE, density=maybe(QUANTITIES), **OBJECT),
)
CAMERA_POSES = st.builds(CameraPose, xyz=POINT3, quat_wxyz=QUATERNIONS) | st.just(
    CameraPose(xyz=(0.1, 0.2, 0.3), look_at=(1.0, 0.0, 0.0))
)
PIXELS = st.integers(1, 8192)
CAMERAS = st.builds(
    CameraSpec,
    size=st.tuples(PIXELS, PIXELS),
    fx=st.floats(1e-12, MAX_FOCAL),
    fy=st.floats(1e-12, MAX_FOCAL),
    cx=maybe(st.floats(-MAX_FOCAL, MAX_FOCAL)),
    cy=maybe(st.floats(-MAX_FOCAL, MAX_FOCAL)),
    pose=CAMERA_POSES,
)
LIGHTS = st.builds(
    LightSpec,
    type=st.sampled_from(["distant", "point", "dome"]),
    intensity=st.floats(0, 1e6),
    color=COLORS,
    direction=st.tuples(COORDINATES, COORDINATES, st.floats(0.1, 1)),
    xyz=POINT3,
)
SCENES = st.builds(
    SceneSpec,
    simfoundry=st.just("scene/1"),
    name=NAMES,
    description=maybe(TEXTS),
    viewpoint=maybe(NAMES),
    gravity=VEC3,
    materials=MATERIALS,
    objects=st.dictionaries(NAMES, OBJECTS, max_size=3),
    cameras=st.dictionaries(NAMES, CAMERAS, max_size=2),
    lights=st.dictionaries(NAMES, LIGHTS, max_size=2),
    no_contact=st.lists(st.tuples(PART_NAMES, PART_NAMES), max_size=3).map(tuple),
    relations=st.lists(TEXTS, max_size=4).map(tuple),
    origin=maybe(ORIGINS),
)
PARTS = st.one_of(
    st.builds(PartSpec, shape=PART_SHAPES, pose=POSES, material=maybe(NAMES), color=maybe(COLORS)),
    st.builds(PartSpec, mesh=TEXTS, scale=POSITIVE, pose=POSES),
)
LINKS = st.builds(
    LinkSpec,
    parts=st.dictionaries(NAMES, PARTS, min_size=1, max_size=2),
    mass=QUANTITIES,
    inertial=maybe(st.builds(Inertial, com=POINT3, inertia=INERTIAS)),
    **BODY,
)
LIMITS = st.tuples(st.floats(-360, -1e-3), st.floats(1e-3, 360))
CLOSED = st.sampled_from([None, "lower", "upper"])
JOINT: dict[str, st.SearchStrategy[Any]] = {
    "parent": NAMES,
    "child": NAMES,
    "pose": POSES,
    "axis": st.tuples(COORDINATES, st.floats(0.1, 1), COORDINATES),
    "damping": st.floats(0, 1e6),
    "friction": st.floats(0, 1e-3),
    "armature": st.floats(0, 9),
}
ONE_AXIS: dict[str, st.SearchStrategy[Any]] = {
    **JOINT,
    "effort": maybe(POSITIVE),
    "mimic": maybe(st.builds(MimicSpec, joint=NAMES, multiplier=NUMBERS, offset=NUMBERS)),
    "drive": maybe(
        st.builds(
            DriveSpec,
            stiffness=st.floats(0, 1e6),
            damping=st.floats(1e-6, 1e6),
            target=maybe(NUMBERS),
            force_limit=maybe(POSITIVE),
        )
    ),
}
JOINTS = st.one_of(
    st.builds(JointSpec, type=st.sampled_from(["fixed", "ball"]), **JOINT),
    st.builds(JointSpec, type=st.just("free"), parent=NAMES, child=NAMES, pose=POSES),
    st.builds(JointSpec, type=st.just("continuous"), velocity_deg=maybe(POSITIVE), **ONE_AXIS),
    st.builds(JointSpec, type=st.just("prismatic"), limits=LIMITS, closed=CLOSED, velocity=maybe(POSITIVE), **ONE_AXIS),
    st.builds(JointSpec, type=st.just("revolute"), limits_deg=LIMITS, closed=CLOSED, **ONE_AXIS),
)
ASSETS = st.builds(
    AssetSpec,
    simfoundry=st.just("asset/1"),
    name=NAMES,
    description=maybe(TEXTS),
    category=maybe(NAMES),
    materials=MATERIALS,
    links=st.dictionaries(NAMES, LINKS, min_size=1, max_size=2),
    joints=st.dictionaries(NAMES, JOINTS, max_size=2),
    no_contact=st.lists(st.tuples(NAMES, NAMES), max_size=3).map(tuple),
    origin=maybe(ORIGINS),
)
