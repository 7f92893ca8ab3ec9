"""The objects and robots in a twin at their rest poses, with cached shape measures and collision tests."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simfoundry.backends.mjcf import compile_mjcf
from simfoundry.cousins.layout.supports import Outline, Support, edges_of, support_of, supports_of
from simfoundry.cousins.layout.views import VisibleSurface
from simfoundry.geometry.frames import IDENTITY, Array, Pose, frozen_array, rotations
from simfoundry.geometry.hulls import Hulls
from simfoundry.geometry.shapes import Cylinder
from simfoundry.predicates.judging.bodies import Bodies
from simfoundry.scene.kinematics import link_poses, weld_groups
from simfoundry.scene.model import Collider, Joint, Link, Scene, SceneObject
from simfoundry.scene.object_shapes import hulls

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

    from simfoundry.robots.reach import ArmReach

# Radius and height [m] of the column that reserves space for the base of a robot without a model. A Panda's base
# extends 0.155 m from its axis, smaller arms have smaller bases, and placed objects are lower than the column.
BASE_RADIUS, BASE_HEIGHT = 0.155, 1.0


class TwinRobots:
    """The robots in a twin in their initial configurations. They serve as obstacles and for reachability tests."""

    def __init__(self, scene: Scene, names: tuple[str, ...]) -> None:
        self._scene, self.names = scene, names

    @cached_property
    def reach(self) -> ArmReach:
        """The reachability test for the acting arms."""
        from simfoundry.robots.reach import ArmReach

        return ArmReach(self._scene, self.names)

    @cached_property
    def items(self) -> tuple[SceneObject, ...]:
        """The robots that have a model, represented as objects."""
        bodies = Bodies(self._scene)
        return tuple(bodies[name].item for name in bodies.robots)

    @cached_property
    def obstacles(self) -> tuple[SceneObject, ...]:
        """All robots as obstacles. A robot without a model is represented by a column at its base."""
        absent = [(left.path.partition(".")[2], left.X_WB) for left in self._scene.left_out if left.X_WB is not None]
        there = {item.name for item in self.items}
        return (*self.items, *(_column(name, X_WB) for name, X_WB in absent if name not in there))

    @cached_property
    def shadows(self) -> Mapping[str, tuple[Outline, ...]]:
        """The shadows of each obstacle's links in the world frame, keyed by obstacle name."""
        return {item.name: link_shadows(hulls(item)) for item in self.obstacles}

    @cached_property
    def surfaces(self) -> Mapping[str, VisibleSurface]:
        """The surface of each robot's collision geometry, which has fewer triangles than the visual meshes."""
        bare = {i.name: replace(i, links=tuple(replace(link, visuals=()) for link in i.links)) for i in self.items}
        return {item.name: VisibleSurface.of(bare[item.name]).at(item.X_WO) for item in self.items}


@dataclass(frozen=True, eq=False)
class TwinObject:
    """An object in a twin with its rest pose ``X_WO`` and cached shape measures.

    ``item`` is the object with its frame at the origin and its joints at their rest positions.
    """

    item: SceneObject
    X_WO: Pose
    outlines: dict[tuple[float, ...], Outline] = field(default_factory=dict, repr=False)
    supports: dict[float | None, Support | None] = field(default_factory=dict, repr=False)

    @cached_property
    def standing(self) -> SceneObject:
        """The object placed at its rest pose."""
        return replace(self.item, X_WO=self.X_WO)

    @cached_property
    def shape(self) -> Hulls:
        """The convex parts of the object with its frame at the origin."""
        return _shape(self.item.links, self.item.joints)

    @cached_property
    def placed(self) -> Hulls:
        """The convex parts of the object at its rest pose."""
        return hulls(self.standing)

    @cached_property
    def shadows(self) -> tuple[Outline, ...]:
        """The shadows of the object's links at its rest pose."""
        return link_shadows(self.placed)

    @cached_property
    def surface(self) -> VisibleSurface:
        """The visible surface of the object with its frame at the origin."""
        return _surface(self.item.links, self.item.joints)

    @cached_property
    def levels(self) -> tuple[Support, ...]:
        """The level surfaces on which objects can stand, excluding those on movable links."""
        return supports_of(self.item.name, self.placed, self.still_links)

    @cached_property
    def edges(self) -> list[tuple[float, BaseGeometry]]:
        """The heights [m] and regions of level surfaces that are too narrow to stand on."""
        return edges_of(self.placed, self.still_links)

    def outline(self, upright: Pose) -> Outline:
        """Return the shadow of the object with its frame at the pose ``upright``."""
        key = tuple(upright.q.tolist())
        if key not in self.outlines:
            self.outlines[key] = Outline.of(hulls(replace(self.item, X_WO=upright)))
        return self.outlines[key]

    def support(self, near: float | None) -> Support | None:
        """Return the level surface that is closest to the height ``near`` [m].

        If ``near`` is None, the largest level surface is returned. The result is None if the object has no level
        surfaces.
        """
        if near not in self.supports:
            self.supports[near] = support_of(self.item.name, self.placed, near)
        return self.supports[near]

    @cached_property
    def still_links(self) -> list[int]:
        """The indices of the links that joints cannot move relative to the root."""
        welded = weld_groups(self.item)
        return [k for k, link in enumerate(self.item.links) if welded[link.name] == welded[self.item.root.name]]


@lru_cache(maxsize=512)
def _shape(links: tuple[Link, ...], joints: tuple[Joint, ...]) -> Hulls:
    """Return the convex parts of an object at the origin.

    The result is cached because library objects occur in many twins under different names.
    """
    return hulls(SceneObject("", "", False, IDENTITY, links, joints))


@lru_cache(maxsize=512)
def _surface(links: tuple[Link, ...], joints: tuple[Joint, ...]) -> VisibleSurface:
    return VisibleSurface.of(SceneObject("", "", False, IDENTITY, links, joints))


def link_shadows(shape: Hulls) -> tuple[Outline, ...]:
    """Return the shadows of the links in a shape."""
    links = (shape.of_link(k) for k in dict.fromkeys(shape.link.tolist()))
    return tuple(Outline.of(link) for link in links if len(link.corners))


def _column(name: str, X_WB: Pose) -> SceneObject:
    """Return a column that reserves space for the base of a robot whose model is missing."""
    none = frozen_array(np.zeros(3), (3,))
    middle = Pose.of((0.0, 0.0, BASE_HEIGHT / 2))
    collider = Collider("base", Cylinder(BASE_RADIUS, BASE_HEIGHT), friction=0.0, restitution=0.0, X_LG=middle)
    link = Link("base", 0.0, none, frozen_array(np.zeros((3, 3)), (3, 3)), (), (collider,))
    return SceneObject(name, category="", fixed=True, X_WO=X_WB, links=(link,))


Index = NDArray[np.int64]


class Solids:
    """The collision geometry of objects as MuJoCo geoms, used for distance queries. Nothing is simulated."""

    def __init__(self, items: tuple[SceneObject, ...], joints: Mapping[str, Mapping[str, float | Pose]]) -> None:
        import mujoco

        bare = tuple(replace(o, links=tuple(map(_bare, o.links)), variants=(), no_contact=()) for o in items)
        files = compile_mjcf(Scene("solids", frozen_array([0.0, 0.0, 0.0]), bare), contacts="native").files
        assets = {path: data for path, data in files.items() if path.startswith("assets/")}
        self._distance = mujoco.mj_geomDistance
        self._model = mujoco.MjModel.from_xml_string(files["scene.xml"].decode(), assets)
        self._data = mujoco.MjData(self._model)
        self._own: dict[str, tuple[Index, Array, Array]] = {}
        self._balls: dict[str, tuple[Array, Array]] = {}
        self._at: dict[str, tuple[Array, Array]] = {}
        self._waiting: dict[str, Pose] = {}
        for item in items:
            self._own[item.name] = self._in_frame(item, joints.get(item.name, {}))
            self.put(item.name, item.X_WO)

    def _in_frame(self, item: SceneObject, joints: Mapping[str, float | Pose]) -> tuple[Index, Array, Array]:
        """Return the geoms of an object in the object's frame.

        Returns:
            Indices of shape (k,), positions [m] of shape (k, 3), and rotations of shape (k, 3, 3).
        """
        ids, p, turned = [np.zeros(0, np.int64)], [np.zeros((0, 3))], [np.zeros((0, 3, 3))]
        poses = link_poses(item, joints)
        for link in item.links:
            name, X_OL = item.qualified(link.name), poses[link.name]
            geoms = np.array([self._model.geom(f"{name}.{c.name}").id for c in link.colliders], dtype=np.int64)
            ids.append(geoms)
            p.append(X_OL.apply(self._model.geom_pos[geoms]))
            turned.append(X_OL.rotation @ rotations(self._model.geom_quat[geoms].reshape(-1, 4)))
        every = np.concatenate(ids)
        box = self._model.geom_aabb[every]
        self._balls[item.name] = box[:, :3].copy(), np.linalg.norm(box[:, 3:], axis=1)
        return every, np.concatenate(p), np.concatenate(turned)

    def put(self, name: str, X_WO: Pose) -> None:
        """Set the pose of an object. The poses of its parts are updated at the next query."""
        self._waiting[name] = X_WO

    def _posed(self, name: str) -> tuple[Array, Array]:
        """Return the bounding spheres of an object's parts.

        Returns:
            Centers in the world [m], as an array of shape (k, 3), and radii [m], as an array of shape (k,).
        """
        X_WO = self._waiting.pop(name, None)
        if X_WO is None:
            return self._at[name]
        geoms, p, turned = self._own[name]
        points, turns = X_WO.apply(p), X_WO.rotation @ turned
        self._data.geom_xpos[geoms] = points
        self._data.geom_xmat[geoms] = turns.reshape(-1, 9)
        middle, radius = self._balls[name]
        self._at[name] = points + np.einsum("kij,kj->ki", turns, middle), radius
        return self._at[name]

    def meet(self, a: str, b: str, gap: float) -> bool:
        """Return True if two objects overlap or are less than ``gap`` [m] apart."""
        near = ((i, j) for i, j, _ in self._near(a, b, gap))
        return any(self._distance(self._model, self._data, i, j, gap + 1e-3, None) < gap for i, j in near)

    def distance(self, a: str, b: str, far: float) -> float:
        """Return the signed distance between two objects [m], limited to ``far``.

        The distance is negative if the objects overlap.
        """
        best = far
        for i, j, bound in self._near(a, b, far):
            if bound >= best:
                break
            best = min(best, self._distance(self._model, self._data, i, j, max(best, 1e-3), None))
        return float(best)

    def _near(self, a: str, b: str, far: float) -> Iterator[tuple[int, int, float]]:
        """Yield pairs of parts that may be closer than ``far`` [m].

        Each item contains the indices of two geoms and a lower bound on their distance [m]. Items are sorted by
        increasing lower bound.
        """
        if not len(self._own[a][0]) or not len(self._own[b][0]):
            return
        (middle_a, size_a), (middle_b, size_b) = self._posed(a), self._posed(b)
        off = middle_b[None] - middle_a[:, None]
        bound = np.sqrt((off * off).sum(axis=2)) - size_a[:, None] - size_b
        i, j = np.nonzero(bound < far)
        bounds = bound[i, j]
        order = np.argsort(bounds, kind="stable")
        geoms_a, geoms_b = self._own[a][0][i[order]], self._own[b][0][j[order]]
        yield from zip(geoms_a.tolist(), geoms_b.tolist(), bounds[order].tolist(), strict=True)


def _bare(link: Link) -> Link:
    """Return a link without visuals and with uniform surfaces, so that no explicit contact pairs are needed."""
    colliders = tuple(
        replace(c, friction=1.0, restitution=0.0, torsional_friction=0.0, rolling_friction=0.0) for c in link.colliders
    )
    return replace(link, visuals=(), colliders=colliders)
