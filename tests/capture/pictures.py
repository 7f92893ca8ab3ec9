"""Depth pictures with known content: rays against boxes, upright cylinders and a round or rectangular table."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from simfoundry.capture.frame import Frame
from simfoundry.geometry.frames import Array, Pose, look_at

WIDTH, HEIGHT, FOCAL = 320, 240, 290.0


@dataclass(frozen=True)
class Box:
    center: tuple[float, float, float]
    size: tuple[float, float, float]
    yaw: float = 0.0


@dataclass(frozen=True)
class Cylinder:
    center: tuple[float, float, float]
    radius: float
    height: float


@dataclass(frozen=True)
class Table:
    """A top at z = 0 (rectangle of full ``size``, or a disk of ``radius``), above a floor at ``floor``."""

    size: tuple[float, float] = (1.2, 0.9)
    radius: float | None = None
    floor: float = -0.7


@dataclass(frozen=True)
class Setup:
    items: tuple[Box | Cylinder, ...] = ()
    table: Table = field(default_factory=Table)
    eye: tuple[float, float, float] = (-0.62, 0.21, 0.55)
    target: tuple[float, float, float] = (0.02, -0.01, 0.03)
    roll: float = 0.07  # [rad] of the camera about its own axis
    noise: float = 0.3  # of the sensor's usual noise

    @property
    def X_TC(self) -> Pose:
        """The camera in the table's frame."""
        turn = Pose.of(q=(np.cos(self.roll / 2), 0.0, 0.0, np.sin(self.roll / 2)))
        return look_at(np.array(self.eye), np.array(self.target)) @ turn


def photograph(setup: Setup) -> tuple[Frame, np.ndarray]:
    """The frame, and int32 labels, shape (h, w): k for ``setup.items[k - 1]``, 0 for the rest."""
    K = np.array([[FOCAL, 0, 158.0], [0, FOCAL + 1, 121.0], [0, 0, 1]])
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays_C = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], axis=-1)
    X_TC = setup.X_TC
    rays, eye = rays_C @ X_TC.rotation.T, X_TC.p
    surfaces = [_table(setup.table, eye, rays)]
    surfaces += [_box(i, eye, rays) if isinstance(i, Box) else _cylinder(i, eye, rays) for i in setup.items]
    depth = np.min(surfaces, axis=0)
    labels = np.argmin(surfaces, axis=0).astype(np.int32)
    depth[~np.isfinite(depth)] = np.nan
    sigma = setup.noise * (0.0005 + 0.0012 * depth**2)
    depth = depth + np.random.default_rng(7).normal(size=depth.shape) * sigma
    return Frame(np.full((*depth.shape, 3), 128, np.uint8), depth, K), labels


def _table(table: Table, eye: Array, rays: Array) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        t = -eye[2] / rays[..., 2]
        hit = eye + t[..., None] * rays
        on = (
            np.linalg.norm(hit[..., :2], axis=-1) < table.radius
            if table.radius is not None
            else (np.abs(hit[..., :2]) < np.array(table.size) / 2).all(axis=-1)
        )
        ground = (table.floor - eye[2]) / rays[..., 2]
    out = np.where((t > 0) & on, t, np.where(ground > 0, ground, np.inf))
    return np.asarray(out)


def _box(box: Box, eye: Array, rays: Array) -> Array:
    c, s = np.cos(box.yaw), np.sin(box.yaw)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    origin, direction = (eye - np.array(box.center)) @ R, rays @ R
    half = np.array(box.size) / 2
    with np.errstate(divide="ignore"):
        near, far = (-half - origin) / direction, (half - origin) / direction
    enter, leave = np.minimum(near, far).max(axis=-1), np.maximum(near, far).min(axis=-1)
    return np.asarray(np.where((enter < leave) & (leave > 0), enter, np.inf))


def _cylinder(item: Cylinder, eye: Array, rays: Array) -> Array:
    center = np.array(item.center)
    o, d = eye - center, rays
    a, b = (d[..., :2] ** 2).sum(-1), (d[..., :2] * o[:2]).sum(-1)
    root = b * b - a * (o[:2] @ o[:2] - item.radius**2)
    with np.errstate(invalid="ignore", divide="ignore"):
        side = (-b - np.sqrt(root)) / a
        side = np.where((root > 0) & (np.abs(o[2] + side * d[..., 2]) <= item.height / 2), side, np.inf)
        top = (item.height / 2 - o[2]) / d[..., 2]
        on_top = ((o[:2] + top[..., None] * d[..., :2]) ** 2).sum(-1) < item.radius**2
    return np.asarray(np.minimum(side, np.where(on_top & (top > 0), top, np.inf)))
