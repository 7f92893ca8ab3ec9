"""How far two things are apart in size, shape and colour: what makes variants distinct, and what retrieval looks for.

Shape is told by D2, the distribution of distances between points of the surface over the largest of them (Osada et al.,
Shape Distributions, ACM ToG 2002), colour by CIE 1976 L*a*b*.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from simfoundry.geometry.frames import Array, frozen_array
from simfoundry.geometry.shapes import Mesh
from simfoundry.geometry.tessellate import tessellate
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import SceneObject

PAIRS, BINS = 16_384, 24
"""Pairs of surface points, and bins of their distances: the noise of the shape distance then is below 0.02."""

SEGMENTS = 32

LEVELS = 12
"""Levels of each channel of a texture that are told apart: finer ones make the colours too many to match."""

SIZE, SHAPE, COLOR = 0.06, 0.06, 12.0
"""Two things are distinct if their sides differ by 6 %, their shapes by 0.06 (share of the pairs of points that fall
elsewhere), or their colours by 12 in L*a*b*: five times what is just seen (Mahy et al., 1994)."""


@dataclass(frozen=True, eq=False)
class Likeness:
    """What a thing looks like: ``size`` [m] along x, y, z, shape (3,); ``shape`` shares of the pairs of points by their
    distance, shape (24,), of sum 1; ``colors`` L*a*b* of what is seen of it, by area, shape (k, 3), with ``areas`` as
    shares, shape (k,); ``mass`` [kg].
    """

    size: Array
    shape: Array
    colors: Array
    areas: Array
    mass: float

    def apart(self, other: Likeness) -> Apart:
        """How far another is from this."""
        size = float(np.abs(np.log(self.size / other.size)).max())
        shape = float(np.abs(self.shape - other.shape).sum() / 2)
        return Apart(size, shape, color_distance(self, other))


@dataclass(frozen=True)
class Apart:
    """``size``: the largest ratio of two sides, as a logarithm; ``shape``: between 0 and 1; ``color`` in L*a*b*."""

    size: float
    shape: float
    color: float

    @property
    def form(self) -> float:
        """The larger of size and shape in units of what makes things distinct: what differs whatever the colour."""
        return max(self.size / math.log1p(SIZE), self.shape / SHAPE)

    @property
    def distance(self) -> float:
        """The largest of the three in units of what makes things distinct: from 1 on they are."""
        return max(self.form, self.color / COLOR)

    def __str__(self) -> str:
        return f"size {math.expm1(self.size):.1%}, shape {self.shape:.3f}, colour {self.color:.1f}"


def likeness(item: SceneObject, seed: int = 0) -> Likeness:
    """The likeness of a thing with its joints where its object has them; ``seed`` draws the points."""
    triangles, rgb = _surface(item)
    areas = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1) / 2
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    rng = np.random.default_rng([seed, 2])
    a, b = (_points(triangles, areas, rng) for _ in range(2))
    far = np.linalg.norm(a - b, axis=1)
    histogram, _ = np.histogram(far / np.linalg.norm(high - low), bins=BINS, range=(0.0, 1.0))
    unique, which = np.unique(np.round(rgb, 4), axis=0, return_inverse=True)
    shares = np.bincount(which.reshape(-1), weights=areas) / areas.sum()
    return Likeness(
        frozen_array(high - low),
        frozen_array(histogram / PAIRS),
        frozen_array(lab(unique)),
        frozen_array(shares),
        sum(link.mass for link in item.links),
    )


def color_distance(a: Likeness, b: Likeness) -> float:
    """The mean distance in L*a*b* between equal shares of two surfaces, matched greedily from the nearest colours."""
    cost = np.linalg.norm(a.colors[:, None] - b.colors[None], axis=2)
    left, right = a.areas.copy(), b.areas.copy()
    total = 0.0
    for flat in np.argsort(cost, axis=None, kind="stable"):
        i, j = np.unravel_index(int(flat), cost.shape)
        share = min(left[i], right[j])
        total += float(share * cost[i, j])
        left[i] -= share
        right[j] -= share
    return total


def lab(rgb: Array) -> Array:
    """CIE 1976 L*a*b* (D65) of sRGB colours in [0, 1], shape (n, 3)."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    xyz = linear @ np.array([[0.4124, 0.2126, 0.0193], [0.3576, 0.7152, 0.1192], [0.1805, 0.0722, 0.9505]])
    t = xyz / np.array([0.9505, 1.0, 1.089])
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t * (29 / 6) ** 2 / 3 + 4 / 29)
    return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1)


def _points(triangles: Array, areas: Array, rng: np.random.Generator) -> Array:
    """Points spread evenly over a surface, shape (PAIRS, 3)."""
    which = np.searchsorted(np.cumsum(areas) / areas.sum(), rng.random(PAIRS))
    corner = triangles[np.minimum(which, len(areas) - 1)]
    u, v = np.sqrt(rng.random(PAIRS))[:, None], rng.random(PAIRS)[:, None]
    return np.asarray((1 - u) * corner[:, 0] + u * (1 - v) * corner[:, 1] + u * v * corner[:, 2])


def _surface(item: SceneObject) -> tuple[Array, Array]:
    """Triangles of all that is seen, in the object's frame, shape (n, 3, 3), and their sRGB colours, shape (n, 3)."""
    X_OL = link_poses(item)
    triangles, colors = [np.zeros((0, 3, 3))], [np.zeros((0, 3))]
    for link in item.links:
        for visual in link.visuals:
            mesh = tessellate(visual.geometry, SEGMENTS)
            corners = (X_OL[link.name] @ visual.X_LG).apply(mesh.vertices)[mesh.faces]
            triangles.append(corners)
            colors.append(visual.rgba[:3] * _tints(mesh))
    return np.concatenate(triangles), np.concatenate(colors)


def _tints(mesh: Mesh) -> Array:
    """The colour of the texture in the middle of each triangle, in few levels; white without one, shape (n, 3)."""
    if mesh.texture is None or mesh.uv is None:
        return np.ones((len(mesh.faces), 3))
    import io

    from PIL import Image

    with Image.open(io.BytesIO(mesh.texture)) as image:
        small = image.convert("RGB").resize((64, 64), Image.Resampling.BOX)
        pixels = np.round(np.asarray(small, dtype=np.float64) / 255 * LEVELS) / LEVELS
    u, v = np.moveaxis(mesh.uv[mesh.faces].mean(axis=1) % 1.0, 1, 0)
    return np.asarray(pixels[((1 - v) * 63).round().astype(int), (u * 63).round().astype(int)])
