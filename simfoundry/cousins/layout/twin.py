"""The digital twin from which cousins are derived, prepared once: the settled scene, its judge and its shapes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from simfoundry.cousins.layout.supports import Outline, Support
from simfoundry.cousins.layout.twin_objects import Solids, TwinObject, TwinRobots, link_shadows
from simfoundry.cousins.layout.views import SEEN, VisibleSurface, best_view
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.resets.placement import rounded
from simfoundry.evaluate.task import load_task
from simfoundry.geometry.frames import IDENTITY, Array, Pose, quat_from_rpy
from simfoundry.geometry.hulls import Hulls
from simfoundry.scene.lower import lower
from simfoundry.scene.model import Scene, SceneObject
from simfoundry.scene.object_shapes import hulls
from simfoundry.scene.state import SceneState, object_at
from simfoundry.spec.load import load, load_kind
from simfoundry.spec.models.predicate import Condition, parse_call, texts
from simfoundry.spec.models.task import TaskSpec
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.rest import supporters
from simfoundry.worlds.settle import settle

if TYPE_CHECKING:
    from simfoundry.assets.cache import Cache
    from simfoundry.cousins.layout.arrangement import Placeable
    from simfoundry.cousins.layout.constraints import PlacementConstraints
    from simfoundry.cousins.recipe.candidate import ImpossibleError
    from simfoundry.predicates import Judge


ELSEWHERE = 100.0
"""Distance [m] of absent objects from the scene and from each other while they fall, so that they meet nothing."""

UNDERFOOT = 0.3
"""A level that lies this far below a table top [m], and under it, is the floor; the lowest tables are about
this high.
"""


class TwinError(SimfoundryError):
    """A scene from which no cousins can be made; the message gives the reason."""


@dataclass(frozen=True, eq=False)
class Twin:
    """A scene, or a task in its scene, with a ``state`` at rest.

    ``goal`` is the task's goal, or None; ``robots`` act in the scene. ``carried`` lists the supports of each free
    object. ``absent`` objects are part of the scene but have no place yet: a layout must place them. A twin derived
    from another by :meth:`extended` or :meth:`at` shares all unchanged data with that ``base``.
    """

    scene: Scene
    state: SceneState
    goal: Condition | None
    robots: TwinRobots
    carried: Mapping[str, tuple[str, ...]]
    absent: frozenset[str] = frozenset()
    base: Twin | None = field(default=None, repr=False)
    # Caches of this twin alone: placement constraints by the text of their axis; objects to be placed by name, support
    # and riders; objects at rest by name; and shadows of objects with riders.
    constraints: dict[str, PlacementConstraints | ImpossibleError] = field(default_factory=dict, init=False, repr=False)
    placeables: dict[tuple[str, str, tuple[str, ...]], Placeable] = field(default_factory=dict, init=False, repr=False)
    _objects: dict[str, TwinObject] = field(default_factory=dict, init=False, repr=False)
    _outlines: dict[tuple[object, ...], Outline] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def load(cls, path: Path, cache: Cache | None = None) -> Twin:
        """Load the twin of a scene or task; raises :class:`SpecError`, or :class:`TwinError` if it cannot rest."""
        if isinstance(load(path).spec, TaskSpec):
            task = load_task(path, cache)
            return cls.of(task.scene, task.goal, task.robots)
        return cls.of(lower(load_kind(path, "scene/1", "task/1"), cache))

    @classmethod
    def of(cls, scene: Scene, goal: Condition | None = None, robots: Sequence[str] | None = None) -> Twin:
        """Settle a lowered scene as a twin; raises :class:`TwinError` if it does not come to rest."""
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
        return cls(scene, state, goal, TwinRobots(scene, acting), MappingProxyType(carried))

    def extended(self, objects: Sequence[SceneObject]) -> Twin:
        """Return the twin with more objects, absent until a layout places them; an object with a known name is
        replaced.

        A replacement stands at the place of the original, and must be settled by
        :func:`simfoundry.cousins.layout.acceptance.examine`.
        """
        new = {item.name: item for item in objects}
        known = {item.name for item in self.scene.objects}
        here = tuple(new.get(item.name, item) for item in self.scene.objects)
        absent = [item for item in objects if item.name not in known]
        # Absent objects keep their orientation: engines start there, and none must meet another.
        away = [Pose.of((ELSEWHERE * (1 + len(self.absent) + k), 0.0, 0.0), o.X_WO.q) for k, o in enumerate(absent)]
        more = tuple(replace(item, X_WO=X_WO) for item, X_WO in zip(absent, away, strict=True))
        poses = dict(self.state.poses) | {item.name: item.X_WO for item in more}
        joints = {k: v for k, v in self.state.joints.items() if k.partition(".")[0] not in new}
        motions = {k: v for k, v in self.state.motions.items() if k.partition(".")[0] not in new}
        initial = SceneState.initial(replace(self.scene, objects=tuple(new.values())))
        return replace(
            self,
            scene=replace(self.scene, objects=(*here, *more)),
            state=SceneState.of(poses, joints | dict(initial.joints), motions | dict(initial.motions)),
            absent=self.absent | {item.name for item in more},
            base=self,
        )

    def at(self, state: SceneState) -> Twin:
        """Return the twin in another state of its scene."""
        return replace(self, state=state, base=self)

    def _is_as_in_base(self, name: str) -> bool:
        """Return whether an object is unchanged and at the same pose as in the base."""
        if self.base is None:
            return False
        item = self.scene.object(name)
        same = self.base.scene.by_name.get(name) is item and self.base.state.poses[name] is self.state.poses[name]
        return same and self.base.state.of_object(item) == self.state.of_object(item)

    # -- prepared on first use ----------------------------------------------------------------------------------------

    @cached_property
    def judge(self) -> Judge:
        """The judge of conditions in this scene."""
        from simfoundry.predicates import Judge

        return self.base.judge if self.base is not None and self.base.scene is self.scene else Judge(self.scene)

    @cached_property
    def world(self) -> MujocoWorld:
        """MuJoCo world of the scene without its robots; one model for every layout."""
        if self.base is not None and self.base.scene is self.scene:
            return self.base.world
        return MujocoWorld(bare(self.scene))

    @cached_property
    def solids(self) -> Solids:
        """Convex parts of all objects and robots, posed as in :attr:`state`."""
        joints = {item.name: self.state.of_object(item) for item in self.scene.objects}
        made = Solids((*self.scene.objects, *self.robots.obstacles), joints)
        for name, pose in self.state.poses.items():
            made.put(name, pose)
        return made

    # -- shapes -------------------------------------------------------------------------------------------------------

    def __getitem__(self, name: str) -> TwinObject:
        """Return the object ``name`` at its rest pose."""
        if name not in self._objects:
            if self.base is not None and self._is_as_in_base(name):
                self._objects[name] = self.base[name]
            else:
                item = object_at(self.scene.object(name), self.state)
                self._objects[name] = TwinObject(replace(item, X_WO=IDENTITY), self.state.poses[name])
        return self._objects[name]

    def item_at(self, name: str, X_WO: Pose) -> SceneObject:
        """Return an object at a pose, with its joint positions from :attr:`state`."""
        own = self[name]
        return own.standing if X_WO is own.X_WO else replace(own.item, X_WO=X_WO)

    def shape(self, name: str, X_WO: Pose = IDENTITY) -> Hulls:
        """Convex parts of an object whose frame is at ``X_WO``."""
        own = self[name]
        if X_WO is IDENTITY:
            return own.shape
        return own.placed if X_WO is own.X_WO else own.shape.posed(X_WO)

    def box(self, name: str, X_WO: Pose) -> tuple[Array, Array]:
        """Lowest and highest corner of an object's bounding box in the world [m], shape (3,) each."""
        return self[name].shape.posed(X_WO).bounds()

    def shadows(self, name: str, X_WO: Pose) -> tuple[Outline, ...]:
        """Shadow of each link of an object at a pose, in the world."""
        own = self[name]
        return own.shadows if X_WO is own.X_WO else link_shadows(self.shape(name, X_WO))

    def surfaces(self, state: SceneState, absent: Iterable[str] = ()) -> dict[str, VisibleSurface]:
        """Visible surfaces of all objects in a state, and of the robots in their start configuration."""
        gone = set(absent)
        there = [item.name for item in self.scene.objects if item.name not in gone]
        return {name: self[name].surface.at(state.poses[name]) for name in there} | dict(self.robots.surfaces)

    @cached_property
    def shares_seen(self) -> Mapping[str, float]:
        """Share of each object that the best camera sees in the twin itself; absent objects have no entry."""
        if self.base is not None:
            return self.base.shares_seen
        if not self.scene.cameras:
            return MappingProxyType({})
        surfaces = self.surfaces(self.state, self.absent)
        names = [item.name for item in self.scene.objects if item.name not in self.absent and not item.fixed]
        return MappingProxyType({n: best_view(self.scene.cameras, n, surfaces, SEEN)[1] for n in names})

    def posed(self, poses: Mapping[str, Pose]) -> SceneState:
        """Return :attr:`state` at rest with some objects moved to other poses."""
        return SceneState.of({**self.state.poses, **poses}, self.state.joints, self.state.motions)

    def upright(self, name: str, on: str) -> Pose:
        """Rotation of an object before it is rotated about z, at the origin: as in the twin if it stands so ``on`` it.

        An object that leans elsewhere, or lies in a container, is aligned with its own frame and keeps its yaw.
        """
        if name not in self.absent and self.carried.get(name) == (on,):
            return Pose.of(q=self.state.poses[name].q)
        w, x, y, z = self.scene.object(name).X_WO.q
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        return Pose.of(q=quat_from_rpy(0.0, 0.0, yaw))

    def riders(self, name: str) -> tuple[str, ...]:
        """Objects that move along with ``name``: those supported only by it and its other riders, in scene order."""
        if self.base is not None:
            return self.base.riders(name)
        return self._riders.get(name, ())

    @cached_property
    def _riders(self) -> Mapping[str, tuple[str, ...]]:
        found = {}
        for name in {below for carriers in self.carried.values() for below in carriers}:
            moving, more = set[str](), {name}
            while more:
                moving |= more
                more = {n for n, below in self.carried.items() if n not in moving and below and set(below) <= moving}
            found[name] = tuple(o.name for o in self.scene.objects if o.name in moving - {name})
        return found

    @cached_property
    def places(self) -> tuple[Support, ...]:
        """Levels on which new objects may stand: those of all fixed objects, except the floor under the furniture.

        If no fixed object has a level, use those of the object that supports the most others.
        """
        found = [level for item in self.scene.objects if item.fixed for level in self[item.name].levels]
        if found and not any(self.carried.values()):
            return tuple(found)
        ground = self[self.ground].support(None)
        if ground is None:
            return tuple(found)
        return tuple(level for level in found if not _is_floor_under(ground, level)) or (ground,)

    def outline(self, name: str, upright: Pose, along: Sequence[str] = ()) -> Outline:
        """Shadow of an object together with the riders ``along``, ``upright`` at the origin."""
        if not along:
            return self[name].outline(upright)
        key = (name, tuple(upright.q.tolist()), tuple(along))
        if key not in self._outlines:
            back = upright @ self.state.poses[name].inverse()
            items = [self.item_at(n, back @ self.state.poses[n]) for n in along]
            self._outlines[key] = Outline.of(hulls(self.item_at(name, upright), *items))
        return self._outlines[key]

    @cached_property
    def ground(self) -> str:
        """Name of the object that supports the most others; raises :class:`TwinError` if there is none."""
        below = [name for found in self.carried.values() for name in found]
        names = [o.name for o in self.scene.objects if o.name in below]
        if not names:
            raise TwinError(f"no object in `{self.scene.name}` stands on another")
        return max(names, key=below.count)

    @cached_property
    def task_objects(self) -> tuple[str, ...]:
        """Objects that the goal is about, in its order."""
        if self.goal is None:
            return ()
        names = {o.name for o in self.scene.objects}
        found = [a.partition(".")[0] for text, _ in texts(self.goal) for a in parse_call(text).args]
        return tuple(dict.fromkeys(name for name in found if name in names))

    @cached_property
    def relations(self) -> tuple[str, ...]:
        """Relations stated by the scene that are true in :attr:`state`; those of the base are not evaluated again."""
        return tuple(text for text in map(str, self.scene.relations) if self._holds(text))

    def _holds(self, text: str) -> bool:
        names = {argument.partition(".")[0] for argument in parse_call(text).args}
        if self.base is not None and all(n in self.scene.by_name and self._is_as_in_base(n) for n in names):
            return text in self.base.relations
        return self.judge(text, self.state).value


def _is_floor_under(ground: Support, level: Support) -> bool:
    """Return whether a level is the floor: far below the ground level and under most of it."""
    import shapely

    if ground.height - level.height < UNDERFOOT:
        return False
    over = shapely.intersection(shapely.polygons(ground.corners), shapely.polygons(level.corners)).area
    return bool(over > 0.5 * shapely.polygons(ground.corners).area)


def bare(scene: Scene) -> Scene:
    """Return the scene that is settled: without robots and without visual-only geometry."""
    objects = tuple(
        replace(o, links=tuple(replace(k, visuals=() if k.colliders else k.visuals) for k in o.links), variants=())
        for o in scene.objects
    )
    return replace(scene, objects=objects, robots=(), mounted=(), background=None, relations=())
