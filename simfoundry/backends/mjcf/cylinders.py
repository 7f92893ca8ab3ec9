"""Conversion of cylinders to prisms, for MJCF readers without cylinder collisions."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from simfoundry.backends.losses import Loss, approximate
from simfoundry.geometry.frames import frozen_array
from simfoundry.geometry.shapes import Cylinder, Mesh
from simfoundry.scene.model import Collider, Link, Scene


def with_prisms(scene: Scene, sides: int) -> Scene:
    """Return a copy of the scene in which each colliding cylinder is replaced by a prism."""

    def collider_with(c: Collider) -> Collider:
        return replace(c, geometry=prism(c.geometry, sides)) if isinstance(c.geometry, Cylinder) else c

    def link_with(link: Link) -> Link:
        return replace(link, colliders=tuple(map(collider_with, link.colliders)))

    return replace(scene, objects=tuple(replace(o, links=tuple(map(link_with, o.links))) for o in scene.objects))


def prism(cylinder: Cylinder, sides: int) -> Mesh:
    """Return a regular prism with the same height and volume as the cylinder."""
    turn = 2 * math.pi / sides
    radius, half = cylinder.radius * math.sqrt(turn / math.sin(turn)), cylinder.height / 2
    low, fan = np.arange(sides), np.arange(1, sides - 1)
    ring = radius * np.column_stack([np.cos(turn * low), np.sin(turn * low)])
    vertices = np.vstack([np.column_stack([ring, np.full(sides, z)]) for z in (-half, half)])
    after, zero = np.roll(low, -1), np.zeros_like(fan)
    walls = [np.column_stack([low, after, after + sides]), np.column_stack([low, after + sides, low + sides])]
    caps = [np.column_stack([zero, fan + 1, fan]), np.column_stack([zero, fan, fan + 1]) + sides]
    faces = np.vstack([*walls, *caps]).astype(np.int32)
    faces.setflags(write=False)
    return Mesh(frozen_array(vertices), faces)


def prism_losses(scene: Scene, sides: int) -> Iterator[Loss]:
    """Yield one loss for each object with colliding cylinders."""
    turn = 2 * math.pi / sides
    share = max(math.sqrt(turn / math.sin(turn)) - 1, 1 - math.cos(turn / 2) * math.sqrt(turn / math.sin(turn)))
    for item in scene.objects:
        radii = [c.geometry.radius for k in item.links for c in k.colliders if isinstance(c.geometry, Cylinder)]
        if radii:
            off = share * max(radii) * 1000
            reason = (
                f"Cylinders collide as {sides}-sided prisms of equal volume, up to {off:.2g} mm away from the surface."
            )
            yield approximate("cylinder", item.name, reason, off, "mm")
