"""Light links between the axes of joints with several axes, for formats in which a joint has only one axis."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from simfoundry.backends.artifact import number
from simfoundry.backends.losses import Loss, approximate
from simfoundry.geometry.frames import frozen_array
from simfoundry.scene.model import Joint, Link, Scene, SceneObject

# Mass and inertia of a light link, relative to those of the link that it carries. This changes the motion by less than
# 0.1%, and the ratio is far above the rounding of single precision, in which PhysX computes.
SHARE = 1e-4


def with_light_links(scene: Scene) -> Scene:
    """Return a scene in which each joint has one axis, with a light link between each two axes of the same link."""
    objects = tuple(_split(item) for item in scene.objects)
    return scene if objects == scene.objects else replace(scene, objects=objects)


@lru_cache(maxsize=256)  # the same object is written to several targets, which share caches by object
def _split(item: SceneObject) -> SceneObject:
    variants = tuple(_split(variant) for variant in item.variants)
    if all(len(above) == 1 for above in item.joints_above.values()):
        return item if variants == item.variants else replace(item, variants=variants)
    links: list[Link] = []
    joints: list[Joint] = []
    apart: list[tuple[str, str]] = []
    taken = {link.name for link in item.links}
    for link in item.links:
        above = item.joints_above.get(link.name, ())
        parent = above[0].parent if above else ""
        for k, joint in enumerate(above):
            child = link.name
            if k < len(above) - 1:
                child = _free_name(f"{link.name}_{joint.name}", taken)
                links.append(_light(child, link))
            joints.append(replace(joint, parent=parent, child=child))
            parent = child
        links.append(link)
        if len(above) > 1:
            apart.append((above[0].parent, link.name))  # connected links do not collide
    pairs = (*item.no_contact, *apart)
    return replace(item, links=tuple(links), joints=tuple(joints), no_contact=pairs, variants=variants)


def _free_name(wish: str, taken: set[str]) -> str:
    name = next(n for n in (wish, *(f"{wish}_{k}" for k in range(2, 10_000))) if n not in taken)
    taken.add(name)
    return name


def _light(name: str, carried: Link) -> Link:
    """Return a light link without shapes, whose moments are a share of the mean moment of the link that it carries."""
    moment = SHARE * float(np.trace(carried.inertia)) / 3
    return Link(name, SHARE * carried.mass, frozen_array(np.zeros(3)), frozen_array(moment * np.eye(3)), (), ())


def light_link_losses(scene: Scene, format_name: str) -> Iterator[Loss]:
    """Yield one loss for each light link, with its mass."""
    for item in scene.objects:
        for above in item.joints_above.values():
            for joint, below in pairwise(above):
                mass = SHARE * next(link.mass for link in item.links if link.name == joint.child)
                reason = f"A joint in {format_name} has one axis, so a light link of {number(float(f'{mass:.3g}'))} kg "
                reason += f"connects it to `{below.name}`."
                yield approximate("several_axes", f"{item.name}.{joint.name}", reason, mass, "kg")
