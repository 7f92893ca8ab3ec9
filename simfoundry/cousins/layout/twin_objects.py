"""Objects and robots of a twin at their rest poses, and cached measures of their shapes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np

from simfoundry.cousins.layout.supports import Outline, Support, edges_of, support_of, supports_of
from simfoundry.cousins.layout.views import VisibleSurface
from simfoundry.geometry.frames import IDENTITY, Pose, frozen_array
from simfoundry.geometry.hulls import Hulls
from simfoundry.geometry.shapes import Cylinder
from simfoundry.predicates.judging.bodies import Bodies
from simfoundry.scene.model import Collider, Joint, Link, Scene, SceneObject
from simfoundry.scene.object_shapes import hulls
from simfoundry.scene.touching import weld_groups

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

    from simfoundry.robots.reach import ArmReach


BASE_RADIUS, BASE_HEIGHT = 0.155, 1.0
"""Radius and height [m] of a column that reserves the base of a robot without a model: the foot of a Panda extends
0.155 m from its axis, those of smaller arms less; no placed object hangs higher over a table.
"""


class TwinRobots:
    """Robots of a twin in their start configuration, both as obstacles and as arms that reach."""

    def __init__(self, scene: Scene, names: tuple[str, ...]) -> None:
        self._scene, self.names = scene, names

    @cached_property
    def reach(self) -> ArmReach:
        """Reachability of the acting arms."""
        from simfoundry.robots.reach import ArmReach

        return ArmReach(self._scene, self.names)

    @cached_property
    def items(self) -> tuple[SceneObject, ...]:
        """Robots that have a model, as objects."""
        bodies = Bodies(self._scene)
        return tuple(bodies[name].item for name in bodies.robots)

    @cached_property
    def obstacles(self) -> tuple[SceneObject, ...]:
        """The robots, each without a model replaced by a column at its base."""
        absent = [(left.path.partition(".")[2], left.X_WB) for left in self._scene.left_out if left.X_WB is not None]
        there = {item.name for item in self.items}
        return (*self.items, *(_column(name, X_WB) for name, X_WB in absent if name not in there))

    @cached_property
    def shadows(self) -> Mapping[str, tuple[Outline, ...]]:
        """Shadow of each link of each obstacle, in the world."""
        return {item.name: link_shadows(hulls(item)) for item in self.obstacles}

    @cached_property
    def surfaces(self) -> Mapping[str, VisibleSurface]:
        """Surface of each robot, from its collision geometry because visuals have hundreds of thousands of
        triangles.
        """
        bare = {i.name: replace(i, links=tuple(replace(link, visuals=()) for link in i.links)) for i in self.items}
        return {item.name: VisibleSurface.of(bare[item.name]).at(item.X_WO) for item in self.items}


@dataclass(frozen=True, eq=False)
class TwinObject:
    """An object of a twin at its rest pose, and cached measures of it.

    ``item`` has its joints at their rest positions and its frame at the origin.
    """

    item: SceneObject
    X_WO: Pose
    outlines: dict[tuple[float, ...], Outline] = field(default_factory=dict, repr=False)
    supports: dict[float | None, Support | None] = field(default_factory=dict, repr=False)

    @cached_property
    def standing(self) -> SceneObject:
        """Return the object at its pose."""
        return replace(self.item, X_WO=self.X_WO)

    @cached_property
    def shape(self) -> Hulls:
        """Convex parts of the object, with its frame at the origin."""
        return _shape(self.item.links, self.item.joints)

    @cached_property
    def placed(self) -> Hulls:
        """Convex parts of the object at its pose."""
        return hulls(self.standing)

    @cached_property
    def shadows(self) -> tuple[Outline, ...]:
        """Shadow of each link of the object."""
        return link_shadows(self.placed)

    @cached_property
    def surface(self) -> VisibleSurface:
        """Visible surface of the object, with its frame at the origin."""
        return _surface(self.item.links, self.item.joints)

    @cached_property
    def levels(self) -> tuple[Support, ...]:
        """Levels on which objects can stand, except those on links that joints move."""
        return supports_of(self.item.name, self.placed, self._still_links())

    @cached_property
    def edges(self) -> list[tuple[float, BaseGeometry]]:
        """Heights [m] and areas that are level but too narrow to stand on."""
        return edges_of(self.placed, self._still_links())

    def outline(self, upright: Pose) -> Outline:
        """Shadow of the object, ``upright`` at the origin."""
        key = tuple(upright.q.tolist())
        if key not in self.outlines:
            self.outlines[key] = Outline.of(hulls(replace(self.item, X_WO=upright)))
        return self.outlines[key]

    def support(self, near: float | None) -> Support | None:
        """Level at the height ``near`` [m], by default the largest; None if the object has no level."""
        if near not in self.supports:
            self.supports[near] = support_of(self.item.name, self.placed, near)
        return self.supports[near]

    def _still_links(self) -> list[int]:
        """Indices of the links that no joint moves."""
        welded = weld_groups(self.item)
        return [k for k, link in enumerate(self.item.links) if welded[link.name] == welded[self.item.root.name]]


@lru_cache(maxsize=512)
def _shape(links: tuple[Link, ...], joints: tuple[Joint, ...]) -> Hulls:
    """Convex parts of an object at the origin, cached because library objects are used in many twins under
    other names.
    """
    return hulls(SceneObject("", "", False, IDENTITY, links, joints))


@lru_cache(maxsize=512)
def _surface(links: tuple[Link, ...], joints: tuple[Joint, ...]) -> VisibleSurface:
    return VisibleSurface.of(SceneObject("", "", False, IDENTITY, links, joints))


def link_shadows(shape: Hulls) -> tuple[Outline, ...]:
    """The shadow of each link of a shape."""
    links = [shape.of_link(k) for k in dict.fromkeys(shape.link.tolist())]
    return tuple(Outline.of(link) for link in links if len(link.corners))


def _column(name: str, X_WB: Pose) -> SceneObject:
    """Return a column that reserves the base of a robot whose model is missing."""
    none = frozen_array(np.zeros(3), (3,))
    middle = Pose.of((0.0, 0.0, BASE_HEIGHT / 2))
    collider = Collider("base", Cylinder(BASE_RADIUS, BASE_HEIGHT), friction=0.0, restitution=0.0, X_LG=middle)
    link = Link("base", 0.0, none, frozen_array(np.zeros((3, 3)), (3, 3)), (), (collider,))
    return SceneObject(name, category="", fixed=True, X_WO=X_WB, links=(link,))


def joined(shapes: Sequence[Hulls]) -> Hulls:
    """Merge several shapes into one, for its extents and shadow; edges and faces are dropped if there are several."""
    if len(shapes) == 1:
        return shapes[0]
    none = shapes[0].triangles[:0]
    counts = np.cumsum([0, *(len(s.radius) for s in shapes[:-1])])
    return Hulls(
        np.concatenate([s.corners for s in shapes]),
        shapes[0].edges[:0],
        none,
        shapes[0].normals[:0],
        shapes[0].beside[:0],
        np.concatenate([s.part + k for s, k in zip(shapes, counts, strict=True)]),
        np.concatenate([s.radius for s in shapes]),
        np.concatenate([s.link for s in shapes]),
    )
