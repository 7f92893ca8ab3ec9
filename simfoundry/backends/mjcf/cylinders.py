"""Conversion of cylinders to prisms, for MJCF readers without cylinder collisions."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from simfoundry.backends.features import Loss, approximate
from simfoundry.geometry.frames import frozen_array
from simfoundry.geometry.shapes import Cylinder, Mesh
from simfoundry.scene.model import Collider, Link, Scene


def with_prisms(scene: Scene, sides: int) -> Scene:
    """Return a copy of the scene in which each colliding cylinder is replaced by a prism."""

    def link_with(link: Link) -> Link:
        return replace(link, colliders=tuple(_collider_with(c, sides) for c in link.colliders))

    objects = (replace(o, links=tuple(map(link_with, o.links))) for o in scene.objects)
    return replace(scene, objects=tuple(objects))


def _collider_with(collider: Collider, sides: int) -> Collider:
    if not isinstance(collider.geometry, Cylinder):
        return collider
    return replace(collider, geometry=prism(collider.geometry, sides))


def prism(cylinder: Cylinder, sides: int) -> Mesh:
    """Return a regular prism with the same height and volume as the cylinder."""
    turn = 2 * math.pi / sides
    radius = cylinder.radius * math.sqrt(turn / math.sin(turn))
    angles = turn * np.arange(sides)
    ring = np.column_stack([radius * np.cos(angles), radius * np.sin(angles)])
    half = cylinder.height / 2
    vertices = np.vstack([np.column_stack([ring, np.full(sides, z)]) for z in (-half, half)])
    nxt = np.roll(np.arange(sides), -1)
    low = np.arange(sides)
    walls = [np.column_stack([low, nxt, nxt + sides]), np.column_stack([low, nxt + sides, low + sides])]
    fan = np.arange(1, sides - 1)
    zero = np.zeros_like(fan)
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
            reason = f"It collides as a {sides}-sided prism of equal volume, up to {off:.2g} mm away from its surface."
            yield approximate("cylinder", item.name, reason, off, "mm")
