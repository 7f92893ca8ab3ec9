"""What of a line lies within an object: its convex parts as half-spaces."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from simfoundry.scene.frames import Array, Pose
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Geometry, SceneObject
from simfoundry.scene.state import SceneState
from simfoundry.scene.tessellate import tessellate

SEGMENTS = 32
"""Sides of round shapes."""

TOGETHER = 1e-3
"""Parts that leave at most this gap on a line [m] are one."""


@dataclass(frozen=True, eq=False)
class Part:
    """A convex part in the world: ``normals @ x <= offsets``; ``corners`` [m], shape (n, 3)."""

    normals: Array
    offsets: Array
    corners: Array


@dataclass(frozen=True, eq=False)
class Span:
    """What a line meets first and leaves last of one or more parts: ``start`` to ``end`` along it [m].

    ``facing`` is the smaller of the cosines between the line and the surfaces at its two ends; 1 is head on.
    """

    start: float
    end: float
    facing: float

    @property
    def width(self) -> float:
        """Its length [m]."""
        return self.end - self.start


_planes: WeakKeyDictionary[object, tuple[Array, Array, Array]] = WeakKeyDictionary()


def parts(item: SceneObject, state: SceneState, links: Iterable[str] | None = None) -> tuple[Part, ...]:
    """The colliders of an object, or of some of its links, where it is now."""
    chosen = None if links is None else set(links)
    X_OL = link_poses(item, state.of_object(item))
    X_WO = state.poses[item.name]
    found = []
    for link in item.links:
        if chosen is None or link.name in chosen:
            for piece in link.colliders:
                found.append(_posed(piece, piece.geometry, X_WO @ X_OL[link.name] @ piece.X_LG))
    return tuple(found)


def _posed(key: object, geometry: Geometry, X_WG: Pose) -> Part:
    if key not in _planes:
        _planes[key] = _half_spaces(geometry)
    normals, offsets, corners = _planes[key]
    turned = normals @ X_WG.rotation.T
    return Part(turned, offsets + turned @ X_WG.p, X_WG.apply(corners))


def _half_spaces(geometry: Geometry) -> tuple[Array, Array, Array]:
    """Outward normals, offsets and corners of the hull of a geometry in its own frame."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(tessellate(geometry, SEGMENTS).vertices)
    planes = np.unique(np.round(hull.equations, 9), axis=0)
    return planes[:, :3].copy(), -planes[:, 3], hull.points[hull.vertices]


def bounds(shape: tuple[Part, ...], axes: Array) -> tuple[Array, Array]:
    """Lowest and highest coordinates [m] along the columns of ``axes``, shapes (3,)."""
    along = np.concatenate([part.corners for part in shape]) @ axes
    return along.min(axis=0), along.max(axis=0)


def crossings(shape: tuple[Part, ...], starts: Array, direction: Array) -> list[list[Span]]:
    """The pieces of each line within the object, in order; ``starts`` [m], shape (n, 3), a unit ``direction``."""
    entry, leave, facing_in, facing_out = (np.empty((len(starts), len(shape))) for _ in range(4))
    for k, part in enumerate(shape):
        room = part.offsets - starts @ part.normals.T
        slope = part.normals @ direction
        with np.errstate(divide="ignore", invalid="ignore"):
            at = room / slope
        into, out = slope < -1e-9, slope > 1e-9
        aside = ~into & ~out
        first = np.where(into, at, -np.inf)
        last = np.where(out, at, np.inf)
        entry[:, k], leave[:, k] = first.max(axis=1), last.min(axis=1)
        facing_in[:, k], facing_out[:, k] = -slope[first.argmax(axis=1)], slope[last.argmin(axis=1)]
        leave[(room[:, aside] < 0).any(axis=1), k] = -np.inf
    return [_merged(*rows) for rows in zip(entry, leave, facing_in, facing_out, strict=True)]


def _merged(entry: Array, leave: Array, facing_in: Array, facing_out: Array) -> list[Span]:
    met = np.flatnonzero(leave > entry)
    spans: list[list[float]] = []
    for k in met[np.argsort(entry[met], kind="stable")]:
        if spans and entry[k] <= spans[-1][1] + TOGETHER:
            if leave[k] > spans[-1][1]:
                spans[-1][1], spans[-1][3] = float(leave[k]), float(facing_out[k])
        else:
            spans.append([float(entry[k]), float(leave[k]), float(facing_in[k]), float(facing_out[k])])
    return [Span(start, end, min(a, b)) for start, end, a, b in spans]
