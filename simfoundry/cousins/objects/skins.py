"""Apply patterns to the parts of a component as visual meshes with textures."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from simfoundry.cousins.objects.appearance import Color, color_gap, color_of, palette_of, priors, varied
from simfoundry.cousins.objects.components import MAIN, Kind, components, parts_of, with_added, with_parts
from simfoundry.cousins.objects.meshes import mesh_files, strips
from simfoundry.cousins.objects.parts import rod
from simfoundry.cousins.objects.profiles import FLAT, LOW, Profile, Rng, arc_lengths
from simfoundry.geometry.frames import Array, frozen_array
from simfoundry.geometry.shapes import Mesh
from simfoundry.spec.models.asset import AssetSpec, PartSpec
from simfoundry.spec.models.shapes import BoxShape, LatheShape, PrismShape, SphereShape

# Width and height of a texture [px]. The resolution around a mug is then 1.3 mm, and PNG files have 20 to 60 kB.
PIXELS = 192

# Number of sides of a solid of revolution. The sides deviate from the circle by 0.1% of the radius.
AROUND = 64


# Values in [0, 1] from top to bottom, shape (PIXELS, PIXELS); for a pattern, the fraction of the second color.
Field = NDArray[np.float64]

# Function that evaluates a pattern at u (around) and v (up), both in [0, 1]; periodic in u.
Pattern = Callable[[Field, Field, Rng], Field]


def skinned(spec: AssetSpec, only: Sequence[str], rng: Rng) -> tuple[AssetSpec, dict[str, bytes], str]:
    """Apply a random pattern to one of the main components.

    The original parts remain in the asset as collision geometry and keep their mass.

    Args:
        spec: The asset.
        only: Names of the components that may change. If it is empty, all components may change.
        rng: Random generator.

    Returns:
        The new spec, the new files by name, and a description of the pattern. If no part can be textured, the spec is
        unchanged and the description is empty.
    """
    found = [c for c in components(spec) if c.kind in SKINNED and (not only or c.name in only)]
    found = [c for c in found if not _is_chain(c.parts_in(spec))]
    if not found:
        return spec, {}, ""
    component = found[int(rng.integers(len(found)))]
    parts = parts_of(spec)
    own = color_of(spec, component.parts[0])
    base = own or priors().white
    material = parts[component.parts[0]].material or spec.links[component.link].material or ""
    names = _patterns(f"{material} {spec.category or spec.name}")
    name = names[int(rng.integers(len(names)))]
    is_natural = name in priors().patterns["natural"]
    second = _second(base, is_natural, palette_of(spec), rng)
    if not is_natural and rng.random() < 0.5:
        base, second = second, base
    image = _painted(PATTERNS[name], base, second, rng)
    files: dict[str, bytes] = {}
    looks: dict[str, PartSpec] = {}
    for k, key in enumerate(key for key in component.parts if color_of(spec, key) == own):
        part = parts[key]
        mesh = _meshed(part, image, name in priors().patterns["around_axis"]) if part.use == "both" else None
        if mesh is None:
            continue
        file, written = mesh_files(mesh)
        files |= written
        parts[key] = part.model_copy(update={"use": "collision", "color": None})
        look = PartSpec(mesh=file, pose=part.pose, color=(1.0, 1.0, 1.0), use="visual")
        looks[f"skin_{k}"] = look.model_copy(update={"material": part.material})
    if not files:
        return spec, {}, ""
    return with_added(with_parts(spec, parts), component.link, looks), files, f"{component.name} with {name}"


# Kinds of components that can get a pattern. Berries and the layers of a burger are excluded.
SKINNED = tuple(kind for kind in (*MAIN, Kind.LID, Kind.DRAWER, Kind.CAP) if kind not in (Kind.BUNCH, Kind.STACK))


def _is_chain(parts: list[PartSpec]) -> bool:
    """Return True if a component consists of several rods, as in a banana, so that patterns would show seams."""
    return len(parts) > 1 and all(rod(part) is not None for part in parts)


def _patterns(text: str) -> list[str]:
    """Return the names of the patterns for the material and category in ``text``."""
    styles: list[dict[str, list[str]]] = priors().patterns["styles"]
    return next(style["patterns"] for style in styles if any(word in text for word in style.get("words", [""])))


def _second(base: Color, is_natural: bool, palette: tuple[Color, ...], rng: Rng) -> Color:
    """Choose the second color of a pattern.

    For natural patterns, this is a darker shade of the first color. Otherwise, it is a contrasting color.
    """
    if is_natural:
        share = rng.uniform(0.45, 0.75)
        r, g, b = (round(v * share, 3) for v in base)
        return r, g, b
    far = [c for c in palette if color_gap(c, base) > 0.5] or [priors().white]
    return varied(far[int(rng.integers(len(far)))], rng)


def _painted(pattern: Pattern, base: Color, second: Color, rng: Rng) -> bytes:
    """Draw a texture with a pattern in the lower two thirds and a plain color above.

    Insides and edges use the plain color.

    Returns:
        The texture as PNG data.
    """
    from PIL import Image

    u, v = np.meshgrid((np.arange(PIXELS) + 0.5) / PIXELS, 1 - (np.arange(PIXELS) + 0.5) / PIXELS)
    share = np.clip(pattern(u, np.clip(v / PAINTED, 0.0, 1.0), rng), 0.0, 1.0)
    share[v > PAINTED] = 0.0
    rgb = (1 - share[..., None]) * np.array(base) + share[..., None] * np.array(second)
    stream = io.BytesIO()
    Image.fromarray(np.round(255 * rgb).astype(np.uint8)).save(stream, format="PNG")
    return stream.getvalue()


# Fraction of a texture's height that contains the pattern.
PAINTED = 0.66

# Vertical texture coordinate at which the texture has a plain color.
PLAIN = 0.83


# -- surfaces ---------------------------------------------------------------------------------------------------------


def _meshed(part: PartSpec, image: bytes, around: bool) -> Mesh | None:
    """Convert a part's shape to a closed mesh with an image on its visible surfaces.

    Args:
        part: The part.
        image: The texture as PNG data.
        around: True if the pattern wraps around the axis, even on flat objects such as plates.

    Returns:
        The mesh, or None if the shape is not supported.
    """
    match part.shape:
        case LatheShape():
            return _turned(Profile.of(part.shape), image, around)
        case SphereShape(sphere=r):
            arc = np.linspace(-np.pi / 2, np.pi / 2, 25)
            return _turned(Profile(np.column_stack([r * np.cos(arc), r * np.sin(arc)]), np.zeros((0, 2))), image)
        case BoxShape():
            return _box(np.array(part.shape.box), image)
        case PrismShape():
            return _prism(np.array(part.shape.prism.outline), part.shape.prism.height, image)
    if (size := rod(part)) is not None:
        r, half = size[0], size[1] / 2
        bend = np.linspace(0.0, np.pi / 2, 9) if hasattr(part.shape, "capsule") else np.zeros(1)
        cap = np.column_stack([r * np.cos(bend), half + r * np.sin(bend)])
        outer = np.concatenate([cap[::-1] * [1.0, -1.0], cap])
        return _turned(Profile(np.concatenate([outer[:1] * [0.0, 1.0], outer]), outer[-1:] * [0.0, 1.0]), image)
    return None


def _turned(profile: Profile, image: bytes, around: bool = True) -> Mesh:
    """Revolve a profile about z and apply an image to it.

    On plates and bowls, the image covers the inside from the center to the rim. On all objects except plates, it covers
    the outside from the bottom to the rim. Other surfaces are plain. On the inside, the image is projected from above,
    or wrapped around the axis if ``around`` is set.
    """
    outer, inner = profile.outer, profile.inner
    widest = float(outer[:, 0].max())
    slender = profile.height / widest if profile.is_hollow else np.inf
    back = np.concatenate([outer[-1:], inner]) if len(inner) else np.zeros((0, 2))
    rings = np.concatenate([outer, back])
    angle = np.linspace(0.0, 2 * np.pi, AROUND + 1)
    x, y = rings[:, :1] * np.cos(angle), rings[:, :1] * np.sin(angle)
    vertices = np.stack([x, y, np.repeat(rings[:, 1:], AROUND + 1, axis=1)], axis=2)
    vertices[:, -1] = vertices[:, 0]
    skip = int(outer[0, 0] < 1e-9 and outer[1, 1] - outer[0, 1] < 1e-6)  # skip a level bottom, which is not visible
    up = np.full(len(outer), PLAIN) if slender < FLAT else PAINTED * _shares(outer, skip)
    down = PAINTED * (1 - _shares(back, 0)) if slender < LOW else np.full(len(back), PLAIN)
    uv = np.stack(np.broadcast_arrays(angle / (2 * np.pi), np.concatenate([up, down])[:, None]), axis=2).copy()
    if slender < LOW and not around:
        uv[len(outer) :] = (np.stack([x, y], axis=2)[len(outer) :] / (2 * widest) + 0.5) * [1.0, PAINTED]
    faces = strips(np.arange(len(rings) * (AROUND + 1)).reshape(len(rings), -1))
    off_axis = rings[:, 0] > 1e-9
    faces[~off_axis[1:], 0, :, 2] -= 1  # on the axis, the two triangles of a quadrilateral merge into one
    every = faces[np.column_stack([off_axis[:-1], off_axis[1:]])].reshape(-1, 3)
    return Mesh(frozen_array(vertices.reshape(-1, 3)), every, frozen_array(uv.reshape(-1, 2)), image)


def _shares(chain: Array, skip: int) -> Array:
    """Return the relative arc length at each point of a chain, as an array of shape (k,).

    The arc length is measured from point ``skip`` and scaled to 1 at the end. It is 0 before point ``skip``.
    """
    if not len(chain):
        return np.zeros(0)
    length = arc_lengths(chain)
    return np.asarray(np.clip((length - length[skip]) / (length[-1] - length[skip]), 0.0, 1.0))


def _box(size: Array, image: bytes) -> Mesh:
    """Return a box with the image on each face."""
    vertices, uv, faces = [], [], []
    for k, (axis, sign) in enumerate(product(range(3), (-1.0, 1.0))):
        left, up = (axis + 1) % 3, (axis + 2) % 3
        corners = np.empty((4, 3))
        corners[:, axis], corners[:, left], corners[:, up] = sign, [-1, 1, 1, -1], [-1, -1, 1, 1]
        vertices.append(corners * size / 2)
        turn = ((0, 0), (0, 1), (1, 1), (1, 0)) if size[left] < size[up] else ((0, 0), (1, 0), (1, 1), (0, 1))
        uv.append(np.array(turn) * [1.0, PAINTED])
        faces.append(np.array(((0, 1, 2), (0, 2, 3)) if sign > 0 else ((0, 2, 1), (0, 3, 2))) + 4 * k)
    every = np.concatenate(faces).astype(np.int32)
    return Mesh(frozen_array(np.concatenate(vertices)), every, frozen_array(np.concatenate(uv)), image)


def _prism(outline: Array, height: float, image: bytes) -> Mesh | None:
    """Return a convex prism with the image on its sides and plain ends.

    The result is None if the outline is not convex.
    """
    edges = np.roll(outline, -1, axis=0) - outline
    after = np.roll(edges, -1, axis=0)
    turns = edges[:, 0] * after[:, 1] - edges[:, 1] * after[:, 0]
    if (turns < -1e-12).any() and (turns > 1e-12).any():
        return None
    ring = outline if turns.sum() > 0 else outline[::-1]
    n = len(ring)
    closed = np.concatenate([ring, ring[:1]])
    way = arc_lengths(closed)
    levels = (-height / 2, height / 2)
    walls = np.concatenate([np.column_stack([closed, np.full(n + 1, z)]) for z in levels])
    around = np.concatenate([np.column_stack([way / way[-1], np.full(n + 1, v)]) for v in (0.0, PAINTED)])
    ends = np.concatenate([np.column_stack([ring, np.full(n, z)]) for z in levels])
    fan = np.arange(1, n - 1)
    low, high = 2 * (n + 1), 2 * (n + 1) + n
    faces = [strips(np.arange(low).reshape(2, -1)).reshape(-1, 3)]
    faces += [np.column_stack([np.full(n - 2, low), low + fan + 1, low + fan])]
    faces += [np.column_stack([np.full(n - 2, high), high + fan, high + fan + 1])]
    uv = np.concatenate([around, np.full((2 * n, 2), PLAIN)])
    vertices = np.concatenate([walls, ends])
    return Mesh(frozen_array(vertices), np.concatenate(faces).astype(np.int32), frozen_array(uv), image)


# -- patterns ---------------------------------------------------------------------------------------------------------


def _dots(u: Field, v: Field, rng: Rng) -> Field:
    n, m = int(rng.integers(7, 15)), int(rng.integers(4, 8))
    row = np.floor(v * m)
    x, y = (u * n + 0.5 * (row % 2)) % 1 - 0.5, (v * m) % 1 - 0.5
    return _soft(rng.uniform(0.2, 0.34) - np.hypot(x, y), 0.0, 12.0)


def _checks(u: Field, v: Field, rng: Rng) -> Field:
    n, m = int(rng.integers(5, 11)), int(rng.integers(3, 7))
    return _soft(np.sin(2 * np.pi * n * u) * np.sin(np.pi * m * v), 0.0, 20.0)


def _rim(_: Field, v: Field, rng: Rng) -> Field:
    """Paint a band below the rim and a thin line below the band."""
    low = rng.uniform(0.7, 0.85)
    return np.asarray((v > low) | (np.abs(v - low + 0.06) < 0.014), dtype=np.float64)


def _dipped(u: Field, v: Field, rng: Rng) -> Field:
    """Paint the lower part with a different glaze that has an uneven edge."""
    edge = rng.uniform(0.3, 0.6) + 0.04 * _wave(u, rng)
    return _soft(edge - v, 0.0, 60.0)


def _drips(u: Field, v: Field, rng: Rng) -> Field:
    """Paint glaze that has run down from the rim."""
    run = 0.25 + 0.18 * np.abs(_wave(u, rng)) + 0.1 * np.abs(np.sin(np.pi * int(rng.integers(5, 9)) * u))
    return _soft(v - 1 + run, 0.0, 60.0)


def _zigzag(u: Field, v: Field, rng: Rng) -> Field:
    n, at = int(rng.integers(6, 14)), rng.uniform(0.4, 0.65)
    wave = np.abs((u * n) % 1 - 0.5)
    return _soft(np.sin(2 * np.pi * (v - at + 0.28 * wave) * rng.integers(3, 6)), 0.1)


def _streaks(u: Field, v: Field, rng: Rng) -> Field:
    """Paint fine vertical streaks that fade out, as on an apple."""
    field = sum(np.cos(2 * np.pi * (int(k) * u + rng.random())) for k in rng.integers(5, 60, 9)) / 5
    return np.asarray(np.clip(0.3 + 0.5 * field, 0.0, 0.7) * np.clip(0.3 + v, 0.0, 1.0))


def _gradient(_: Field, v: Field, rng: Rng) -> Field:
    """Paint a gradual transition between the two colors."""
    at, soft = rng.uniform(0.3, 0.7), rng.uniform(0.1, 0.25)
    return np.asarray(1 / (1 + np.exp((v - at) / soft)))


def _grain(u: Field, v: Field, rng: Rng) -> Field:
    """Paint wood grain as wavy lines along u."""
    bend = 0.06 * _wave(u, rng) + 0.03 * np.sin(2 * np.pi * (u + 2 * v))
    rings = np.sin(2 * np.pi * rng.uniform(7, 14) * (v + bend))
    fine = np.sin(2 * np.pi * rng.uniform(40, 60) * (v + bend))
    return np.asarray(np.clip(0.42 + 0.38 * rings + 0.15 * fine, 0.0, 1.0))


def _planks(u: Field, v: Field, rng: Rng) -> Field:
    """Paint boards side by side."""
    n = int(rng.integers(3, 6))
    tone = rng.uniform(0.0, 0.55, n)[np.minimum((v * n).astype(int), n - 1)]
    lines = 0.12 * np.sin(2 * np.pi * 9 * (v + 0.05 * _wave(u, rng)))
    return np.asarray(np.where((v * n) % 1 < 0.05, 1.0, tone + lines))


def _print(u: Field, v: Field, rng: Rng) -> Field:
    """Paint a label and lines, as printed on a carton."""
    x, y = rng.uniform(0.25, 0.6), rng.uniform(0.35, 0.6)
    label = (np.abs(u - x) < 0.16) & (np.abs(v - y) < 0.2)
    lines = (u > 0.72) & (u < 0.93) & ((v * 14) % 1 < 0.4) & (v > 0.25) & (v < 0.75)
    return np.asarray(label | lines, dtype=np.float64)


def _soft(value: Field, threshold: float, sharp: float = 9.0) -> Field:
    """Return a smooth step that rises from 0 below the threshold to 1 above it."""
    return np.asarray(np.clip(0.5 + sharp * (value - threshold), 0.0, 1.0))


def _wave(u: Field, rng: Rng) -> Field:
    """Return a smooth, periodic random function of u with values from about -1 to 1."""
    return np.asarray(sum(np.sin(2 * np.pi * (k * u + rng.random())) / k for k in (1, 2, 3, 5)) / 2.0)


def _flecks(u: Field, v: Field, rng: Rng, count: int, size: float) -> Field:
    out = np.zeros_like(u)
    for x, y, r in zip(rng.random(count), rng.random(count), size * rng.uniform(0.5, 1.5, count), strict=True):
        across = np.abs(u - x)
        out = np.maximum(out, np.hypot(np.minimum(across, 1 - across), v - y) < r)
    return out


PATTERNS: dict[str, Pattern] = {
    "bands": lambda _, v, r: _soft(np.sin(2 * np.pi * (r.integers(2, 7) * v + r.random())), r.uniform(-0.4, 0.4)),
    "stripes": lambda u, _, r: _soft(np.sin(2 * np.pi * int(r.integers(6, 18)) * u), r.uniform(-0.3, 0.6)),
    # Stripes that spiral around the axis.
    "a spiral": lambda u, v, r: _soft(
        np.sin(2 * np.pi * (int(r.integers(4, 10)) * u + r.uniform(1, 4) * v)), r.uniform(-0.3, 0.4)
    ),
    "dots": _dots,
    "checks": _checks,
    "a painted rim": _rim,
    "a dipped foot": _dipped,
    "drips of glaze": _drips,
    "zigzags": _zigzag,
    # Many small flecks, as on stoneware or ripe fruit.
    "speckles": lambda u, v, r: _flecks(u, v, r, int(r.integers(120, 260)), 0.008),
    "terrazzo": lambda u, v, r: _flecks(u, v, r, int(r.integers(40, 80)), 0.028),
    "streaks": _streaks,
    "a gradient": _gradient,
    "wood grain": _grain,
    "planks": _planks,
    "print": _print,
    # A strip of tape along the middle.
    "tape": lambda _, v, r: np.asarray(np.abs(v - r.uniform(0.4, 0.6)) < 0.09, dtype=np.float64),
}
