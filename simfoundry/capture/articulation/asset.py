"""An asset with one joint, from two views of an object: boxes where the views show surface, hollow where it opens.

The views show the outside of a cabinet, and little of its inside. Walls, the drawer's tray and the thickness of panels
are therefore assumptions, which the asset states.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from simfoundry.capture.articulation.estimate import JointEstimate
from simfoundry.capture.articulation.motions import QUANTILES, TYPICAL_BACK
from simfoundry.capture.description.mass_estimates import mass_estimate, rounded_mass
from simfoundry.geometry.frames import Array, Pose, cross, quat_from_matrix
from simfoundry.scene.bodies import open_box_walls
from simfoundry.scene.model import JointType
from simfoundry.spec.models.shapes import OpenBox

# Assumed thickness of walls and panels [m], and gap around a moving part [m].
WALL, GAP = 0.012, 0.003

# Smallest extents of a panel [m]; fewer points than it takes would make it vanish.
PANEL = 0.01

# Share of a front's height that the tray behind it has.
TRAY = 0.7

# Smallest extents of a fixed panel beside a moving front [m]; narrower strips are frames, which the walls represent.
NARROWEST = 0.03

# A handle stands off its panel by at least this much [m], and has at least so many points.
STANDS_OFF, HANDLE_POINTS = 0.012, 30

# Assumed density of wood panels [kg/m^3], and friction of surfaces.
WOOD = {"density": 650, "friction": 0.5}

# The source of masses that nothing states.
PANELS = f"assumed: wood panels of {1000 * WALL:.0f} mm"

# Damping and friction of joints as in the paper: 0.4 N for slides, 0.01 Nm for hinges, damping 0.5.
JOINT_FRICTION = {JointType.PRISMATIC: 0.4, JointType.REVOLUTE: 0.01}
DAMPING = 0.5

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class ArticulatedParts:
    """An articulated object in its own frame A: x out of its front, z up, origin below the center of its body.

    Attributes:
        X_WA: The pose of the object.
        data: The content of the asset document.
    """

    X_WA: Pose
    data: dict[str, Any]


def articulated_parts(
    estimate: JointEstimate, points: Array, part: Array, name: str, origin: dict[str, Any]
) -> ArticulatedParts:
    """Return the asset for an object.

    Args:
        estimate: Its joint.
        points: The points of the object in the first view, in the world [m], shape (n, 3).
        part: The points of the moving part in the first view, a subset of the former, shape (m, 3).
        name: The name of the asset.
        origin: The origin to state.
    """
    motion = estimate.motion
    front = _front(estimate)
    X_WA, low, high = _frame(front, points)
    local_part = X_WA.inverse().apply(part)
    panel_low, panel_high = _bounds(local_part)
    panel_high = np.maximum(panel_high, panel_low + PANEL)
    side = 2 if abs(front @ UP) > 0.7 else 0  # the axis of A along which the front faces
    face = float(np.median(local_part[:, side]))
    handle = _handle(local_part, side, face)
    panel_low[side], panel_high[side] = face - TYPICAL_BACK, face
    axis, pivot = X_WA.rotation.T @ motion.axis, X_WA.inverse().apply(motion.pivot[None])[0]
    pivot = pivot + axis * float(axis @ ((panel_low + panel_high) / 2 - pivot))  # the point beside the panel
    at = (panel_low + panel_high) / 2 if motion.kind is JointType.PRISMATIC else pivot
    moving = {"panel": _box(panel_low - at, panel_high - at)}
    if handle is not None:
        moving["handle"] = _box(handle[0] - at, handle[1] - at)
    if motion.kind is JointType.PRISMATIC and side == 0:
        moving |= _tray(low, panel_low - at, panel_high - at, at)
    limits = {"limits": numbers([0.0, motion.q])}
    if motion.kind is JointType.REVOLUTE:
        limits = {"limits_deg": numbers([0.0, math.degrees(motion.q)])}
    body = {"case": _case(low, high, face, side)} | _fixed_panels(low, high, panel_low, panel_high, side)
    joint = {
        "type": motion.kind.value,
        "parent": "body",
        "child": "part",
        "pose": {"xyz": numbers(at)},
        "axis": numbers(axis),
        **limits,
        "damping": DAMPING,
        "friction": JOINT_FRICTION[motion.kind],
    }
    links = {name: _link(parts) for name, parts in (("body", body), ("part", moving))}
    data = {
        "simfoundry": "asset/1",
        "name": name,
        "materials": {"wood": WOOD},
        "links": links,
        "joints": {"joint": joint},
        "origin": origin,
    }
    return ArticulatedParts(X_WA, data)


def _link(parts: dict[str, Any]) -> dict[str, Any]:
    """Return a link of wood, with the mass of its walls and panels as an assumption."""
    volume = 0.0
    for part in parts.values():
        shape = part["shape"]
        boxes = (
            [shape["box"]]
            if "box" in shape
            else [wall.box for _, wall, _ in open_box_walls(OpenBox.model_validate(shape["open_box"]))]
        )
        volume += sum(math.prod(box) for box in boxes)
    mass = mass_estimate(rounded_mass(volume * WOOD["density"]), PANELS)
    return {"material": "wood", "mass": mass.model_dump(), "parts": parts}


def _front(estimate: JointEstimate) -> Array:
    """Return the unit normal of a part's front in the first view, which is also the direction of a slide."""
    if estimate.motion.kind is JointType.PRISMATIC:
        return estimate.motion.axis
    return estimate.front.normal


def _frame(front: Array, points: Array) -> tuple[Pose, Array, Array]:
    """Return the object's frame, and its lowest and highest coordinates there [m]."""
    level = front - (front @ UP) * UP
    if np.linalg.norm(level) < 0.5:  # a lid: x is along the longer side
        flat = points[:, :2] - points[:, :2].mean(axis=0)
        level = np.array([*np.linalg.svd(flat, full_matrices=False)[2][0], 0.0])
    x = level / np.linalg.norm(level)
    R_WA = np.column_stack([x, cross(UP, x), UP])
    low, high = _bounds(points @ R_WA)
    shift = np.array([*((low + high) / 2)[:2], 0.0])
    low, high = low - shift, high - shift
    low[2] = 0.0  # it stands on its support, also where the support hides its foot
    return Pose.of(R_WA @ shift, quat_from_matrix(R_WA)), low, high


def numbers(values: Array | Sequence[float]) -> tuple[float, ...]:
    """Return numbers of a document, to a hundredth of a millimeter, which is less than anything that was measured."""
    return tuple(round(float(value), 5) for value in values)


def _bounds(points: Array) -> tuple[Array, Array]:
    low, high = np.quantile(points, QUANTILES, axis=0)
    return np.asarray(low), np.asarray(high)


def _box(low: Array, high: Array) -> dict[str, Any]:
    return {"shape": {"box": numbers(high - low)}, "pose": {"xyz": numbers((low + high) / 2)}}


def _case(low: Array, high: Array, face: float, side: int) -> dict[str, Any]:
    """Return a box that is open where the front is, or a full one if it is too small to be open."""
    high = high.copy()
    high[side] = max(low[side] + WALL, face - TYPICAL_BACK - GAP)
    size = high - low
    middle = (low + high) / 2
    if min(size) < 3 * WALL:
        return _box(low, high)
    if side == 2:
        return {"shape": {"open_box": {"size": numbers(size), "wall": WALL}}, "pose": {"xyz": numbers(middle)}}
    # A box that is open along z, turned so that it is open along x; its own x is then -z of the asset.
    turned = [size[2], size[1], size[0]]
    return {
        "shape": {"open_box": {"size": numbers(turned), "wall": WALL}},
        "pose": {"xyz": numbers(middle), "rpy_deg": (0.0, 90.0, 0.0)},
    }


def _tray(low: Array, panel_low: Array, panel_high: Array, at: Array) -> dict[str, Any]:
    """Return the tray behind the front of a drawer, in the frame of the joint at ``at``, if there is room for one."""
    depth = (panel_low[0] + at[0]) - (low[0] + WALL) - GAP
    width = panel_high[1] - panel_low[1] - 2 * (WALL + GAP)
    height = TRAY * (panel_high[2] - panel_low[2])
    if min(depth, width, height) < 2 * WALL:
        return {}
    at_center = [panel_low[0] - depth / 2, (panel_low[1] + panel_high[1]) / 2, panel_low[2] + GAP + height / 2]
    shape = {"open_box": {"size": numbers([depth, width, height]), "wall": WALL / 2}}
    return {"tray": {"shape": shape, "pose": {"xyz": numbers(at_center)}}}


def _fixed_panels(low: Array, high: Array, panel_low: Array, panel_high: Array, side: int) -> dict[str, Any]:
    """Return panels that close the rest of a front beside a moving panel, such as the other drawers of a cabinet."""
    if side == 2:
        return {}
    found = {}
    strips = {
        "below": (low[1], low[2], high[1], panel_low[2] - GAP),
        "above": (low[1], panel_high[2] + GAP, high[1], high[2]),
        "right": (low[1], panel_low[2], panel_low[1] - GAP, panel_high[2]),
        "left": (panel_high[1] + GAP, panel_low[2], high[1], panel_high[2]),
    }
    for where, (y0, z0, y1, z1) in strips.items():
        if y1 - y0 > NARROWEST and z1 - z0 > NARROWEST:
            found[where] = _box(np.array([panel_low[0], y0, z0]), np.array([panel_high[0], y1, z1]))
    return found


def _handle(part: Array, side: int, face: float) -> tuple[Array, Array] | None:
    """Return the lowest and highest coordinates of the points that stand off a panel, or None if there are few."""
    proud = part[part[:, side] > face + STANDS_OFF]
    if len(proud) < HANDLE_POINTS:
        return None
    low, high = _bounds(proud)
    low[side] = face
    return low, high
