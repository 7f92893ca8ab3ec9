"""Synthetic pictures of YCB objects, alone and in piles, each from one seed, with the truth about every pixel.

The meshes are those of ``../shared/data/ycb_models``. Objects are dropped in MuJoCo in random orientations, with their
convex parts as colliders, and come to rest, so that they lie, lean and stand as they do on a table.
"""

from __future__ import annotations

import functools
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets import mass
from simfoundry.assets.convex import hull
from simfoundry.assets.mesh import read_mesh
from simfoundry.capture.frame import Frame
from simfoundry.capture.synthesize import SENSORS, simulate_frame
from simfoundry.geometry.frames import Array, Pose, frozen_array, look_at, quat_from_rpy
from simfoundry.geometry.shapes import Box, Mesh
from simfoundry.render.raycast import raycast
from simfoundry.scene.model import Camera, Collider, Link, Scene, SceneObject, Visual
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.rest import run_to_rest
from tests.corpora.synthetic_tables import SyntheticTable

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "ycb_models"
NAMES = tuple(sorted(p.name for p in DATA.iterdir() if p.is_dir())) if DATA.is_dir() else ()
HALVES = NAMES[::2], NAMES[1::2]
"""Every other object, so that both halves have cartons, cans, bottles and tools."""

THREE_SENSORS = ("stereo", "structured_light", "time_of_flight")
PILE = 8
"""The number of objects of a pile, and the side of the square in which they are dropped [m]."""
SQUARE = 0.4
FEW_PIXELS = 150
"""The fewest visible pixels of an object that somebody could reconstruct: 12 by 12."""
PATIENCE = 60
"""How many tries to draw a picture in which every object is visible."""


@functools.cache
def ycb_mesh(name: str) -> Mesh:
    """The mesh of an object in its own frame, with its texture."""
    (part,) = read_mesh(DATA / name / "textured.obj")
    return Mesh(frozen_array(part.vertices), part.faces, part.uv, part.texture)


@functools.cache
def _body(name: str) -> Link:
    weight = float(json.loads((DATA / "models.json").read_text())["objects"][name]["mass_kg"])
    shape = ycb_mesh(name)
    moments = mass.mesh(*hull(shape.vertices))
    colliders = []
    for k, file in enumerate(sorted((DATA / name).glob("textured_coacd_*.stl"))):
        (part,) = read_mesh(file)
        vertices, faces = hull(part.vertices)
        colliders.append(Collider(f"c{k}", Mesh(frozen_array(vertices), faces), 0.6, 0.0, Pose.of(), 0.005, 0.001))
    inertia = np.asarray(moments.inertia) * weight / moments.volume
    return Link("body", weight, frozen_array(moments.com), frozen_array(inertia),
                (Visual("v", shape, frozen_array([1, 1, 1, 1])),), tuple(colliders))  # fmt: skip


def ycb_object(name: str, X_WO: Pose) -> SceneObject:
    """An object at a pose."""
    return SceneObject(f"ycb_{name[4:]}", category=name[4:], fixed=False, X_WO=X_WO, links=(_body(name),))


def _fixed(name: str, size: tuple[float, float, float], p: tuple[float, float, float], color: Array) -> SceneObject:
    box = Box(frozen_array(size))
    link = Link("body", 1.0, frozen_array([0, 0, 0]), frozen_array(np.eye(3) * 1e-3),
                (Visual("v", box, color),), (Collider("c", box, 0.6, 0.0),))  # fmt: skip
    return SceneObject(name, category=name, fixed=True, X_WO=Pose.of(p), links=(link,))


def _table() -> SceneObject:
    return _fixed("table", (1.2, 1.4, 0.04), (0, 0, -0.02), frozen_array([0.55, 0.45, 0.36, 1]))


def _scene(objects: list[SceneObject], walls: bool = False) -> Scene:
    gray, half = frozen_array([0.5, 0.5, 0.5, 1]), SQUARE / 2 + 0.02
    around = [
        _fixed(f"wall_{x + 1}{y + 1}", (0.04 + 0.4 * abs(y), 0.04 + 0.4 * abs(x), 0.8), (x * half, y * half, 0.4), gray)
        for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))
    ]
    fixed = [_table(), *(around if walls else [])]
    return Scene(name="ycb", gravity=frozen_array([0, 0, -9.81]), objects=(*fixed, *objects))


def _rested(objects: list[SceneObject], walls: bool) -> list[SceneObject] | None:
    """The objects where they come to rest, or None if one does not or leaves the table."""
    with MujocoWorld(_scene(objects, walls)) as world:
        moving = run_to_rest(world, 0.2, 0.4, 6.0, lambda state: ())
        poses = world.state().poses
    if (moving and not walls) or any(poses[o.name].p[2] < -0.01 for o in objects):
        return None
    return [ycb_object(_named(o), poses[o.name]) for o in objects]


def _named(item: SceneObject) -> str:
    return next(name for name in NAMES if name[4:] == item.category)


def _orientation(rng: np.random.Generator) -> Array:
    q = rng.normal(size=4)
    return np.asarray(q / np.linalg.norm(q))


def _camera(rng: np.random.Generator, distance: tuple[float, float]) -> Camera:
    pitch, far = math.radians(rng.uniform(32, 58)), rng.uniform(*distance)
    turn = rng.uniform(-math.pi, math.pi)
    target = np.array([*rng.uniform(-0.02, 0.02, 2), 0.04])
    away = np.array([math.cos(pitch) * math.cos(turn), math.cos(pitch) * math.sin(turn), math.sin(pitch)])
    roll = Pose.of(q=quat_from_rpy(0.0, 0.0, float(rng.normal(0, 0.03))))
    f = float(rng.uniform(540, 640))
    return Camera("view", 640, 480, f, f, 319.5, 239.5, look_at(target + far * away, target) @ roll)


def _picture(seed: int, rng: np.random.Generator, objects: list[SceneObject], sensor: str,
             distance: tuple[float, float]) -> SyntheticTable | None:  # fmt: skip
    scene, camera = _scene(objects), _camera(rng, distance)
    if not _is_visible(raycast(scene, _smaller(camera)).objects - 1, len(objects), FEW_PIXELS // 32):
        return None  # most pictures are rejected, so that they are drawn small first
    ray = raycast(scene, camera)
    truth = np.where(ray.objects > 1, ray.objects - 1, 0).astype(np.int32)
    if not _is_visible(truth, len(objects), FEW_PIXELS):
        return None
    frame = simulate_frame(ray, rng, SENSORS[sensor])
    return SyntheticTable(seed, scene, camera, sensor, Frame(frame.color, frame.depth, frame.K), truth)


def _smaller(camera: Camera) -> Camera:
    """The camera with a quarter of the pixels along each side."""
    return replace(camera, width=160, height=120, fx=camera.fx / 4, fy=camera.fy / 4, cx=79.5, cy=59.5)


def _is_visible(truth: NDArray[np.int32], count: int, pixels: int) -> bool:
    """Whether every object has enough pixels, and none is at the edge."""
    edge = np.concatenate([truth[:2].ravel(), truth[-2:].ravel(), truth[:, :2].ravel(), truth[:, -2:].ravel()])
    return not (edge > 0).any() and min(int((truth == k).sum()) for k in range(1, count + 1)) >= pixels


def isolated(name: str, seed: int) -> SyntheticTable:
    """One object at rest on a table; the sensor follows from the seed."""
    for attempt in range(PATIENCE):
        rng = np.random.default_rng((seed, attempt, NAMES.index(name)))
        start = Pose.of((*rng.uniform(-0.03, 0.03, 2), 0.16), _orientation(rng))
        at = start.p - start.apply(ycb_mesh(name).vertices.mean(axis=0)) + [0, 0, 0.32]
        objects = _rested([ycb_object(name, Pose.of(at, start.q))], False)
        if objects is not None:
            p = objects[0].X_WO.apply(ycb_mesh(name).vertices.mean(axis=0))
            centered = Pose.of(objects[0].X_WO.p - [p[0], p[1], 0], objects[0].X_WO.q)
            found = _picture(seed, rng, [ycb_object(name, centered)], THREE_SENSORS[seed % 3], (0.6, 0.95))
            if found is not None:
                return found
    raise RuntimeError(f"{name} was not drawn from seed {seed}")


def pile(seed: int, names: tuple[str, ...] = NAMES) -> SyntheticTable:
    """Eight objects dropped into a square of 40 cm, whose walls are gone when they come to rest."""
    for attempt in range(PATIENCE):
        rng = np.random.default_rng((seed, attempt, len(names)))
        chosen = [names[k] for k in rng.permutation(len(names))[:PILE]]
        objects: list[SceneObject] = []
        for k, name in enumerate(chosen):
            q = _orientation(rng)
            middle = Pose.of(q=q).apply(ycb_mesh(name).vertices.mean(axis=0))
            at = np.array([*rng.uniform(-0.1, 0.1, 2), 0.2 + 0.22 * k]) - middle
            objects.append(ycb_object(name, Pose.of(at, q)))
        rested = _rested(objects, True)
        rested = None if rested is None else _rested(rested, False)
        if rested is not None and _within(rested):
            found = _picture(seed, rng, rested, THREE_SENSORS[seed % 3], (0.75, 1.05))
            if found is not None:
                return found
    raise RuntimeError(f"no pile was drawn from seed {seed}")


def _within(objects: list[SceneObject]) -> bool:
    """Whether all middles are within the square, though the walls are gone."""
    centers = np.array([o.X_WO.apply(ycb_mesh(_named(o)).vertices.mean(axis=0)) for o in objects])
    return bool((np.ptp(centers[:, :2], axis=0) <= SQUARE).all())
