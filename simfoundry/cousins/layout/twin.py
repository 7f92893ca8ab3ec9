"""The twin that cousins come from, prepared once: its scene at rest, what judges it, and its shapes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.cousins.layout.colliders import Solids
from simfoundry.cousins.layout.supports import Outline, Support, edges_of, support_of, supports_of
from simfoundry.cousins.layout.views import SEEN, VisibleSurface, best_view
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.place import rounded
from simfoundry.evaluate.task import load_task
from simfoundry.geometry.frames import IDENTITY, Array, Pose, frozen_array, quat_from_rpy
from simfoundry.geometry.hulls import Hulls
from simfoundry.geometry.shapes import Cylinder
from simfoundry.predicates.judging.bodies import Bodies
from simfoundry.scene.lower import lower
from simfoundry.scene.model import Collider, Joint, Link, Scene, SceneObject
from simfoundry.scene.object_shapes import hulls
from simfoundry.scene.state import SceneState
from simfoundry.scene.touching import weld_groups
from simfoundry.spec.load import load, load_kind
from simfoundry.spec.models.expressions import Condition, parse_call, texts
from simfoundry.spec.models.task import TaskSpec
from simfoundry.worlds.footing import supporters
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.settle import settle

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

    from simfoundry.assets.cache import Cache
    from simfoundry.cousins.reach import Reach
    from simfoundry.predicates import Judge


ELSEWHERE = 100.0
"""Distance [m] from the scene and from each other at which absent objects fall, so that nothing meets them."""

UNDERFOOT = 0.3
"""What lies so much lower than a table top [m], and under it, is the floor: the lowest tables are about so high."""


BASE_RADIUS, BASE_HEIGHT = 0.155, 1.0
"""The column that keeps the base of a robot free whose model is not there [m]: the foot of a Panda reaches 0.155 m from
its axis, those of smaller arms less; nothing that is placed hangs higher over a table."""


class TwinError(SimfoundryError):
    """A scene that no cousins can be made of; the message says why."""


@dataclass(frozen=True, eq=False)
class Twin:
    """A scene, or a task in its scene, whose ``state`` is at rest.

    ``goal`` is the task's, None without one; ``robots`` act in it. ``carried`` names what each free object rests on.
    ``absent`` are objects of the scene that are not there yet: a layout has to place them. ``kept`` is
    what was found once.
    """

    scene: Scene
    state: SceneState
    goal: Condition | None
    robots: tuple[str, ...]
    carried: Mapping[str, tuple[str, ...]]
    absent: frozenset[str] = frozenset()
    kept: dict[Any, Any] = field(default_factory=dict, repr=False)

    @classmethod
    def load(cls, path: Path, cache: Cache | None = None) -> Twin:
        """The twin of a scene or task; raises :class:`SpecError`, or :class:`TwinError` where it cannot rest."""
        if isinstance(load(path).spec, TaskSpec):
            task = load_task(path, cache)
            return cls.of(task.scene, task.goal, task.robots)
        return cls.of(lower(load_kind(path, "scene/1", "task/1"), cache))

    @classmethod
    def of(cls, scene: Scene, goal: Condition | None = None, robots: Sequence[str] | None = None) -> Twin:
        """The twin of a lowered scene, settled; raises :class:`TwinError` where it does not come to rest."""
        with MujocoWorld(bare(scene)) as world:
            result = settle(world)
            if not result.at_rest:
                why = "; ".join(f"`{o.name}` {o.problems[0]}" for o in result.objects if o.name in result.lost)
                raise TwinError(f"the twin `{scene.name}` does not come to rest: {why}; see `simfoundry settle`")
            state = rounded(result.state)
            world.reset(state)
            contacts = world.contacts()
        carried = {o.name: supporters(o.name, contacts) for o in scene.objects if not o.fixed}
        lost = [left.path.removeprefix("robots.") for left in scene.left_out if left.path.startswith("robots.")]
        acting = (*(r.name for r in scene.robots), *lost) if robots is None else tuple(robots)
        return cls(scene, state, goal, acting, MappingProxyType(carried))

    def extended(self, objects: Sequence[SceneObject]) -> Twin:
        """The same with more objects, which are not there until a layout places them; one of a known name replaces it.

        What replaces an object stands where that stood, and must be settled by
        :func:`simfoundry.cousins.layout.acceptance.examine`.
        """
        new = {item.name: item for item in objects}
        known = {item.name for item in self.scene.objects}
        here = tuple(new.get(item.name, item) for item in self.scene.objects)
        absent = [item for item in objects if item.name not in known]
        more = tuple(replace(item, X_WO=_away(item, k)) for k, item in enumerate(absent, 1 + len(self.absent)))
        poses = dict(self.state.poses) | {item.name: item.X_WO for item in more}
        joints = {k: v for k, v in self.state.joints.items() if k.partition(".")[0] not in new}
        motions = {k: v for k, v in self.state.motions.items() if k.partition(".")[0] not in new}
        initial = SceneState.initial(replace(self.scene, objects=tuple(new.values())))
        state = SceneState.of(poses, joints | dict(initial.joints), motions | dict(initial.motions))
        kept = {key: value for key, value in self.kept.items() if key in ("reach", "seen") or _is_surface(key, new)}
        return Twin(
            replace(self.scene, objects=(*here, *more)),
            state,
            self.goal,
            self.robots,
            self.carried,
            self.absent | {item.name for item in more},
            kept,
        )

    # -- what is prepared when first asked for ------------------------------------------------------------------------

    @cached_property
    def judge(self) -> Judge:
        """What judges conditions in this scene."""
        from simfoundry.predicates import Judge

        return Judge(self.scene)

    @cached_property
    def world(self) -> MujocoWorld:
        """The scene without its robots in MuJoCo; one model for every layout."""
        return MujocoWorld(bare(self.scene))

    @cached_property
    def reach(self) -> Reach:
        """The arms that act."""
        from simfoundry.cousins.reach import Reach

        if "reach" not in self.kept:
            self.kept["reach"] = Reach(self.scene, self.robots)
        found: Reach = self.kept["reach"]
        return found

    @cached_property
    def robot_items(self) -> tuple[SceneObject, ...]:
        """The robots whose models are there at their start, as objects."""
        bodies = Bodies(self.scene)
        return tuple(bodies[name].item for name in bodies.robots)

    @cached_property
    def obstacles(self) -> tuple[SceneObject, ...]:
        """Obstacles besides the objects: robots, or a column at the base of a robot whose model is missing."""
        absent = [(left.path.partition(".")[2], left.X_WB) for left in self.scene.left_out if left.X_WB is not None]
        there = {item.name for item in self.robot_items}
        return (*self.robot_items, *(_column(name, X_WB) for name, X_WB in absent if name not in there))

    @cached_property
    def solids(self) -> Solids:
        """The convex parts of everything, robots included, as in :attr:`state`."""
        joints = {item.name: self.state.of_object(item) for item in self.scene.objects}
        made = Solids((*self.scene.objects, *self.obstacles), joints)
        for name, pose in self.state.poses.items():
            made.put(name, pose)
        return made

    # -- shapes -------------------------------------------------------------------------------------------------------

    def item(self, name: str) -> SceneObject:
        """An object with its joints as in :attr:`state`, at the origin."""
        key = ("item", name)
        if key not in self.kept:
            item = self.scene.object(name)
            at = self.state.of_object(item)
            joints = tuple(_moved(joint, at.get(joint.name)) for joint in item.joints)
            self.kept[key] = replace(item, X_WO=IDENTITY, joints=joints, variants=())
        found: SceneObject = self.kept[key]
        return found

    def item_at(self, name: str, X_WO: Pose) -> SceneObject:
        """An object where it is put; the same one each time, so that what is measured on it is measured once."""
        key = ("item", name, *X_WO.p.tolist(), *X_WO.q.tolist())
        if key not in self.kept:
            self.kept[key] = replace(self.item(name), X_WO=X_WO)
        found: SceneObject = self.kept[key]
        return found

    def shape(self, name: str, X_WO: Pose = IDENTITY) -> Hulls:
        """The convex parts of an object whose frame is at ``X_WO``."""
        kept = X_WO is IDENTITY or X_WO is self.state.poses.get(name)
        if not kept:
            return hulls(replace(self.item(name), X_WO=X_WO))
        if (key := ("shape", name, X_WO is IDENTITY)) not in self.kept:
            self.kept[key] = hulls(replace(self.item(name), X_WO=X_WO))
        found: Hulls = self.kept[key]
        return found

    def corners(self, name: str, X_WO: Pose) -> tuple[Array, Array]:
        """Corners of an object's parts where it is put [m], shape (n, 3), and their rounding [m], (n,)."""
        shape = self.shape(name)
        return X_WO.apply(shape.corners), shape.radius[shape.part]

    def box(self, name: str, X_WO: Pose) -> tuple[Array, Array]:
        """Lowest and highest corner in the world [m], shape (3,) each, of an object where it is put."""
        corners, radius = self.corners(name, X_WO)
        return (corners - radius[:, None]).min(axis=0), (corners + radius[:, None]).max(axis=0)

    def shadows(self, name: str, X_WO: Pose) -> tuple[Outline, ...]:
        """The shadow of each link of an object or a robot where it stands, in the world."""
        key = ("shadows", name)
        robot = {item.name: item for item in self.obstacles}.get(name)
        kept = robot is not None or X_WO is self.state.poses.get(name)
        if kept and key in self.kept:
            found: tuple[Outline, ...] = self.kept[key]
            return found
        shape = hulls(robot) if robot is not None else self.shape(name, X_WO)
        links = [shape.of_link(k) for k in dict.fromkeys(shape.link.tolist())]
        made = tuple(Outline.of(link) for link in links if len(link.corners))
        if kept:
            self.kept[key] = made
        return made

    def surfaces(self, state: SceneState, absent: Iterable[str] = ()) -> dict[str, VisibleSurface]:
        """What is seen of each thing in a state; of robots, which stand as they start, their colliders."""
        gone = set(absent)
        found = {}
        for item in self.scene.objects:
            if item.name not in gone:
                if (key := ("surface", item.name)) not in self.kept:
                    self.kept[key] = VisibleSurface.of(self.item(item.name))
                found[item.name] = self.kept[key].at(state.poses[item.name])
        for item in self.robot_items:
            if (key := ("surface", item.name)) not in self.kept:
                links = tuple(replace(link, visuals=()) for link in item.links)  # hundreds of thousands of triangles
                self.kept[key] = VisibleSurface.of(replace(item, links=links))
            found[item.name] = self.kept[key].at(item.X_WO)
        return found

    @cached_property
    def shares_seen(self) -> Mapping[str, float]:
        """How much of each object the camera that sees most of it sees, as the twin is; what is absent has no entry."""
        if not self.scene.cameras:
            return MappingProxyType({})
        if "seen" not in self.kept:
            surfaces = self.surfaces(self.state, self.absent)
            names = [item.name for item in self.scene.objects if item.name not in self.absent and not item.fixed]
            self.kept["seen"] = {n: best_view(self.scene.cameras, n, surfaces, SEEN)[1] for n in names}
        return MappingProxyType(self.kept["seen"])

    def posed(self, poses: Mapping[str, Pose]) -> SceneState:
        """:attr:`state` with some things elsewhere, at rest."""
        return SceneState.of({**self.state.poses, **poses}, self.state.joints, self.state.motions)

    def upright(self, name: str, on: str) -> Pose:
        """How a thing stands before it is turned about z, at the origin: as in the twin if it stands on ``on`` there.

        What leans elsewhere, or lies in something, stands as its own frame does, with the turn that it has.
        """
        if name not in self.absent and self.carried.get(name) == (on,):
            return Pose.of(q=self.state.poses[name].q)
        w, x, y, z = self.scene.object(name).X_WO.q
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        return Pose.of(q=quat_from_rpy(0.0, 0.0, yaw))

    def riders(self, name: str) -> tuple[str, ...]:
        """What moves along with an object: all that rests on nothing but it and other riders, in the scene's order."""
        key = ("riders", name)
        if key not in self.kept:
            moving, more = set[str](), {name}
            while more:
                moving |= more
                more = {n for n, below in self.carried.items() if n not in moving and below and set(below) <= moving}
            self.kept[key] = tuple(o.name for o in self.scene.objects if o.name in moving - {name})
        found: tuple[str, ...] = self.kept[key]
        return found

    def support(self, name: str, near: float | None = None) -> Support | None:
        """The level of an object, where it is, at the height ``near`` [m]; None where nothing of it is level."""
        key = ("support", name, near)
        if key not in self.kept:
            self.kept[key] = support_of(name, self.shape(name, self.state.poses[name]), near)
        found: Support | None = self.kept[key]
        return found

    def levels(self, name: str) -> tuple[Support, ...]:
        """Every level of an object, where it is, on which things can stand, but for those that its joints move."""
        key = ("levels", name)
        if key not in self.kept:
            self.kept[key] = supports_of(name, self.shape(name, self.state.poses[name]), self._still_links(name))
        found: tuple[Support, ...] = self.kept[key]
        return found

    def edges(self, name: str) -> list[tuple[float, BaseGeometry]]:
        """Heights [m] and areas of an object, where it is, that are level but too narrow to stand on."""
        key = ("edges", name)
        if key not in self.kept:
            self.kept[key] = edges_of(self.shape(name, self.state.poses[name]), self._still_links(name))
        found: list[tuple[float, BaseGeometry]] = self.kept[key]
        return found

    def _still_links(self, name: str) -> list[int]:
        """The links of an object, by index, that none of its joints moves."""
        item = self.scene.object(name)
        welded = weld_groups(item)
        return [k for k, link in enumerate(item.links) if welded[link.name] == welded[item.root.name]]

    @cached_property
    def places(self) -> tuple[Support, ...]:
        """Where new things may stand: every level of what is fixed, but for the floor under the furniture.

        Where nothing fixed is level, that of the object that most others stand on.
        """
        found = [level for item in self.scene.objects if item.fixed for level in self.levels(item.name)]
        if found and not any(self.carried.values()):
            return tuple(found)
        ground = self.support(self.ground)
        if ground is None:
            return tuple(found)
        return tuple(level for level in found if not _is_floor_under(ground, level)) or (ground,)

    def outline(self, name: str, upright: Pose, along: Sequence[str] = ()) -> Outline:
        """The shadow of a thing, with what rides on it, ``upright`` at the origin."""
        key = ("outline", name, *upright.q.tolist(), *along)
        if key not in self.kept:
            back = upright @ self.state.poses[name].inverse()
            shapes = [self.shape(name, upright), *(self.shape(n, back @ self.state.poses[n]) for n in along)]
            self.kept[key] = Outline.of(joined(shapes))
        found: Outline = self.kept[key]
        return found

    @cached_property
    def ground(self) -> str:
        """The object that most others stand on; raises :class:`TwinError` where none does."""
        below = [name for found in self.carried.values() for name in found]
        names = [o.name for o in self.scene.objects if o.name in below]
        if not names:
            raise TwinError(f"nothing in `{self.scene.name}` stands on anything")
        return max(names, key=below.count)

    @cached_property
    def task_objects(self) -> tuple[str, ...]:
        """The objects that the goal is about, in its order."""
        if self.goal is None:
            return ()
        names = {o.name for o in self.scene.objects}
        found = [a.partition(".")[0] for text, _ in texts(self.goal) for a in parse_call(text).args]
        return tuple(dict.fromkeys(name for name in found if name in names))

    @cached_property
    def relations(self) -> tuple[str, ...]:
        """What the scene states of itself and is true in :attr:`state`."""
        return tuple(text for text in map(str, self.scene.relations) if self.judge(text, self.state).value)


def _is_floor_under(ground: Support, level: Support) -> bool:
    """Return whether a level is the floor: far below the ground level and under most of it."""
    import shapely

    if ground.height - level.height < UNDERFOOT:
        return False
    over = shapely.intersection(shapely.polygons(ground.corners), shapely.polygons(level.corners)).area
    return bool(over > 0.5 * shapely.polygons(ground.corners).area)


def _is_surface(key: Any, new: Mapping[str, SceneObject]) -> bool:
    """Whether a key of what is kept is that of the surface of a thing that stays what it is."""
    return isinstance(key, tuple) and key[0] == "surface" and key[1] not in new


def _column(name: str, X_WB: Pose) -> SceneObject:
    """Column that keeps the base of a robot free when its model is missing."""
    none = frozen_array(np.zeros(3), (3,))
    middle = Pose.of((0.0, 0.0, BASE_HEIGHT / 2))
    collider = Collider("base", Cylinder(BASE_RADIUS, BASE_HEIGHT), friction=0.0, restitution=0.0, X_LG=middle)
    link = Link("base", 0.0, none, frozen_array(np.zeros((3, 3)), (3, 3)), (), (collider,))
    return SceneObject(name, category="", fixed=True, X_WO=X_WB, links=(link,))


def _away(item: SceneObject, k: int) -> Pose:
    """Where the k-th absent thing is, turned as it is written: engines begin there, and it must meet no other."""
    return Pose.of((ELSEWHERE * k, 0.0, 0.0), item.X_WO.q)


def _moved(joint: Joint, to: float | Pose | None) -> Joint:
    """The joint as it is in a state."""
    if to is None:
        return joint
    return replace(joint, motion=to) if isinstance(to, Pose) else replace(joint, position=to)


def bare(scene: Scene) -> Scene:
    """The scene without robots and without what is only seen: what settles."""
    objects = tuple(
        replace(o, links=tuple(replace(k, visuals=() if k.colliders else k.visuals) for k in o.links), variants=())
        for o in scene.objects
    )
    return replace(scene, objects=objects, robots=(), mounted=(), background=None, relations=())


def joined(shapes: Sequence[Hulls]) -> Hulls:
    """Several shapes as one, for its extents and its shadow; edges and faces are left out where there are several."""
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
