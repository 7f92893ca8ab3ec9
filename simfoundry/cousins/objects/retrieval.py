"""Measure the similarity of objects in size, shape and color, and retrieve similar objects from a library.

Shapes are compared by their D2 descriptor, which is the distribution of distances between pairs of surface points
(Osada et al., Shape Distributions, ACM ToG 2002), relative to the diagonal of the bounding box. Colors are compared in
CIE 1976 L*a*b*.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path

import numpy as np

from simfoundry.assets.cache import Cache
from simfoundry.cousins.objects.appearance import same_kind
from simfoundry.cousins.objects.geometry import stretched
from simfoundry.cousins.objects.item import ObjectAsset, alone, item_of_asset, item_of_mesh, lowered
from simfoundry.cousins.objects.procedural import Draft
from simfoundry.cousins.recipe.candidate import Reason
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Array, frozen_array
from simfoundry.geometry.shapes import Mesh, tessellate
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import SceneObject
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.files import MESH_SUFFIXES
from simfoundry.spec.load import load
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.base import Material
from simfoundry.spec.models.cousins import ObjectVariants

# Number of surface point pairs and number of histogram bins. The noise of the shape distance is then below 0.02.
PAIRS, BINS = 16_384, 24

# Number of edges around a round shape.
SEGMENTS = 32

# Number of levels per texture channel; more levels would result in too many colors to match.
LEVELS = 12

# Thresholds for distinct objects: 6% in side length, 0.06 in shape (fraction of point pairs in different bins), or 12
# in L*a*b* color, which is five times the just noticeable difference (Mahy et al., 1994).
SIZE, SHAPE, COLOR = 0.06, 0.06, 12.0


@dataclass(frozen=True, eq=False)
class Likeness:
    """Descriptor of an object for similarity comparisons.

    Attributes:
        size: Extents along x, y and z [m], shape (3,).
        shape: Normalized histogram of distances between surface points, shape (BINS,).
        colors: Colors of visible surfaces in L*a*b*, shape (k, 3).
        areas: Fraction of the surface area that has each color, shape (k,).
        mass: Mass [kg].
    """

    size: Array
    shape: Array
    colors: Array
    areas: Array
    mass: float

    def apart(self, other: Likeness) -> LikenessDistance:
        """Compute the distance between this descriptor and another one."""
        size = float(np.abs(np.log(self.size / other.size)).max())
        shape = float(np.abs(self.shape - other.shape).sum() / 2)
        return LikenessDistance(size, shape, color_distance(self, other))


@dataclass(frozen=True)
class LikenessDistance:
    """The distance between two descriptors.

    Attributes:
        size: Logarithm of the largest ratio between corresponding side lengths.
        shape: Distance between the shape histograms, from 0 to 1.
        color: Mean color distance in L*a*b*.
    """

    size: float
    shape: float
    color: float

    @property
    def form(self) -> float:
        """The difference in form, which is the larger of the size and shape distances.

        Both are in units of the thresholds for distinct objects.
        """
        return max(self.size / math.log1p(SIZE), self.shape / SHAPE)

    @property
    def distance(self) -> float:
        """The largest of the three distances in units of the thresholds.

        The value is at least 1 for distinct objects.
        """
        return max(self.form, self.color / COLOR)

    def __str__(self) -> str:
        return f"size {math.expm1(self.size):.1%}, shape {self.shape:.3f}, color {self.color:.1f}"


def likeness(item: SceneObject, seed: int = 0) -> Likeness:
    """Compute the descriptor of an object at its current joint positions.

    The surface points are sampled with ``seed``.
    """
    triangles, rgb = _surface(item)
    areas = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1) / 2
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    rng = np.random.default_rng([seed, 2])
    a, b = (_points(triangles, areas, rng) for _ in range(2))
    far = np.linalg.norm(a - b, axis=1)
    histogram, _ = np.histogram(far / np.linalg.norm(high - low), bins=BINS, range=(0.0, 1.0))
    unique, which = np.unique(np.round(rgb, 4), axis=0, return_inverse=True)
    shares = np.bincount(which.reshape(-1), weights=areas) / areas.sum()
    size, shape, colors, shares = map(frozen_array, (high - low, histogram / PAIRS, lab(unique), shares))
    return Likeness(size, shape, colors, shares, sum(link.mass for link in item.links))


def color_distance(a: Likeness, b: Likeness) -> float:
    """Return the mean color distance in L*a*b* between two surfaces.

    Regions of equal area are matched greedily, starting with the most similar colors.
    """
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
    """Convert sRGB colors in [0, 1], an array of shape (n, 3), to CIE 1976 L*a*b* (D65)."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    xyz = linear @ np.array([[0.4124, 0.2126, 0.0193], [0.3576, 0.7152, 0.1192], [0.1805, 0.0722, 0.9505]])
    t = xyz / np.array([0.9505, 1.0, 1.089])
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t * (29 / 6) ** 2 / 3 + 4 / 29)
    return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1)


def _points(triangles: Array, areas: Array, rng: np.random.Generator) -> Array:
    """Sample points uniformly on a surface and return them as an array of shape (PAIRS, 3)."""
    which = np.searchsorted(np.cumsum(areas) / areas.sum(), rng.random(PAIRS))
    corner = triangles[np.minimum(which, len(areas) - 1)]
    u, v = np.sqrt(rng.random(PAIRS))[:, None], rng.random(PAIRS)[:, None]
    return np.asarray((1 - u) * corner[:, 0] + u * (1 - v) * corner[:, 1] + u * v * corner[:, 2])


def _surface(item: SceneObject) -> tuple[Array, Array]:
    """Return the visible triangles of an object and their colors.

    Returns:
        The corners in the object's frame [m], as an array of shape (n, 3, 3), and the sRGB colors, as an array of shape
        (n, 3).
    """
    X_OL = link_poses(item)
    triangles, colors = [np.zeros((0, 3, 3))], [np.zeros((0, 3))]
    for X_OG, visual in ((X_OL[link.name] @ v.X_LG, v) for link in item.links for v in link.visuals):
        mesh = tessellate(visual.geometry, SEGMENTS)
        triangles.append(X_OG.apply(mesh.vertices)[mesh.faces])
        colors.append(visual.rgba[:3] * _tints(mesh))
    return np.concatenate(triangles), np.concatenate(colors)


def _tints(mesh: Mesh) -> Array:
    """Return the quantized texture color at the center of each triangle, as an array of shape (n, 3).

    Without a texture, the colors are white.
    """
    if mesh.texture is None or mesh.uv is None:
        return np.ones((len(mesh.faces), 3))
    import io

    from PIL import Image

    with Image.open(io.BytesIO(mesh.texture)) as image:
        small = image.convert("RGB").resize((64, 64), Image.Resampling.BOX)
        pixels = np.round(np.asarray(small, dtype=np.float64) / 255 * LEVELS) / LEVELS
    u, v = np.moveaxis(mesh.uv[mesh.faces].mean(axis=1) % 1.0, 1, 0)
    return np.asarray(pixels[((1 - v) * 63).round().astype(int), (u * 63).round().astype(int)])


# Range of the factors by which a library object can be scaled to the size of the twin's object.
LEAST, MOST = 0.5, 2.0

# Distance added between objects in different categories, in units of :attr:`LikenessDistance.distance`.
STRANGER = 3.0

# Material of meshes if the twin does not specify a material.
USUAL = Material(density=700.0, friction=0.5, restitution=0.1)


@dataclass(frozen=True, eq=False)
class VariantEntry:
    """A library object and its descriptor."""

    item: ObjectAsset
    likeness: Likeness


class VariantLibrary:
    """A source of candidates that returns the objects in a folder, in order of decreasing similarity to the twin.

    The folder may contain asset documents and mesh files. The category of a mesh is the name of its top-level folder.
    ``left_out`` maps the path of each unusable file to the reason why it cannot be used.

    Raises:
        SimfoundryError: The folder does not exist.
    """

    def __init__(self, folder: Path, cache: Cache | None = None, scale: float = 1.0) -> None:
        if not folder.is_dir():
            raise SimfoundryError(f"the library {folder} is not a folder")
        self.left_out: dict[str, str] = {}
        self.entries: list[VariantEntry] = []
        self._ranked: dict[str, list[tuple[float, float, VariantEntry]]] = {}
        for path in sorted(folder.rglob("*")):
            if path.name.endswith(".asset.yaml") or path.suffix.lower() in MESH_SUFFIXES:
                try:
                    item = _read(path, folder, scale)
                    found = lowered(item.spec, path.parent, item.name, cache)
                except SpecError as error:
                    self.left_out[path.relative_to(folder).as_posix()] = error.diagnostics[0].message
                else:
                    self.entries.append(VariantEntry(item, likeness(found)))

    def ranked(self, item: ObjectAsset, like: Likeness) -> list[tuple[float, float, VariantEntry]]:
        """Return the entries in order of decreasing similarity, excluding the twin's own asset.

        Args:
            item: The twin's object.
            like: Descriptor of the twin's object.

        Returns:
            Tuples of the distance, the factor that scales the entry to the size of the twin's object, and the entry.
        """
        found = []
        for entry in self.entries:
            if entry.item.spec.links == item.spec.links:
                continue
            factor = float(np.exp(np.mean(np.log(like.size / entry.likeness.size))))
            factor = min(max(factor, LEAST), MOST)
            sides = np.abs(np.log(entry.likeness.size * factor / like.size)).max() / np.log(1 + SIZE)
            shape = np.abs(entry.likeness.shape - like.shape).sum() / 2 / SHAPE
            away = float(sides + shape) + (0.0 if same_kind(entry.item.category, item.category) else STRANGER)
            found.append((away, factor, entry))
        return sorted(found, key=itemgetter(0))

    def __call__(self, item: ObjectAsset, axis: ObjectVariants, seed: int, k: int) -> Draft | Reason:
        """Return candidate ``k``. It is generated from the next entry in order of decreasing similarity."""
        if item.name not in self._ranked:
            self._ranked[item.name] = self.ranked(item, likeness(alone(item)))
        ranked = self._ranked[item.name]
        place = k // len(axis.sources)
        if place >= len(ranked):
            count = len(ranked)
            text = f"the library contains only {count} objects besides the twin, but entry {place + 1} was requested"
            return Reason("library", text, {"entries": float(count), "place": float(place)})
        away, factor, entry = ranked[place]
        if not same_kind(entry.item.category, item.category):
            text = f"the next library entry, `{entry.item.name}`, is a {entry.item.category}, not a {item.category}"
            return Reason("kind", text, {"distance": away})
        spec = stretched(entry.item.spec, np.full(3, factor))
        words = f"{entry.item.source} from the library, scaled by {factor:.2f}, at distance {away:.1f}"
        spec = spec.model_copy(update={"description": None, "origin": None})
        return Draft(spec, (words,), kept=entry.item.files)


def contents(folder: Path) -> dict[str, str]:
    """Return the SHA-256 hashes of the files in a library folder, keyed by relative path and sorted."""
    files = (p for p in sorted(folder.rglob("*")) if p.is_file())
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def _read(path: Path, folder: Path, scale: float) -> ObjectAsset:
    if path.name.endswith(".asset.yaml"):
        loaded = load(path)
        if loaded.errors or not isinstance(loaded.spec, AssetSpec):
            raise SpecError(loaded.errors or [loaded.finding("SF006", ("simfoundry",), "it is not an asset document")])
        return item_of_asset(loaded)
    inside = path.relative_to(folder).parts
    nameless = len(inside) > 1 and path.stem in ("mesh", "model", "textured", "textured_simple")
    name, category = inside[-2] if nameless else path.stem, inside[0] if len(inside) > 1 else path.stem
    return item_of_mesh(path, _name(name), _name(category), USUAL, scale)


def _name(text: str) -> str:
    """Convert a file name to an object name: ``025_mug`` becomes ``mug``."""
    kept = "".join(c if c.isalnum() and c.isascii() else "_" for c in text.lower()).strip("_0123456789-")
    return kept or "thing"
