"""Closed meshes without symmetry."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Faces = NDArray[np.int32]

CUBE_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ],
    dtype=np.int32,
)  # fmt: skip


def block(size: tuple[float, float, float], at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> tuple[Array, Faces]:
    """A box of full extents ``size`` [m] centered ``at`` [m], faces counter-clockwise from outside."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    return corners * size + at, CUBE_FACES


def blob(rng: np.random.Generator, count: int = 40) -> tuple[Array, Faces]:
    """A star-shaped, generally not convex closed mesh, away from the origin."""
    from scipy.spatial import ConvexHull

    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    sphere = ConvexHull(directions)
    faces = sphere.simplices.astype(np.int32)
    a, b, c = (directions[faces[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), sphere.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    radii = rng.uniform(0.5, 1.5, size=(count, 1))
    return directions * radii * [0.1, 0.2, 0.3] + rng.uniform(-1, 1, 3), faces


def obj(vertices: Array, faces: Faces) -> str:
    """The text of an OBJ file."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
    return "\n".join([*lines, *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces)]) + "\n"


def rotation(rng: np.random.Generator) -> Array:
    """A random rotation matrix."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return np.asarray(q if np.linalg.det(q) > 0 else -q)
