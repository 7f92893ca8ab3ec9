"""Read a folder of URDFs compiled by SimFoundry, where ``poses.json`` contains the pose of each object."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.frontends.draft import BodyDraft, ImportOptions, JointDraft, ModelDraft, PartDraft, robot_draft
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.files import read_json
from simfoundry.frontends.urdf.reader import read_urdf
from simfoundry.geometry.frames import Pose
from simfoundry.spec.models.shapes import CapsuleShape, CylinderShape, Round, SphereShape

# Start of notes to omit because they apply to every compiled file.
#
# URDF requires the limits, and the mesh files also refer to the textures.
_ALWAYS_THERE = ("effort limit", "velocity limit", "texture that the URDF")

# Name suffixes of the three pieces that represent a capsule, which URDF does not support.
TUBE, TOP, BOTTOM = "_tube", "_top", "_bottom"

# Tolerance [m] for equal positions; allows for rounding in the file.
SAME_PLACE_M = 1e-9


def is_poses(path: Path) -> bool:
    """Return True if a JSON file contains the poses of compiled URDFs."""
    if path.suffix.lower() != ".json":
        return True
    data = read_json(path)
    entries = list(data.values()) if isinstance(data, dict) else []
    return bool(entries) and all(isinstance(entry, dict) and "urdf" in entry for entry in entries)


def read_poses(path: Path, options: ImportOptions) -> ModelDraft:
    """Read a scene from a ``poses.json`` file and its URDFs.

    Raises:
        ImportRefusedError: If any of these files is invalid.
    """
    draft = ModelDraft(path.parent.name, "URDF")
    free: list[tuple[BodyDraft, Mapping[str, Any]]] = []
    for name, entry in read_json(path).items():
        try:
            if "robot" in entry:
                draft.robots.append(robot_draft(path, name, entry["robot"], Pose.of(entry["p"], entry["q_wxyz"])))
                continue
            body = _body(draft, path, name, entry, options)
        except (KeyError, TypeError, ValueError) as error:
            raise ImportRefusedError(path, f"`{name}` has invalid data for a compiled file: {error!r}") from None
        if "free" in entry:
            free.append((body, entry["free"]))
        else:
            draft.bodies.append(body)
    for body, entry in free:
        _attach_free_link(draft, body, entry, path)
    return draft


def _body(draft: ModelDraft, path: Path, name: str, entry: Mapping[str, Any], options: ImportOptions) -> BodyDraft:
    """Read an object's URDF and apply the pose and other fields in its ``poses.json`` entry."""
    file = (path.parent / str(entry["urdf"])).resolve()
    if not file.is_relative_to(path.parent.resolve()) or not file.is_file():
        raise ImportRefusedError(path, f"`{name}` refers to the file `{entry['urdf']}`, which is not in this folder")
    read = read_urdf(file, ImportOptions(options.packages))
    draft.notes += [note for note in read.notes if not note.what.startswith(_ALWAYS_THERE)]
    body = read.bodies[0]
    body.name, body.exact = name, True
    body.fixed, body.X_WO = bool(entry["fixed"]), Pose.of(entry["p"], entry["q_wxyz"])
    body.category, body.labels = entry.get("category"), tuple(entry.get("labels", ()))
    for joint in body.joints:
        joint.position = float(entry["joints"].get(joint.name, 0.0))
        joint.closed = entry.get("closed", {}).get(joint.name)
    for link in body.links.values():
        link.parts = _with_capsules(link.parts)
    return body


def _attach_free_link(draft: ModelDraft, body: BodyDraft, entry: Mapping[str, Any], path: Path) -> None:
    """Attach a body with a free joint to the object to which it belongs."""
    owner = next((b for b in draft.bodies if b.name == entry["object"]), None)
    if owner is None or entry["parent"] not in owner.links:
        raise ImportRefusedError(path, f"`{body.name}` is part of `{entry['object']}`, which does not exist")
    zero, motion = (Pose.of(entry[key][:3], entry[key][3:]) for key in ("zero", "motion"))
    joint = JointDraft(entry["joint"], "free", entry["parent"], body.root, zero, motion=motion)
    owner.links |= body.links
    owner.joints += [joint, *body.joints]


def _with_capsules(parts: list[PartDraft]) -> list[PartDraft]:
    """Return the parts of a link, merging any cylinder and two spheres that represent a capsule into a capsule."""
    by_name = {(part.name, part.use): part for part in parts}
    gone: set[int] = set()
    for (name, use), tube in by_name.items():
        ends = [by_name.get((name.removesuffix(TUBE) + end, use)) for end in (TOP, BOTTOM)]
        if not name.endswith(TUBE) or not isinstance(tube.geometry, CylinderShape) or None in ends:
            continue
        size = tube.geometry.cylinder
        if all(end is not None and _is_end(end, tube, size, up) for end, up in zip(ends, (1, -1), strict=True)):
            tube.name, tube.geometry = name.removesuffix(TUBE), CapsuleShape(capsule=size)
            gone |= {id(end) for end in ends}
    return [part for part in parts if id(part) not in gone]


def _is_end(end: PartDraft, tube: PartDraft, size: Round, up: int) -> bool:
    ball = end.geometry
    at = tube.X_LG.apply(np.array([0.0, 0.0, up * size.height / 2]))
    near = bool(np.allclose(end.X_LG.p, at, rtol=0, atol=SAME_PLACE_M))
    return near and isinstance(ball, SphereShape) and ball.sphere == size.radius
