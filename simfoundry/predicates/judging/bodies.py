"""Collision bodies for predicates, which contain the preprocessed colliders of each link and are looked up by name."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, NamedTuple

from simfoundry.errors import SimfoundryError
from simfoundry.geometry.form import Form
from simfoundry.geometry.frames import Pose, Turn
from simfoundry.geometry.shapes import Geometry
from simfoundry.scene.model import Joint, Link, Scene, SceneObject

if TYPE_CHECKING:
    from simfoundry.backends.robot_models.robot_object import RobotObject
    from simfoundry.scene.robot import NativeModel, Robot


class PredicateError(SimfoundryError, ValueError):
    """An error raised if a predicate cannot be evaluated in a scene. The message explains the reason."""


class NoCavityError(PredicateError):
    """An error raised if a predicate requires a cavity but the object does not have one."""


@dataclass(frozen=True, eq=False)
class CollisionBody:
    """An object or robot (``item``) with the ``forms`` of its links. The form of a link without a shape is None."""

    item: SceneObject
    forms: tuple[Form | None, ...]
    robot: RobotObject | None = None

    @property
    def name(self) -> str:
        """The name of the object or robot."""
        return self.item.name

    @cached_property
    def parents(self) -> dict[int, tuple[int, tuple[Joint, ...]]]:
        """The parent of each link except the first, and the joints that connect the two, keyed by link index."""
        numbers = {link.name: k for k, link in enumerate(self.item.links)}
        return {numbers[name]: (numbers[above[0].parent], above) for name, above in self.item.joints_above.items()}

    @cached_property
    def turns(self) -> dict[str, Turn]:
        """The rotation about the axis of each joint, keyed by joint name."""
        return {joint.name: Turn(joint.axis) for joint in self.item.joints}

    def index(self, link: str) -> int:
        """Return the index of a link."""
        return next(k for k, one in enumerate(self.item.links) if one.name == link)


class Entity(NamedTuple):
    """The links of a body that an argument refers to, as indices.

    Bounding boxes use the frame of the first of these links.
    """

    name: str
    owner: str
    links: tuple[int, ...]
    whole: bool


class Joints(NamedTuple):
    """The joints of one object that an argument refers to, all of which have limits."""

    owner: str
    joints: tuple[Joint, ...]


class Bodies:
    """The bodies in a scene (its objects and robots), keyed by name. Each body is prepared only once."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.objects = tuple(o.name for o in scene.objects)
        self.robots = tuple(r.name for r in scene.robots if _native_model(r) is not None)
        self._names = dict.fromkeys((*self.objects, *self.robots))
        self._bodies: dict[str, CollisionBody] = {}
        self._hollow: dict[Entity, tuple[int, ...]] = {}

    def __getitem__(self, name: str) -> CollisionBody:
        if name not in self._bodies:
            made = _robot_object(self.scene.robot(name)) if name in self.robots else None
            item = self.scene.object(name) if made is None else made.item
            self._bodies[name] = CollisionBody(item, tuple(_form(link) for link in item.links), made)
        return self._bodies[name]

    def link_shapes(self) -> dict[tuple[str, int], tuple[tuple[Geometry, Pose], ...]]:
        """Return the collision shapes of each link of all bodies, keyed by body name and link index."""
        return {
            (item.name, k): tuple((piece.geometry, piece.X_LG) for piece in link.colliders)
            for item in (self[name].item for name in (*self.objects, *self.robots))
            for k, link in enumerate(item.links)
        }

    def thing(self, argument: str) -> Entity:
        """Return the entity that an argument refers to.

        The argument has the form ``object``, ``object.link`` or ``object.joint``, or is the name of a robot.
        """
        owner, _, part = argument.partition(".")
        body = self._body(owner)
        links = body.item.links
        if part and body.robot is not None:
            native = _native_model(self.scene.robot(owner))
            link = part if native is None else native.frame(part).link
            part = body.robot.links.get(link, link)
        chosen = tuple(range(len(links)))
        if part:
            moved = {joint.name: joint.child for joint in body.item.joints}
            name = part if any(link.name == part for link in links) else moved.get(part)
            if name is None:
                there = ", ".join(dict.fromkeys([*(link.name for link in links), *moved]))
                raise PredicateError(f"`{owner}` has no link or joint `{part}`; available links and joints: {there}")
            chosen = (body.index(name),)
        if not any(body.forms[k] for k in chosen):
            raise PredicateError(f"`{argument}` has no shape to measure")
        return Entity(argument, owner, chosen, not part)

    def hollow_links(self, thing: Entity) -> tuple[int, ...]:
        """Return the indices of an entity's links that have a cavity.

        Raises:
            NoCavityError: If none of the links has a cavity.
        """
        from simfoundry.geometry.cavity import cavity

        if thing not in self._hollow:
            forms = self[thing.owner].forms
            found = tuple(k for k in thing.links if (form := forms[k]) is not None and cavity(form) is not None)
            self._hollow[thing] = found
        if not self._hollow[thing]:
            raise NoCavityError(f"`{thing.name}` has no cavity, because its colliders do not enclose any space")
        return self._hollow[thing]

    def joints(self, argument: str) -> Joints:
        """Return the joints that an argument refers to.

        These are either a single joint, or all joints of an object that have limits.
        """
        owner, _, part = argument.partition(".")
        item = self._body(owner).item
        moving = [j for j in item.joints if j.has_axis and (not part or part in (j.name, j.child))]
        if part and not moving:
            there = ", ".join(j.name for j in item.joints if j.has_axis) or "none"
            raise PredicateError(f"`{owner}` has no joint `{part}` with limits; available joints: {there}")
        ended = [j for j in moving if j.limits is not None and j.limits[0] < j.limits[1]]
        if not ended or (part and len(ended) < len(moving)):
            raise PredicateError(f"no joint of `{argument}` has limits, so its closed position is undefined")
        return Joints(owner, tuple(ended))

    def _body(self, name: str) -> CollisionBody:
        if name in self._names:
            return self[name]
        if name in {r.name for r in self.scene.robots} or f"robots.{name}" in {p.path for p in self.scene.left_out}:
            raise PredicateError(f"no model of robot `{name}` was found; run `simfoundry doctor` for details")
        available = ", ".join(self._names) or "none"
        raise PredicateError(f"there is no `{name}` in this scene; available objects and robots: {available}")


def _native_model(robot: Robot) -> NativeModel | None:
    from simfoundry.scene.robot import mujoco_model  # most scenes that `check` reads have no robot

    return mujoco_model(robot)


def _robot_object(robot: Robot) -> RobotObject | None:
    from simfoundry.backends.robot_models.mujoco_robot import read_robot
    from simfoundry.backends.robot_models.robot_object import as_object

    native = _native_model(robot)
    return None if native is None else as_object(robot, read_robot(robot, native, f"{robot.name}."))


@lru_cache(maxsize=1024)
def _form(link: Link) -> Form | None:
    """Return the form of a link. Forms are cached, so they are computed only once for scenes that share an object."""
    shown = link.colliders or link.visuals
    return Form.of(((piece.geometry, piece.X_LG) for piece in shown), bool(link.colliders)) if shown else None
