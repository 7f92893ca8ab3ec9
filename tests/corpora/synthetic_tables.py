"""Random tables as cameras of several makers see them, each from one seed, with the truth about every pixel.

Cartons with prints, cans, balls, bowls, mugs, bottles, plates and books stand apart, against each other and on each
other, on square and round tables above a floor and before a wall. A table on which an object is hardly visible is
drawn again, so that nobody could count it otherwise.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.solids import lathe_mesh
from simfoundry.capture.frame import Frame
from simfoundry.capture.synthesize import SENSORS, simulate_frame
from simfoundry.geometry.frames import Array, Pose, frozen_array, look_at, quat_from_rpy
from simfoundry.geometry.shapes import Box, Cylinder, Geometry, Mesh, Sphere
from simfoundry.render.raycast import Raycast, raycast
from simfoundry.scene.model import Camera, Link, Scene, SceneObject, Visual

Rng = np.random.Generator

VISIBLE = 0.3
"""The share of an object's silhouette that must be in the picture: with less, people do not agree on what it is."""

PIXELS = 250
"""The fewest pixels of an object: 16 by 16 on the sensor."""


@dataclass(frozen=True, eq=False)
class SyntheticTable:
    """A table: its scene, whose first object is the support, the camera, the sensor's name and the noisy frame."""

    seed: int
    scene: Scene
    camera: Camera
    sensor: str
    frame: Frame
    truth: NDArray[np.int32]

    @property
    def count(self) -> int:
        """The number of objects on the table."""
        return len(np.unique(self.truth[self.truth > 0]))


@dataclass(frozen=True, eq=False)
class _Solid:
    """An object before it is placed: its parts on z = 0, its height and radius [m], and whether it can carry."""

    parts: tuple[tuple[Geometry, Pose, Array], ...]
    height: float
    radius: float
    flat: tuple[float, float] | None = None


def synthetic_table(seed: int) -> SyntheticTable:
    """The table of a seed."""
    for attempt in range(40):
        rng = np.random.default_rng((seed, attempt))
        scene, first = _scene(rng)
        camera = _camera(rng)
        sensor = sorted(SENSORS)[int(rng.integers(len(SENSORS)))]
        ray = raycast(scene, camera)
        truth = np.where(ray.objects > first, ray.objects - first, 0).astype(np.int32)
        if _countable(scene, first, ray, truth):
            frame = simulate_frame(ray, rng, SENSORS[sensor])
            clean = Frame(frame.color, frame.depth, frame.K)
            return SyntheticTable(seed, scene, camera, sensor, clean, truth)
    raise RuntimeError(f"no countable table was drawn from seed {seed}")


def _countable(scene: Scene, first: int, ray: Raycast, truth: NDArray[np.int32]) -> bool:
    """Whether enough of every object is visible."""
    import cv2

    c = ray.camera
    for k, item in enumerate(scene.objects[first:], 1):
        points = np.concatenate([(item.X_WO @ v.X_LG).apply(_vertices(v.geometry)) for v in item.root.visuals])
        in_camera = c.X_WC.inverse().apply(points)
        pixels = in_camera[:, :2] / in_camera[:, 2:] * [c.fx, c.fy] + [c.cx, c.cy]
        area = float(cv2.contourArea(cv2.convexHull(pixels.astype(np.float32))))
        seen = int((truth == k).sum())
        if seen < PIXELS or seen < VISIBLE * area:
            return False
        rows, columns = np.nonzero(truth == k)
        if min(rows.min(), columns.min(), c.height - 1 - rows.max(), c.width - 1 - columns.max()) < 8:
            return False
    return True


def _vertices(geometry: Geometry) -> Array:
    from simfoundry.geometry.shapes import tessellate

    return tessellate(geometry).vertices


def _camera(rng: Rng) -> Camera:
    pitch, distance = math.radians(rng.uniform(28, 62)), rng.uniform(0.75, 1.25)
    target = np.array([rng.uniform(-0.04, 0.04), rng.uniform(-0.04, 0.04), 0.04])
    eye = target + distance * np.array([-math.cos(pitch), 0.0, math.sin(pitch)])
    roll = Pose.of(q=quat_from_rpy(0.0, 0.0, float(rng.normal(0, 0.03))))
    f = rng.uniform(520, 640)
    return Camera("view", 640, 480, f, f, 319.5 + rng.uniform(-6, 6), 239.5 + rng.uniform(-6, 6),
                  look_at(eye, target) @ roll)  # fmt: skip


def _scene(rng: Rng) -> tuple[Scene, int]:
    """A random scene, and how many of its objects are support and surroundings."""
    surroundings = [_table(rng)]
    floor = float(rng.uniform(0.4, 0.8))
    tones = _tone(rng), _tone(rng)
    surroundings.append(_object("floor", Pose.of((0, 0, -floor)), [(_box(8, 8, 0.02), Pose.of(), tones[0])], True))
    if rng.random() < 0.4:
        wall = _box(0.05, 6, 4), Pose.of((float(rng.uniform(0.75, 1.5)), 0, 0.5)), tones[1]
        surroundings.append(_object("wall", Pose.of(), [wall], True))
    objects = _placed(rng, int(rng.integers(1, 11)))
    return Scene(name="table", gravity=frozen_array([0, 0, -9.81]), objects=(*surroundings, *objects)), len(
        surroundings
    )


def _table(rng: Rng) -> SceneObject:
    if rng.random() < 0.3:
        top: Geometry = Cylinder(float(rng.uniform(0.42, 0.6)), 0.03)
    else:
        x, y = float(rng.uniform(0.75, 1.1)), float(rng.uniform(0.85, 1.5))
        top = _printed_box(rng, (x, y, 0.03), _tone(rng)) if rng.random() < 0.6 else _box(x, y, 0.03)
    yaw = Pose.of((0, 0, -0.015), quat_from_rpy(0, 0, float(rng.uniform(-0.5, 0.5))))
    color = frozen_array([1, 1, 1, 1]) if isinstance(top, Mesh) else _tone(rng)
    return _object("table", Pose.of(), [(top, yaw, color)], True)


def _placed(rng: Rng, count: int) -> list[SceneObject]:
    """Objects that stand on the table or on each other without overlap."""
    out: list[SceneObject] = []
    taken: list[tuple[Array, float]] = []
    carriers: list[tuple[Array, float, float, float, tuple[float, float]]] = []
    gap = float(rng.choice([0.002, 0.008, 0.02], p=[0.2, 0.4, 0.4]))
    for _ in range(count * 30):
        if len(out) == count:
            break
        solid = _KINDS[int(rng.integers(len(_KINDS)))](rng)
        yaw = float(rng.uniform(-math.pi, math.pi))
        free = [c for c in carriers if min(c[4]) / 2 > 0.8 * solid.radius]
        if free and rng.random() < 0.3:
            at, z, turn, _, flat = free[int(rng.integers(len(free)))]
            carriers = [c for c in carriers if c[0] is not at]
            slack = np.maximum(np.array(flat) / 2 - solid.radius, 0.0)
            shift = np.append(rng.uniform(-slack, slack), 0)
            p = np.append(at, z) + Pose.of(q=quat_from_rpy(0, 0, turn)).apply(shift)
        else:
            at = rng.uniform([-0.22, -0.28], [0.22, 0.28])
            if any(np.linalg.norm(at - q) < r + solid.radius + gap for q, r in taken):
                continue
            taken.append((at, solid.radius))
            p = np.append(at, 0.0)
        X_WO = Pose.of(p, quat_from_rpy(0, 0, yaw))
        out.append(_object(f"object_{len(out) + 1}", X_WO, list(solid.parts), False))
        if solid.flat is not None:
            carriers.append((p[:2], float(p[2]) + solid.height, yaw, solid.radius, solid.flat))
    return out


def _object(name: str, X_WO: Pose, parts: list[tuple[Geometry, Pose, Array]], fixed: bool) -> SceneObject:
    visuals = tuple(Visual(f"v{k}", g, c, X) for k, (g, X, c) in enumerate(parts))
    link = Link(
        name="body", mass=0.2, com=frozen_array([0, 0, 0]), inertia=frozen_array(np.eye(3) * 1e-4), visuals=visuals,
        colliders=(),
    )  # fmt: skip
    return SceneObject(name, category=name, fixed=fixed, X_WO=X_WO, links=(link,))


# -- what objects look like --------------------------------------------------------------------------------------------


def _tone(rng: Rng) -> Array:
    """A color: dull, vivid, bright or dark."""
    import colorsys

    value = float(rng.uniform(0.15, 0.95))
    saturation = float(rng.choice([rng.uniform(0, 0.15), rng.uniform(0.3, 0.95)]))
    return frozen_array([*colorsys.hsv_to_rgb(float(rng.random()), saturation, value), 1.0])


def _box(x: float, y: float, z: float) -> Box:
    return Box(frozen_array([x, y, z]))


def _print(rng: Rng, base: Array) -> bytes:
    """A picture of patches and stripes on a ground color, as PNG."""
    from PIL import Image

    size = 96
    image = np.tile((base[:3] * 255).astype(np.uint8), (size, size, 1))
    for _ in range(int(rng.integers(1, 8))):
        (r0, c0), (h, w) = rng.integers(0, size - 8, 2), rng.integers(4, 56, 2)
        image[r0 : r0 + h, c0 : c0 + w] = (_tone(rng)[:3] * 255).astype(np.uint8)
    noisy = np.clip(image + rng.normal(0, 6, image.shape), 0, 255).astype(np.uint8)
    stream = io.BytesIO()
    Image.fromarray(noisy).save(stream, format="PNG")
    return stream.getvalue()


def _printed_box(rng: Rng, size: tuple[float, float, float], base: Array) -> Mesh:
    """A box, each side of which shows the whole print."""
    corners: list[Array] = []
    faces: list[list[int]] = []
    uv: list[tuple[int, int]] = []
    half = np.array(size) / 2
    for axis in range(3):
        for sign in (1, -1):
            u, v = ((axis + 1) % 3, (axis + 2) % 3) if sign > 0 else ((axis + 2) % 3, (axis + 1) % 3)
            start = len(corners)
            for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)):
                p = np.zeros(3)
                p[axis], p[u], p[v] = sign * half[axis], (2 * a - 1) * half[u], (2 * b - 1) * half[v]
                corners.append(p)
                uv.append((a, b))
            faces += [[start, start + 1, start + 2], [start, start + 2, start + 3]]
    return Mesh(frozen_array(np.array(corners)), np.array(faces, np.int32), frozen_array(np.array(uv, float)),
                _print(rng, base))  # fmt: skip


def _carton(rng: Rng, low: tuple[float, ...], high: tuple[float, ...]) -> _Solid:
    x, y, z = (float(v) for v in rng.uniform(low, high))
    tone = _tone(rng)
    geometry: Geometry = _box(x, y, z)
    color = tone
    if rng.random() < 0.65:
        geometry, color = _printed_box(rng, (x, y, z), tone), frozen_array([1, 1, 1, 1])
    return _Solid(((geometry, Pose.of((0, 0, z / 2)), color),), z, math.hypot(x, y) / 2, (x, y))


def _can(rng: Rng) -> _Solid:
    radius, height = float(rng.uniform(0.025, 0.05)), float(rng.uniform(0.05, 0.14))
    side = radius * math.sqrt(2)
    return _Solid(tuple(_banded(rng, radius, 0.0, height)), height, radius, (side, side))


def _banded(rng: Rng, radius: float, low: float, high: float) -> list[tuple[Geometry, Pose, Array]]:
    """A cylinder between two heights, every other one with a label around it, which is no boundary of objects."""
    if rng.random() < 0.5:
        return [(Cylinder(radius, high - low), Pose.of((0, 0, (low + high) / 2)), _tone(rng))]
    tones = _tone(rng), _tone(rng)
    cuts = [low, low + (high - low) * float(rng.uniform(0.08, 0.35)), high - (high - low) * float(rng.uniform(0, 0.3))]
    ends = [*cuts, high] if high - cuts[-1] > 0.004 else [*cuts[:-1], high]
    return [
        (Cylinder(radius, b - a), Pose.of((0, 0, (a + b) / 2)), tones[k % 2]) for k, (a, b) in enumerate(pairwise(ends))
    ]


def _roll(rng: Rng) -> _Solid:
    radius, length = float(rng.uniform(0.02, 0.04)), float(rng.uniform(0.08, 0.18))
    body = Cylinder(radius, length), Pose.of((0, 0, radius), quat_from_rpy(math.pi / 2, 0, 0)), _tone(rng)
    return _Solid((body,), 2 * radius, math.hypot(length / 2, radius))


def _ball(rng: Rng) -> _Solid:
    radius = float(rng.uniform(0.02, 0.05))
    return _Solid(((Sphere(radius), Pose.of((0, 0, radius)), _tone(rng)),), 2 * radius, radius)


def _lathe(profile: list[tuple[float, float]], color: Array) -> tuple[Geometry, Pose, Array]:
    vertices, faces = lathe_mesh(frozen_array(np.array(profile)))
    low, high = vertices[:, 2].min(), vertices[:, 2].max()
    return Mesh(frozen_array(vertices), faces), Pose.of((0, 0, -float(low) if abs(low + high) < 1e-9 else 0)), color


def _vessel(bottom: float, top: float, height: float, color: Array) -> tuple[Geometry, Pose, Array]:
    wall = 0.004
    outer = [(0.0, 0.0), (bottom, 0.0), (top, height)]
    return _lathe([*outer, (top - wall, height), (max(bottom - wall, 0.006), wall), (0.0, wall)], color)


def _bowl(rng: Rng) -> _Solid:
    top, height = float(rng.uniform(0.05, 0.09)), float(rng.uniform(0.035, 0.07))
    return _Solid((_vessel(0.55 * top, top, height, _tone(rng)),), height, top)


def _mug(rng: Rng) -> _Solid:
    radius, height, color = float(rng.uniform(0.034, 0.046)), float(rng.uniform(0.075, 0.11)), _tone(rng)
    grip, thick = 0.5 * height, 0.009
    at = radius + 0.022
    handle = [
        (_box(0.03, thick, thick), Pose.of((radius + 0.01, 0, height / 2 + grip / 2)), color),
        (_box(0.03, thick, thick), Pose.of((radius + 0.01, 0, height / 2 - grip / 2)), color),
        (_box(thick, thick, grip + thick), Pose.of((at, 0, height / 2)), color),
    ]
    return _Solid((_vessel(radius, radius, height, color), *handle), height, radius + 0.028)


def _plate(rng: Rng) -> _Solid:
    top = float(rng.uniform(0.07, 0.1))
    return _Solid((_vessel(0.6 * top, top, float(rng.uniform(0.018, 0.026)), _tone(rng)),), 0.02, top)


def _bottle(rng: Rng) -> _Solid:
    radius, height, neck = (float(rng.uniform(*r)) for r in ((0.028, 0.042), (0.15, 0.26), (0.011, 0.016)))
    body = 0.62 * height
    profile = [(0.0, 0.0), (radius, 0.0), (radius, body), (neck, 0.85 * height), (neck, height), (0.0, height)]
    parts = [_lathe(profile, _tone(rng))]
    if rng.random() < 0.4:
        label = Cylinder(radius + 0.0005, body * float(rng.uniform(0.3, 0.7))), Pose.of((0, 0, body / 2)), _tone(rng)
        parts.append(label)
    if rng.random() < 0.5:
        parts.append((Cylinder(neck + 0.003, 0.02), Pose.of((0, 0, height - 0.004)), _tone(rng)))
    return _Solid(tuple(parts), height, radius)


_KINDS: tuple[Callable[[Rng], _Solid], ...] = (
    lambda rng: _carton(rng, (0.05, 0.03, 0.1), (0.16, 0.08, 0.24)),  # upright cartons
    lambda rng: _carton(rng, (0.1, 0.07, 0.02), (0.22, 0.16, 0.06)),  # books and flat boxes
    lambda rng: _carton(rng, (0.04, 0.04, 0.03), (0.08, 0.08, 0.08)),  # blocks
    _can, _can, _roll, _ball, _bowl, _mug, _plate, _bottle,
)  # fmt: skip
