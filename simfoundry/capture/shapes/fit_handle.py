"""Add handles to standing bodies of revolution: mugs, pitchers, pans.

What is seen beside the body, in one direction from its axis, is a handle: a plate in the plane through the axis, as
wide as it is seen, with the outline of the seen points, joined to the body at its upper and its lower end.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from simfoundry.assets.solids import prism_mesh
from simfoundry.capture.segment.masks import Mask
from simfoundry.capture.shapes.evidence import Evidence, FitCandidate
from simfoundry.capture.shapes.fit_lathe import fit_hollow, fit_lathe
from simfoundry.capture.shapes.solid_casts import cast_mesh
from simfoundry.geometry.frames import Array, Pose, frozen_array
from simfoundry.geometry.shapes import closed_mesh, tessellate

if TYPE_CHECKING:
    from shapely.geometry import Polygon
    from shapely.geometry.base import BaseGeometry

FAMILIES = ("hollow", "lathe")  # upright solids with a profile about z
GAP = 0.006  # [m] minimum distance of a handle's points from the body, beside the noise
REACH = 0.012  # [m] minimum distance by which a handle protrudes; a finger needs more
POINTS, SHARE = 30, 0.01  # minimum number of points of a handle, and their minimum share of all points
IN_PLANE = 0.8  # minimum share of the protruding points that are in one plane through the axis
WIDTHS = (0.008, 0.03)  # [m] minimum and maximum width: those of cups are 8 to 15 mm wide, and of pitchers 25 mm
ROUND = 0.0015  # [m] distance around a seen point that belongs to the handle, half of the spacing of pixels at 1 m
CLOSE = 0.004  # [m] half of the width of gaps between seen points
ARM = 0.003  # [m] half of the thickness by which the ends are joined to the body, as at a cup's handle
SMOOTH = 0.0015  # [m] tolerance of its outline
GRID = 0.001  # [m] distance below which seen points are one
CORNERS = 4  # number of corners of a quarter of the circle around one
BETTER = 0.01  # minimum advantage in the cost of agreement, beyond noise


@dataclass(frozen=True, eq=False)
class FittedHandle:
    """A handle of a body of revolution.

    ``outline`` [m], shape (n, 2), contains pairs (distance from the axis, height above the base), counterclockwise.
    ``angle`` [rad] is the direction from the axis in the frame of the body, and ``width`` [m] the extent across it.
    """

    outline: Array
    angle: float
    width: float

    @property
    def X_OH(self) -> Pose:
        """The pose in the body's frame of the prism with this outline in its xy plane."""
        matrix = np.eye(4)
        outward = np.array([np.cos(self.angle), np.sin(self.angle), 0.0])
        up = np.array([0.0, 0.0, 1.0])
        matrix[:3, :3] = np.column_stack([outward, up, np.cross(outward, up)])
        return Pose.from_matrix(matrix)


def with_handle(candidate: FitCandidate, evidence: Evidence) -> FitCandidate:
    """Return a candidate with the handle that is seen beside it, if the solid then agrees better with the image."""
    if candidate.family not in FAMILIES or candidate.profile is None:
        return candidate
    found = _handle(candidate, evidence)
    if found is None:
        return candidate
    # The handle's points have widened the body, so that it is fitted again without them.
    rest = replace(evidence, points=evidence.points[~found[1]])
    again = (fit_hollow if candidate.family == "hollow" else fit_lathe)(rest)
    handled = [_joined(candidate, found[0], evidence)]
    if again is not None and (second := _handle(again, evidence)) is not None:
        handled.append(_joined(again, second[0], evidence))
    best = min(handled, key=lambda each: each.cost)
    return best if best.cost < candidate.cost - BETTER else candidate


def _joined(body: FitCandidate, handle: FittedHandle, evidence: Evidence) -> FitCandidate:
    """Return a body with a handle, as one mesh."""
    one = tessellate(body.geometry)
    plate, plate_faces = prism_mesh(handle.outline, handle.width)
    vertices = np.concatenate([one.vertices, handle.X_OH.apply(plate)])
    mesh = closed_mesh(vertices, np.concatenate([one.faces, plate_faces + len(one.vertices)]))
    judged = evidence.judge(cast_mesh, body.X_WO.apply(mesh.vertices), mesh.faces)
    return replace(body, geometry=mesh, agreement=judged, handle=handle)


def _handle(body: FitCandidate, evidence: Evidence) -> tuple[FittedHandle, Mask] | None:
    """Return the handle that is seen beside a body, and a mask of its points, or None."""
    if body.profile is None:
        return None
    points, profile, scale = body.X_WO.inverse().apply(evidence.points), body.profile, evidence.scale
    r, z = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
    beyond = r - _outer_radius(profile, z)
    out = (beyond > max(GAP, scale)) & (z > 0) & (z < profile[:, 1].max() + GAP)
    if out.sum() < max(POINTS, SHARE * len(points)):
        return None
    weight = np.where(out, beyond, 0.0)
    direction = (points[:, :2] * (weight / np.maximum(r, 1e-9))[:, None]).sum(axis=0)
    angle = float(np.arctan2(direction[1], direction[0]))
    along = points[:, :2] @ [np.cos(angle), np.sin(angle)]
    across = points[:, :2] @ [-np.sin(angle), np.cos(angle)]
    own = out & (along > 0) & (np.abs(across) < WIDTHS[1] / 2 + scale)
    if own.sum() < IN_PLANE * out.sum() or np.quantile(beyond[own], 0.95) < REACH:
        return None
    low, high = np.quantile(across[own], [0.05, 0.95])
    outline = _outline(np.column_stack([along[own], z[own]]), profile)
    if outline is None:
        return None
    return FittedHandle(frozen_array(outline), angle, float(np.clip(high - low, *WIDTHS))), own


def _outer_radius(profile: Array, z: Array) -> Array:
    """Return the largest radius of a profile at heights [m], shape (n,), and that of its ends beyond them."""
    z = np.clip(z, profile[:, 1].min(), profile[:, 1].max())
    a, b = profile[:-1], profile[1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (z[:, None] - a[:, 1]) / (b[:, 1] - a[:, 1])
    level = a[:, 1] == b[:, 1]
    share = np.where(level, np.where(a[:, 0] > b[:, 0], 0.0, 1.0), share)
    meets = np.where(level, np.abs(z[:, None] - a[:, 1]) < 1e-9, (share >= 0) & (share <= 1))
    radius = np.where(meets, a[:, 0] + np.nan_to_num(share) * (b[:, 0] - a[:, 0]), 0.0)
    return np.asarray(radius.max(axis=1))


def _outline(seen: Array, profile: Array) -> Array | None:
    """Return the outline of a handle around seen points (distance, height), joined to the body, or None."""
    import shapely

    spread = np.unique(np.rint(seen / GRID), axis=0) * GRID
    circles = shapely.buffer(shapely.points(spread), CLOSE + ROUND, quad_segs=CORNERS)
    whole = shapely.union_all(circles).buffer(-CLOSE)  # the buffer of all points at once would take a second
    shape: BaseGeometry = _largest(whole)
    _, bottom, _, top = shape.bounds
    for height in (top - ARM, bottom + ARM):
        at = shape.intersection(shapely.box(0, height - ARM, 1, height + ARM))
        if not at.is_empty:
            radius = float(_outer_radius(profile, np.array([height]))[0])
            middle = (at.bounds[0] + at.bounds[2]) / 2
            arm = shapely.box(max(radius - ARM, 0.0), height - ARM, max(middle, radius), height + ARM)
            shape = shape.union(arm)
    body = shapely.Polygon(np.vstack([[0.0, 0.0], profile, [0.0, 0.0]])).buffer(0)
    outline = _largest(shape.difference(body.buffer(-ARM / 2)).buffer(0))
    # A ring whose opening the body does not close is cut open at the body, because a prism has no holes.
    ring = shapely.Polygon(outline.exterior) if len(outline.interiors) == 0 else _opened(outline)
    simple = shapely.geometry.polygon.orient(ring.simplify(SMOOTH))
    if simple.is_empty or not simple.is_valid or simple.exterior.is_empty:
        return None
    return np.asarray(simple.exterior.coords)[:-1]


def _opened(ring: Polygon) -> Polygon:
    """Return a ring with a cut from its largest opening toward the axis."""
    import shapely

    hole = max((shapely.Polygon(inner) for inner in ring.interiors), key=lambda each: each.area)
    x, y = hole.representative_point().coords[0]
    solid = shapely.Polygon(ring.exterior, [hole.exterior])
    return _largest(solid.difference(shapely.box(0.0, y - 5e-4, x, y + 5e-4)))


def _largest(shape: BaseGeometry) -> Polygon:
    return max(getattr(shape, "geoms", [shape]), key=lambda part: part.area)
