"""The digital twin from which cousins are derived: a settled scene with its judge and cached shapes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from simfoundry.cousins.layout.supports import Outline, Support
from simfoundry.cousins.layout.twin_objects import Solids, TwinObject, TwinRobots, link_shadows
from simfoundry.cousins.layout.views import SEEN, VisibleSurface, best_view
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.resets.placement import rounded
from simfoundry.evaluate.task import task_of
from simfoundry.geometry.frames import IDENTITY, Array, Pose, quat_from_rpy
from simfoundry.geometry.hulls import Hulls
from simfoundry.scene.lower import lower
from simfoundry.scene.model import Scene, SceneObject
from simfoundry.scene.object_shapes import hulls
from simfoundry.scene.state import SceneState, object_at
from simfoundry.spec.files import Loaded
from simfoundry.spec.load import load_kind
from simfoundry.spec.models.predicate import Condition, parse_call, texts
from simfoundry.spec.models.task import TaskSpec
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.rest import supporters
from simfoundry.worlds.settle import settle

if TYPE_CHECKING:
    from simfoundry.assets.cache import Cache
    from simfoundry.cousins.layout.arrangement import Placeable
    from simfoundry.cousins.layout.constraints import PlacementConstraints
    from simfoundry.predicates import Judge


# Distance [m] of absent objects from the scene and from each other, chosen so that they do not collide as they fall.
ELSEWHERE = 100.0

# Minimum height [m] of a tabletop above the floor; the lowest tables are about this high.
UNDERFOOT = 0.3


class TwinError(SimfoundryError):
    """An error raised for a scene from which cousins cannot be derived."""


@dataclass(frozen=True, eq=False)
class Twin:
    """A scene, optionally with a task, in a state at rest.

    Attributes:
        scene: The lowered scene.
        state: State at rest.
        goal: Goal of the task, or None if there is no task.
        robots: The robots in the scene.
        carried: Names of the objects that support each free object, keyed by the free object's name.
        absent: Names of objects in the scene that no layout has placed yet.
        base: Twin from which this one was derived by :meth:`extended` or :meth:`at`. Unchanged data is shared.
    """

    scene: Scene
    state: SceneState
    goal: Condition | None
    robots: TwinRobots
    carried: Mapping[str, tuple[str, ...]]
    absent: frozenset[str] = frozenset()
    base: Twin | None = field(default=None, repr=False)
    # Caches that are not shared with derived twins: placement constraints by the JSON text of their axis, objects to be
    # placed by name, support and riders, objects at rest by name, and shadows of objects with riders.
    constraints: dict[str, PlacementConstraints] = field(default_factory=dict, init=False, repr=False)
    placeables: dict[tuple[str, str, tuple[str, ...]], Placeable] = field(default_factory=dict, init=False, repr=False)
    _objects: dict[str, TwinObject] = field(default_factory=dict, init=False, repr=False)
    _outlines: dict[tuple[object, ...], Outline] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def load(cls, path: Path, cache: Cache | None = None) -> Twin:
        """Load a scene or task document as a twin.

        Raises:
            SpecError: The document is invalid.
            TwinError: The scene does not come to rest.
        """
        return cls.of_document(load_kind(path, "scene/1", "task/1"), cache)

    @classmethod
    def of_document(cls, loaded: Loaded, cache: Cache | None = None) -> Twin:
        """Create a twin from a scene or task document without errors.

        Raises:
            SpecError: The document cannot be lowered.
            TwinError: The scene does not come to rest.
        """
        if isinstance(loaded.spec, TaskSpec):
            task = task_of(loaded, cache)
            return cls.of(task.scene, task.goal, task.robots)
        return cls.of(lower(loaded, cache))

    @classmethod
    def of(cls, scene: Scene, goal: Condition | None = None, robots: Sequence[str] | None = None) -> Twin:
        """Create a twin from a lowered scene by settling it.

        Args:
            scene: The scene.
            goal: Goal of the task, or None if there is no task.
            robots: Names of the robots that act in the task. By default, all robots act.

        Raises:
            TwinError: The scene does not come to rest.
        """
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
        """Return the twin with objects added or replaced.

        An object with an existing name replaces the original at the same pose. The result must then be settled with
        :func:`simfoundry.cousins.layout.acceptance.examine`. All other objects are absent until a layout places them.
        """
        new = {item.name: item for item in objects}
        here = tuple(new.get(item.name, item) for item in self.scene.objects)
        absent = [item for item in objects if item.name not in self.scene.by_name]
        # Absent objects keep their orientations but are moved far apart, because engines start from these poses.
        away = (ELSEWHERE * (1 + len(self.absent) + k) for k in range(len(absent)))
        more = tuple(replace(o, X_WO=Pose.of((x, 0.0, 0.0), o.X_WO.q)) for o, x in zip(absent, away, strict=True))
        poses = dict(self.state.poses) | {item.name: item.X_WO for item in more}
        joints = {k: v for k, v in self.state.joints.items() if k.partition(".")[0] not in new}
        motions = {k: v for k, v in self.state.motions.items() if k.partition(".")[0] not in new}
        initial = SceneState.initial(replace(self.scene, objects=tuple(new.values())))
        state = SceneState.of(poses, joints | dict(initial.joints), motions | dict(initial.motions))
        scene = replace(self.scene, objects=(*here, *more))
        return replace(self, scene=scene, state=state, absent=self.absent | {item.name for item in more}, base=self)

    def at(self, state: SceneState) -> Twin:
        """Return the twin with its scene in a different state."""
        return replace(self, state=state, base=self)

    def _is_as_in_base(self, name: str) -> bool:
        """Return True if an object and its state are the same as in the base twin."""
        if self.base is None:
            return False
        item = self.scene.object(name)
        same = self.base.scene.by_name.get(name) is item and self.base.state.poses[name] is self.state.poses[name]
        return same and self.base.state.of_object(item) == self.state.of_object(item)

    # -- created on first use -----------------------------------------------------------------------------------------

    @cached_property
    def judge(self) -> Judge:
        """The judge that evaluates conditions in this scene."""
        from simfoundry.predicates import Judge

        return self.base.judge if self.base is not None and self.base.scene is self.scene else Judge(self.scene)

    @cached_property
    def world(self) -> MujocoWorld:
        """The MuJoCo world that is used for all layouts of the scene, without robots."""
        if self.base is not None and self.base.scene is self.scene:
            return self.base.world
        return MujocoWorld(bare(self.scene))

    @cached_property
    def solids(self) -> Solids:
        """The convex parts of all objects and robots, posed as in :attr:`state`."""
        joints = {item.name: self.state.of_object(item) for item in self.scene.objects}
        made = Solids((*self.scene.objects, *self.robots.obstacles), joints)
        for name, pose in self.state.poses.items():
            made.put(name, pose)
        return made

    # -- shapes -------------------------------------------------------------------------------------------------------

    def __getitem__(self, name: str) -> TwinObject:
        """Return the object called ``name`` at its rest pose."""
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
        """Return the convex parts of an object whose frame is at ``X_WO``. By default, the frame is at the origin."""
        own = self[name]
        if X_WO is IDENTITY:
            return own.shape
        return own.placed if X_WO is own.X_WO else own.shape.posed(X_WO)

    def box(self, name: str, X_WO: Pose) -> tuple[Array, Array]:
        """Return the minimum and maximum corners of an object's bounding box in the world [m].

        Returns:
            Two arrays of shape (3,).
        """
        return self[name].shape.posed(X_WO).bounds()

    def shadows(self, name: str, X_WO: Pose) -> tuple[Outline, ...]:
        """Return the shadow of each link of an object at a pose, in the world frame."""
        own = self[name]
        return own.shadows if X_WO is own.X_WO else link_shadows(self.shape(name, X_WO))

    def surfaces(self, state: SceneState, absent: Iterable[str] = ()) -> dict[str, VisibleSurface]:
        """Return the visible surfaces of all objects in a state and of the robots in their initial configuration.

        Objects in ``absent`` are omitted.
        """
        gone = set(absent)
        there = [item.name for item in self.scene.objects if item.name not in gone]
        return {name: self[name].surface.at(state.poses[name]) for name in there} | dict(self.robots.surfaces)

    @cached_property
    def shares_seen(self) -> Mapping[str, float]:
        """The fraction of each free object that the best camera sees in the twin itself. Absent objects are omitted."""
        if self.base is not None:
            return self.base.shares_seen
        if not self.scene.cameras:
            return MappingProxyType({})
        surfaces = self.surfaces(self.state, self.absent)
        names = [item.name for item in self.scene.objects if item.name not in self.absent and not item.fixed]
        return MappingProxyType({n: best_view(self.scene.cameras, n, surfaces, SEEN)[1] for n in names})

    def posed(self, poses: Mapping[str, Pose]) -> SceneState:
        """Return a copy of :attr:`state` in which the objects in ``poses`` have been moved."""
        return SceneState.of({**self.state.poses, **poses}, self.state.joints, self.state.motions)

    def upright(self, name: str, on: str) -> Pose:
        """Return an object's orientation before it is rotated about z and placed, as a pose at the origin.

        If ``on`` is the only support of the object in the twin, the object's orientation in the twin is used.
        Otherwise, the object may be leaning, or lying in a container, so its frame is made upright and only its yaw is
        preserved.
        """
        if name not in self.absent and self.carried.get(name) == (on,):
            return Pose.of(q=self.state.poses[name].q)
        w, x, y, z = self.scene.object(name).X_WO.q
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        return Pose.of(q=quat_from_rpy(0.0, 0.0, yaw))

    def riders(self, name: str) -> tuple[str, ...]:
        """Return the objects that move along with ``name``, which are those supported only by it or by other riders."""
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
        """The level surfaces on which new objects can be placed.

        These are the level surfaces of all fixed objects, except the floor under furniture. If there are none, the
        largest level surface of the object that supports the most other objects is used.
        """
        found = [level for item in self.scene.objects if item.fixed for level in self[item.name].levels]
        if found and not any(self.carried.values()):
            return tuple(found)
        ground = self[self.ground].support(None)
        if ground is None:
            return tuple(found)
        return tuple(level for level in found if not _is_floor_under(ground, level)) or (ground,)

    def outline(self, name: str, upright: Pose, along: Sequence[str] = ()) -> Outline:
        """Return the combined shadow of an object and the riders in ``along``.

        The object's frame is at the pose ``upright``.
        """
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
        """The name of the object that supports the most other objects.

        Raises:
            TwinError: There is no such object.
        """
        below = [name for found in self.carried.values() for name in found]
        names = [o.name for o in self.scene.objects if o.name in below]
        if not names:
            raise TwinError(f"no object in `{self.scene.name}` is supported by another object")
        return max(names, key=below.count)

    @cached_property
    def task_objects(self) -> tuple[str, ...]:
        """The names of the objects in the goal, in order of appearance."""
        goals = texts(self.goal) if self.goal is not None else ()
        found = [a.partition(".")[0] for text, _ in goals for a in parse_call(text).args]
        return tuple(dict.fromkeys(name for name in found if name in self.scene.by_name))

    @cached_property
    def relations(self) -> tuple[str, ...]:
        """The relations listed in the scene that hold in :attr:`state`. Results for unchanged objects are reused."""
        return tuple(text for text in map(str, self.scene.relations) if self._holds(text))

    def _holds(self, text: str) -> bool:
        names = {argument.partition(".")[0] for argument in parse_call(text).args}
        if self.base is not None and all(n in self.scene.by_name and self._is_as_in_base(n) for n in names):
            return text in self.base.relations
        return self.judge(text, self.state).value


def _is_floor_under(ground: Support, level: Support) -> bool:
    """Return True if a level surface is the floor.

    The floor is far below the level surface of the ground object and extends under most of it.
    """
    import shapely

    if ground.height - level.height < UNDERFOOT:
        return False
    over = shapely.intersection(shapely.polygons(ground.corners), shapely.polygons(level.corners)).area
    return bool(over > 0.5 * shapely.polygons(ground.corners).area)


def bare(scene: Scene) -> Scene:
    """Return a copy of the scene for settling. It has no robots, and links with colliders have no visuals."""
    objects = tuple(map(_bare, scene.objects))
    return replace(scene, objects=objects, robots=(), mounted=(), background=None, relations=())


@lru_cache(maxsize=512)  # derived twins share most of their objects
def _bare(item: SceneObject) -> SceneObject:
    links = tuple(replace(link, visuals=() if link.colliders else link.visuals) for link in item.links)
    return replace(item, links=links, variants=())
