"""Objects that move together with another one: what stands on it, is inside of it, or leans on it."""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np

from simfoundry.geometry.frames import Array
from simfoundry.geometry.hulls import Hulls
from simfoundry.predicates.judging.thresholds import TOUCH
from simfoundry.scene.drop import TOUCHING, DropResult, drop_onto
from simfoundry.studio.reading import StudioScene, verdict
from simfoundry.worlds.rest import center_of_mass

# Depth [m] of an overlap at which an object still stands on another one, rather than being stuck in it.
DEEPEST = 4 * TOUCHING

# Distance [m] at which a center of mass is above a point on which an object stands; documents round to 0.1 mm.
ABOVE_M = 0.001


def rest_below(scene: StudioScene, held: Hulls, without: Collection[str]) -> DropResult | None:
    """Return where a posed shape comes to rest among the objects of a scene, except some of them."""
    low, high = held.bounds()
    near = (
        name
        for name, (least, most) in scene.draft.bounds.items()
        if name not in without and (most[:2] >= low[:2]).all() and (least[:2] <= high[:2]).all()
    )
    return drop_onto(held, {name: scene.draft.shapes[name] for name in near})


def carried_objects(scene: StudioScene, name: str) -> dict[str, DropResult | None]:
    """Return the objects that a moved object carries, each with what it rests on, or None if that is nothing.

    These are all objects that stand on it, are inside of it, or lean on it and would tip over without it, directly or
    by way of others of them. Fixed objects stay where they are.
    """
    bounds, carried = scene.draft.bounds, dict[str, DropResult | None]()
    todo = [name]
    while todo:
        below = todo.pop()
        if below not in bounds:
            continue
        for other, box in bounds.items():
            if other == name or other in carried or scene.objects[other].fixed or not _are_near(bounds[below], box):
                continue
            found = rest_below(scene, scene.draft.shapes[other], (other,))
            if _stands_on(found, below) or _is_inside(scene, other, below) or _leans_on(scene, other, below):
                carried[other] = found
                todo.append(other)
    return carried


def _are_near(a: tuple[Array, Array], b: tuple[Array, Array]) -> bool:
    """Return True if two bounding boxes overlap or nearly touch."""
    return bool((a[0] <= b[1] + DEEPEST).all() and (b[0] <= a[1] + DEEPEST).all())


def _stands_on(found: DropResult | None, below: str) -> bool:
    return found is not None and found.support == below and abs(found.lift) <= DEEPEST


def _is_inside(scene: StudioScene, name: str, container: str) -> bool:
    low, high = scene.draft.bounds[name]
    least, most = scene.draft.bounds[container]
    middle = (low + high) / 2
    if (middle < least).any() or (middle > most).any():  # half of it would be outside
        return False
    found = verdict(scene, f"Inside({name}, {container})")
    return found is not None and found.value


def _leans_on(scene: StudioScene, name: str, other: str) -> bool:
    """Return True if an object touches another one, and would tip over if it stood only on its lowest points."""
    shape = scene.draft.shapes[name]
    heights = shape.corners[:, 2] - shape.radius[shape.part]
    feet = shape.corners[heights <= heights.min() + TOUCH, :2]
    item, has_mass = scene.objects[name], any(link.mass > 0 for link in scene.objects[name].links)
    center = center_of_mass(item, item.X_WO) if has_mass else np.mean(shape.bounds(), axis=0)
    if _is_above(center[:2], feet):
        return False
    found = verdict(scene, f"Touching({name}, {other})")
    return found is not None and found.value


def _is_above(point: Array, feet: Array) -> bool:
    """Return True if a point (2,) is in the convex hull of others (n, 2), or almost at one of them."""
    offsets = feet - point
    if (np.hypot(*offsets.T) <= ABOVE_M).any():
        return True
    angles = np.sort(np.arctan2(offsets[:, 1], offsets[:, 0]))
    gaps = np.diff(angles, append=angles[0] + 2 * math.pi)
    return bool(gaps.max() <= math.pi + 1e-6)  # no line separates it from all of them; 1e-6 allows for rounding
