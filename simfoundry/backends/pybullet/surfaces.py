"""Collision shapes and surfaces in Bullet.

Each link has a single friction, restitution and resistance for all of its colliders. Bullet multiplies the friction
coefficients of two bodies, and likewise their restitutions. Each link therefore stores the square root of its own
value, and the product is the geometric mean.

For spinning and rolling, Bullet multiplies each link's coefficient by the other link's sliding friction and adds the
two products, whereas the scene uses the larger resistance of the two links. The written value is exact if all links
that a resisting link can touch have the same friction. Otherwise, an intermediate value is used, and
:class:`Resistance` contains the error.

Convex meshes are shrunk by the collision margin that Bullet adds around them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from itertools import product
from typing import NamedTuple

import numpy as np

from simfoundry.backends.artifact import rounded
from simfoundry.backends.urdf.elements import Split
from simfoundry.geometry.frames import IDENTITY, Array, Pose, frozen_array
from simfoundry.geometry.shapes import Geometry, Mesh
from simfoundry.scene.model import Link, Scene, SceneObject, pair_resistance


class Resistance(NamedTuple):
    """The resistance to write for each link.

    Attributes:
        written: The values to write, keyed by the qualified name of the link.
        error: The largest relative error of any pair of links.
    """

    written: dict[str, float]
    error: float


# The resistances to spinning and rolling, by collider field name.
Resistances = dict[str, Resistance]


class _BulletSurface(NamedTuple):
    """The sliding friction of a link as stored in Bullet, and the link's resistance in the scene [m]."""

    friction: float
    resistance: float


def link_mean(link: Link, field: str) -> float:
    """Return the geometric mean of ``friction`` or ``restitution`` over all colliders in a link."""
    values = [getattr(collider, field) for collider in link.colliders]
    if not values or min(values) <= 0:
        return 0.0
    return values[0] if len(set(values)) == 1 else math.exp(math.fsum(map(math.log, values)) / len(values))


def robot_friction(link: Link, scene: Scene) -> float:
    """Return Bullet's friction coefficient for a link of a converted robot, chosen to match its grip in MuJoCo.

    MuJoCo uses the larger friction of a pair, whereas Bullet multiplies this coefficient by the square root of the
    object's friction. The result is exact if all objects have the same friction; otherwise, it is an intermediate
    value.
    """
    own = link_mean(link, "friction")
    met = {link_mean(k, "friction") for item in scene.objects for k in item.links if k.colliders} - {0.0}
    wanted = [max(own, other) / math.sqrt(other) for other in met]
    return math.sqrt(min(wanted) * max(wanted)) if own and wanted else math.sqrt(own)


def surface_data(item: SceneObject, link: Link, resistances: Resistances) -> dict[str, float]:
    """Return the arguments with which ``changeDynamics`` is called for a link."""
    surface = {
        "lateral_friction": rounded(math.sqrt(link_mean(link, "friction"))),
        "restitution": rounded(math.sqrt(link_mean(link, "restitution"))),
    }
    for field, found in resistances.items():  # Bullet calls torsional friction spinning friction
        if value := found.written.get(item.qualified(link.name)):
            surface[field.replace("torsional", "spinning")] = rounded(value)
    return surface


def scene_resistances(scene: Scene) -> Resistances:
    """Return the spinning and rolling resistances of all links in a scene."""
    return {field: _resistance(scene, field) for field in ("torsional_friction", "rolling_friction")}


def _resistance(scene: Scene, field: str) -> Resistance:
    """Return the values to write for the ``field`` resistance, based on the largest value [m] in each link."""
    owners: dict[_BulletSurface, set[str]] = {}
    surfaces: dict[str, _BulletSurface] = {}
    for item, link in [(o, k) for o in scene.objects for k in o.links if k.colliders]:
        resistance = max(getattr(collider, field) for collider in link.colliders)
        surface = _BulletSurface(math.sqrt(link_mean(link, "friction")), resistance)
        surfaces[item.qualified(link.name)] = surface
        owners.setdefault(surface, set()).add(item.name)
    if not any(surface.resistance for surface in owners):
        return Resistance({}, 0.0)
    meetings = [(a, b) for a, b in product(owners, owners) if a != b or len(owners[a]) > 1]
    written = {a: _middle(_exact_values(a, (b for one, b in meetings if one == a))) for a in owners}
    error = max((_error(a, b, written) for a, b in meetings if a.resistance or b.resistance), default=0.0)
    return Resistance({name: written[surface] for name, surface in surfaces.items()}, error)


def _exact_values(a: _BulletSurface, others: Iterable[_BulletSurface]) -> list[float]:
    """Return a list of the values of ``a`` that would make its contact with each of the ``others`` exact.

    If both links have resistance, each contributes its share.
    """
    if not a.resistance:
        return []
    return [
        pair_resistance(a.resistance, b.resistance) / (b.friction * (2 if b.resistance else 1))
        for b in others
        if b.friction > 0
    ]


def _middle(values: list[float]) -> float:
    """Return the geometric mean of the smallest and the largest value, or 0 if there are no values."""
    return math.sqrt(min(values) * max(values)) if values else 0.0


def _error(a: _BulletSurface, b: _BulletSurface, written: dict[_BulletSurface, float]) -> float:
    """Return the relative error of Bullet's resistance for a pair of links."""
    found = written[a] * b.friction + written[b] * a.friction
    return abs(found / pair_resistance(a.resistance, b.resistance) - 1)


# Collision margin that Bullet adds around a convex mesh from a URDF [m]; it cannot be disabled.
SKIN = 1e-3


def split_under_skin() -> Split:
    """Return a split that shrinks each mesh by Bullet's margin, leaving meshes that are too thin unchanged."""
    done: dict[str, Mesh] = {}

    def parts(geometry: Geometry) -> Iterator[tuple[str, Geometry, Pose]]:
        if isinstance(geometry, Mesh):
            digest = geometry.digest
            if digest not in done:
                done[digest] = inset_hull(geometry, SKIN) or geometry
            geometry = done[digest]
        yield "", geometry, IDENTITY

    return parts


def inset_hull(mesh: Mesh, distance: float) -> Mesh | None:
    """Return a mesh's convex hull with every face moved inward by ``distance`` [m], or None if the mesh is too thin.

    After a margin of the same size is added, the faces are in their original positions and the edges are rounded.
    """
    from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

    try:
        planes = ConvexHull(np.asarray(mesh.vertices)).equations  # normal, offset: normal @ x + offset <= 0 inside
        inside = _inner_point(planes, mesh.vertices.mean(axis=0), 1.1 * distance)
        if inside is None:
            return None
        planes = planes + np.array([0.0, 0.0, 0.0, distance])
        corners = HalfspaceIntersection(planes, inside).intersections
        corners = np.unique(np.round(corners, 10), axis=0)  # a triangulated face yields the same corner several times
        hull = ConvexHull(corners)
    except QhullError:  # flat, or too small for floating point
        return None
    return Mesh(frozen_array(corners), _outward(hull.simplices, hull.equations, corners))


def _inner_point(planes: Array, guess: Array, depth: float) -> Array | None:
    """Return a point at least ``depth`` [m] below every plane.

    The guess is returned if it is deep enough. Otherwise, the deepest point is returned.
    """
    from scipy.optimize import linprog

    if float((planes[:, :3] @ guess + planes[:, 3]).max()) < -depth:
        return guess
    rows = np.column_stack([planes[:, :3], np.ones(len(planes))])
    found = linprog([0.0, 0.0, 0.0, -1.0], A_ub=rows, b_ub=-planes[:, 3], bounds=[(None, None)] * 3 + [(0.0, None)])
    if not found.success or found.x[3] < depth:
        return None
    return np.asarray(found.x[:3], dtype=np.float64)


def _outward(simplices: np.ndarray, planes: Array, points: Array) -> np.ndarray:
    """Return the triangles in counterclockwise order as seen from outside, as an int32 array of shape (m, 3)."""
    a, b, c = (points[simplices[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), planes[:, :3]) < 0
    faces = simplices.astype(np.int32)
    faces[inward] = faces[inward][:, [0, 2, 1]]
    return faces
