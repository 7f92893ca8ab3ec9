"""A sketch of a scene: where everything is and how large, read off the text in plain Python.

Boxes, balls, cylinders, capsules, lathes, prisms and assets of these are as exact as in the simulators; a mesh is its
convex hull. The height of what has a ``place`` is found by lowering it onto its carrier alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from simfoundry.assets.errors import MeshError
from simfoundry.lint.frames import WORLD, Frame, about, frame_of, looking, turned
from simfoundry.lint.placing import place_all
from simfoundry.lint.solids import Solid, hull_of_points, solid_of
from simfoundry.lint.things import Limb, Thing, Turn
from simfoundry.spec.files import is_document
from simfoundry.spec.loaded import Loaded
from simfoundry.spec.models.base import BodySpec, PoseSpec
from simfoundry.spec.models.place import Place
from simfoundry.spec.models.positions import Written, position
from simfoundry.spec.models.scene import CameraSpec, ObjectSpec, SceneSpec

if TYPE_CHECKING:
    from simfoundry.spec.models.asset import AssetSpec, JointSpec
    from simfoundry.spec.models.task import Start

NEARLY_CONVEX = 0.90
"""A mesh that fills this share of its hull collides as its hull; as in :mod:`simfoundry.assets.convex`."""


class Eye(NamedTuple):
    """A camera: its spec and its pose in the world (x right, y down, z forward)."""

    spec: CameraSpec
    X_WC: Frame


class Sketch(NamedTuple):
    """What is where: things by name, and the cameras that no robot carries."""

    spec: SceneSpec
    things: Mapping[str, Thing]
    eyes: Mapping[str, Eye]
    viewer: Frame


class Changes(NamedTuple):
    """Where objects are other than the scene says."""

    place: Mapping[str, Place]
    pose: Mapping[str, Frame]
    joints: Mapping[str, Mapping[str, Written]]

    @classmethod
    def of(cls, *starts: Start | None) -> Changes:
        """What starts say, the later on top of the earlier."""
        place, pose, joints = dict[str, Place](), dict[str, Frame](), dict[str, dict[str, Written]]()
        for start in starts:
            if start is None:
                continue
            for name in (*start.place, *start.pose):
                place.pop(name, None)
                pose.pop(name, None)
            place |= start.place
            pose |= {name: frame_of(p) for name, p in start.pose.items()}
            for name, positions in start.joints.items():
                joints[name] = joints.get(name, {}) | dict(positions)
        return cls(place, pose, joints)


UNCHANGED = Changes({}, {}, {})


def sketch(loaded: Loaded, changes: Changes = UNCHANGED) -> Sketch:
    """The sketch of a scene document without errors."""
    spec = loaded.spec
    assert isinstance(spec, SceneSpec)
    standing: dict[str, Thing] = {}
    places: dict[str, Place] = {}
    assets: dict[tuple[str, tuple[tuple[str, float, Frame], ...]], dict[str, Limb]] = {}
    for name, item in spec.objects.items():
        X_WO = changes.pose.get(name)
        place = changes.place.get(name, item.place if X_WO is None else None)
        if place is not None:
            places[name] = place
        limbs, joints = _limbs(loaded, item, changes.joints.get(name, {}), assets)
        standing[name] = Thing(name, item.fixed, X_WO or frame_of(item.pose), limbs, joints)
    viewer = _viewer(spec, standing)
    things = place_all(standing, places, viewer) if places else standing
    eyes = {name: Eye(c, X) for name, c in spec.cameras.items() if (X := _eye(c, things)) is not None}
    return Sketch(spec, things, eyes, viewer)


# -- cameras and the viewpoint --------------------------------------------------------------------------------------


def _eye(camera: CameraSpec, things: Mapping[str, Thing]) -> Frame | None:
    """The pose of a camera in the world; None for one that rides on a robot."""
    own = camera.pose
    if own.look_at is not None:
        X_MC = looking(own.xyz, own.look_at)
    else:
        X_MC = Frame(turned(own.quat_wxyz or (1.0, 0.0, 0.0, 0.0)), own.xyz)
    if camera.mount is None:
        return X_MC
    carrier, _, link = camera.mount.partition(".")
    return things[carrier].limb_frame(link) @ X_MC if carrier in things else None


def _viewer(spec: SceneSpec, things: Mapping[str, Thing]) -> Frame:
    """A frame with x away from whom left and right are seen by, and y to its left; both are level."""
    camera = spec.cameras.get(spec.viewpoint or "")
    mount = "" if camera is None else (camera.mount or "").partition(".")[0]
    robot = spec.robots.get(mount or spec.viewpoint or "")  # what a robot carries is seen as the robot sees it
    if robot is not None:
        x, y, _ = frame_of(robot.pose).axis(0)
    elif camera is not None and not mount:
        X_WC = _eye(camera, things)
        if X_WC is None:
            return WORLD
        forward, down = X_WC.axis(2), X_WC.axis(1)
        x, y = forward[:2] if math.hypot(*forward[:2]) > 1e-6 else (-down[0], -down[1])
    else:
        return WORLD
    length = math.hypot(x, y)
    if length < 1e-6:
        return WORLD
    x, y = x / length, y / length
    return Frame((x, -y, 0.0, y, x, 0.0, 0.0, 0.0, 1.0))


# -- objects --------------------------------------------------------------------------------------------------------


def _limbs(
    loaded: Loaded,
    item: ObjectSpec,
    start: Mapping[str, Written],
    assets: dict[tuple[str, tuple[tuple[str, float, Frame], ...]], dict[str, Limb]],
) -> tuple[Mapping[str, Limb], Mapping[str, Turn]]:
    """The links of an object by name, and its joints; many objects may be made of one asset."""
    if item.shape is not None:
        return {"base": Limb(WORLD, ((solid_of(item.shape), WORLD),), item.collision != "none")}, {}
    reference = item.asset or ""
    used = loaded.used(reference) if is_document(reference) else None
    if used is None:
        mesh = _mesh(loaded.file(reference), item.scale, item)
        return {"base": Limb(WORLD, tuple((solid, WORLD) for solid in mesh), item.collision != "none")}, {}
    from simfoundry.spec.models.asset import AssetSpec

    assert isinstance(used.spec, AssetSpec)
    given = {**item.joints, **start}
    joints = {n: _turn(j, position(used.spec, n, given), given.get(n)) for n, j in used.spec.joints.items()}
    key = (str(used.path), tuple((n, turn.position, turn.motion) for n, turn in joints.items()))
    if key not in assets:
        assets[key] = dict(_links(used, used.spec, joints))
    return assets[key], {n: turn for n, turn in joints.items() if used.spec.joints[n].type != "fixed"}


def _turn(joint: JointSpec, value: float, written: Written | None) -> Turn:
    limits = joint.limits
    if joint.limits_deg is not None:
        limits = (math.radians(joint.limits_deg[0]), math.radians(joint.limits_deg[1]))
    return Turn(
        value, limits, joint.child, frame_of(written) if isinstance(written, PoseSpec) else WORLD, joint.closed or ""
    )


def _links(asset: Loaded, spec: AssetSpec, joints: Mapping[str, Turn]) -> Iterator[tuple[str, Limb]]:
    """The links of an asset from the root outwards, at the positions of its joints."""
    frames = {next(iter(spec.links)): WORLD}
    todo = list(frames)
    while todo:
        name = todo.pop()
        link = spec.links[name]
        solids: list[tuple[Solid, Frame]] = []
        for part in link.parts.values():
            if part.use == "visual":
                continue
            X_LP = frame_of(part.pose)
            if part.shape is not None:
                solids.append((solid_of(part.shape), X_LP))
            else:
                solids += [(solid, X_LP) for solid in _mesh(asset.file(part.mesh or ""), part.scale, link)]
        yield name, Limb(frames[name], tuple(solids), link.collision != "none")
        for joint_name, joint in spec.joints.items():
            if joint.parent == name and joint.child not in frames:
                moved = joints[joint_name].motion @ _motion(joint, joints[joint_name].position)
                frames[joint.child] = frames[name] @ frame_of(joint.pose) @ moved
                todo.append(joint.child)


def _motion(joint: JointSpec, position: float) -> Frame:
    if joint.type == "fixed" or position == 0:
        return WORLD
    if joint.type == "prismatic":
        length = math.hypot(*joint.axis)
        x, y, z = (v / length * position for v in joint.axis)
        return Frame(p=(x, y, z))
    return Frame(about(joint.axis, position))


def _mesh(file: Path, scale: float, body: BodySpec) -> tuple[Solid, ...]:
    """A mesh as its hull; nothing where it cannot be used, which is another finding."""
    from simfoundry.assets.mesh_summary import mesh_facts

    try:
        facts = mesh_facts(file)
    except MeshError:
        return ()
    if not facts.hull:
        return ()
    filled = facts.volume / facts.hull_volume if facts.hull_volume > 0 else 0.0
    sure = body.collision == "hull" or (not facts.gaps and filled >= NEARLY_CONVEX)
    return (hull_of_points(facts.hull, scale, sure),)
