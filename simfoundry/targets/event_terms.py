"""Random values of a recipe as event terms of Isaac Lab, whose environments draw them themselves.

The names and parameters are those of ``isaaclab.envs.mdp``; ``tests/targets/recorded/isaaclab_events.json`` lists the
signatures of the releases that were compared.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from simfoundry.backends.artifact import rounded
from simfoundry.backends.features import Fidelity
from simfoundry.backends.losses import Loss, approximate, drop
from simfoundry.scene.model import Joint, JointType, Scene, SceneObject
from simfoundry.scene.random_values import AXIS, RandomQuantity, RandomValue

# The file in the build from which the loader reads the terms.
EVENTS_FILE = "events.json"

# Number of materials among which PhysX chooses for each shape; it supports 64,000 in a simulation.
BUCKETS = 64

# Greatest angle [rad] between the z axis of an object and the vertical for which both axes of a yaw are the same.
UPRIGHT = 1e-3

# Reasons why values of a section are not written.
_DROPPED: Mapping[str, str] = {
    "lights": "Isaac Lab has no event term for lights.",
    "cameras": "The cameras are prims of the stage, which no event term changes.",
    "background": "The background is part of the stage, which no event term changes.",
    "robots": "The configuration does not define the robots as assets, so event terms cannot refer to them.",
    "parameters": "Event terms change quantities of the simulation, not parameters of a document.",
    "frames": "Event terms change quantities of the simulation, not frames of a document.",
    "options": "The time step and the solver are the same in all environments.",
    "instruction": "The environment, not an event term, holds the instruction.",
    "disturbances": "Noise and latency belong to the observation and action terms of an environment.",
    AXIS: "The build contains the twin. Generate cousins with `simfoundry cousins`, and compile their folder.",
}
_PICTURES = "Isaac Lab changes colors and textures only of assets that its own converters have written."
_NO_TERM = "Isaac Lab has no event term for this value."
_STATIC = "The configuration defines only movable objects as assets, so event terms cannot refer to it."
_UNIFORM = "The event term draws only uniformly distributed numbers."


@dataclass(frozen=True)
class EventTerm:
    """An event term.

    Attributes:
        func: The name of the function in ``isaaclab.envs.mdp``.
        mode: The mode of the event, ``startup`` or ``reset``.
        params: The parameters besides ``asset_cfg``.
        asset: The arguments of the ``SceneEntityCfg``, or empty if the function has none.
    """

    func: str
    mode: str
    params: Mapping[str, Any]
    asset: Mapping[str, Any] = field(default_factory=dict)


def asset_kind(item: SceneObject) -> str:
    """Return what an object is in Isaac Lab's configuration: ``rigid``, ``articulation`` or ``static``."""
    moving = any(joint.type is not JointType.FIXED for joint in item.joints)
    return "articulation" if item.joints and (moving or not item.fixed) else "static" if item.fixed else "rigid"


def events_file(scene: Scene) -> dict[str, bytes]:
    """Return ``events.json`` with the terms by name, or no file if the scene has no random values."""
    if not scene.random_values:
        return {}
    terms = {name: vars(term) for name, term in _EventWriter(scene).terms.items()}
    data = {"module": "isaaclab.envs.mdp", "terms": terms}
    return {EVENTS_FILE: (json.dumps(data, indent=2, ensure_ascii=False) + "\n").encode()}


def event_losses(scene: Scene) -> list[Loss]:
    """Return the losses of random values that no event term draws in the same way."""
    return _EventWriter(scene).losses


class _EventWriter:
    """Translates the random values of a scene to terms and losses."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.terms: dict[str, EventTerm] = {}
        self.losses: list[Loss] = []
        self._surfaces: dict[str, list[RandomValue]] = {}
        self._joints: dict[str, list[RandomValue]] = {}
        for value in scene.random_values:
            self._add(value)
        for name, values in self._surfaces.items():
            self._add_surface(scene.object(name), values)
        for name, values in self._joints.items():
            self._add_joint_positions(scene.object(name), values)

    def _drop(self, value: RandomValue, reason: str) -> None:
        self.losses.append(drop("vary", value.name, reason))

    def _approximate(self, value: RandomValue, *reasons: str) -> None:
        found = [approximate("vary", value.name, reason) for reason in reasons if reason]
        self.losses += [loss for loss in found if loss not in self.losses]

    def _add(self, value: RandomValue) -> None:
        names = {element.partition(".")[0] for element in value.elements}
        movable = [name for name in names if asset_kind(self.scene.object(name)) != "static"]
        if names and not movable and value.quantity is not RandomQuantity.OTHER:
            self._drop(value, _STATIC)
            return
        match value.quantity:
            case RandomQuantity.MASS:
                self._add_mass(value)
            case RandomQuantity.FRICTION | RandomQuantity.RESTITUTION if movable:
                self._note_surface(value)
            case RandomQuantity.GRAVITY:
                self._add_gravity(value)
            case RandomQuantity.POSE:
                self._add_pose(value)
            case RandomQuantity.JOINT_POSITION if value.elements:
                self._note_joint(value)
            case RandomQuantity.JOINT_FRICTION | RandomQuantity.ARMATURE:
                self._add_joint_parameter(value)
            case RandomQuantity.JOINT_DAMPING:
                self._drop(value, "No event term changes the viscous friction of a joint.")
            case _:
                picture = value.name.rpartition(".")[2] in ("color", "texture", "visual")
                self._drop(value, _DROPPED.get(value.section, _PICTURES if picture else _NO_TERM))
        is_dropped = any(loss.element == value.name and loss.fidelity is Fidelity.DROPPED for loss in self.losses)
        if value.together and not is_dropped:
            self._approximate(value, "Event terms draw each value by itself, also those that a recipe draws together.")

    # -- bodies -------------------------------------------------------------------------------------------------------

    def _add_mass(self, value: RandomValue) -> None:
        item = self.scene.object(value.elements[0])
        if value.form == "other":
            self._drop(value, "The event term draws no choices.")
            return
        forms = {"uniform": "uniform", "log_uniform": "log_uniform", "normal": "gaussian"}
        if len(item.links) > 1:
            self._approximate(value, f"Each of the {len(item.links)} links is drawn by itself.")
        self._approximate(value, _CUT_OFF if value.form == "normal" else "")
        params = {
            "mass_distribution_params": _pair(value.ends),
            "operation": value.operation,
            "distribution": forms[value.form],
            "recompute_inertia": True,
        }
        self._term(item, "mass", "randomize_rigid_body_mass", "startup", params)

    def _note_surface(self, value: RandomValue) -> None:
        if value.form != "uniform":
            self._drop(value, _UNIFORM)
            return
        fixed = []
        for name in value.elements:
            item = self.scene.object(name)
            kind = {float(getattr(c, value.quantity.value)) for link in item.links for c in link.colliders}
            if asset_kind(item) == "static":
                fixed.append(f"`{name}`")
            elif not kind or (len(kind) > 1 and value.operation != "abs"):
                self._drop(value, f"The parts of `{name}` differ in {value.quantity}, which a term would make equal.")
            else:
                self._surfaces.setdefault(name, []).append(value)
        if fixed:
            self._approximate(
                value, f"{', '.join(fixed)}: static objects are no assets, and keep their {value.quantity}."
            )
        if len(value.elements) - len(fixed) > 1:
            self._approximate(value, "Each object of the material is drawn by itself.")

    def _add_surface(self, item: SceneObject, values: list[RandomValue]) -> None:
        """Add a term for the friction and the restitution of an object, which Isaac Lab only sets together."""
        ranges = {}
        for quantity in (RandomQuantity.FRICTION, RandomQuantity.RESTITUTION):
            bases = [float(getattr(c, quantity.value)) for link in item.links for c in link.colliders]
            ends = (min(bases), max(bases))
            for value in (value for value in values if value.quantity is quantity):
                ends = _applied(value, bases[0])
            # The stage contains square roots, which PhysX multiplies.
            ranges[quantity] = _pair((math.sqrt(ends[0]), math.sqrt(ends[1])))
        reason = "Static and dynamic friction are drawn separately for each shape, and their square roots uniformly."
        self._approximate(values[0], reason)
        friction = ranges[RandomQuantity.FRICTION]
        params = {
            "static_friction_range": friction,
            "dynamic_friction_range": friction,
            "restitution_range": ranges[RandomQuantity.RESTITUTION],
            "num_buckets": BUCKETS,
            "make_consistent": True,
        }
        self._term(item, "material", "randomize_rigid_body_material", "startup", params)

    def _add_gravity(self, value: RandomValue) -> None:
        if value.form not in ("uniform", "ball", "box"):
            self._drop(value, _UNIFORM)
            return
        low, high = ([end] * 3 for end in value.ends)
        if value.operation == "add":
            low, high = [-s for s in value.shift], list(value.shift)
        each = "A shift in a ball becomes one in a box." if value.form == "ball" else ""
        self._approximate(value, "In PhysX, all environments have the same gravity.", each)
        params = {
            "gravity_distribution_params": [_pair(low), _pair(high)],
            "operation": value.operation,
            "distribution": "uniform",
        }
        self.terms["gravity"] = EventTerm("randomize_physics_scene_gravity", "startup", params)

    def _add_pose(self, value: RandomValue) -> None:
        item = self.scene.object(value.elements[0])
        if item.fixed:
            self._drop(value, "The object is welded to the world.")
            return
        if value.form not in ("ball", "box", "uniform"):
            self._drop(value, _UNIFORM)
            return
        ranges = {axis: _pair((-s, s)) for axis, s in zip("xyz", value.shift, strict=True) if s}
        if value.form == "uniform":  # a height
            ranges["z"] = _pair(value.ends)
        if value.turn:
            ranges |= {axis: _pair((-value.turn, value.turn)) for axis in ("roll", "pitch", "yaw")}
        if value.yaw:
            ranges["yaw"] = _pair((-value.yaw, value.yaw))
        leans = math.acos(min(1.0, abs(float(item.X_WO.rotation[2, 2])))) > UPRIGHT
        self._approximate(
            value,
            "A shift in a ball becomes one in a box." if value.form == "ball" else "",
            "Roll, pitch and yaw are drawn separately." if value.turn else "",
            "Isaac Lab turns the object about its own z axis." if value.yaw and leans else "",
            "What stands on the object does not move along." if value.with_contents else "",
        )
        params = {"pose_range": ranges, "velocity_range": {}}
        self._term(item, "pose", "reset_root_state_uniform", "reset", params)

    # -- joints -------------------------------------------------------------------------------------------------------

    def _note_joint(self, value: RandomValue) -> None:
        if value.form != "uniform":
            self._drop(value, _UNIFORM)
        else:
            self._joints.setdefault(value.elements[0].partition(".")[0], []).append(value)

    def _add_joint_positions(self, item: SceneObject, values: list[RandomValue]) -> None:
        """Add one term for all joints of an object, because a second one would undo the first."""
        moving = [joint for joint in item.joints if joint.type is not JointType.FIXED]
        ends = {v.elements[0].partition(".")[2]: _applied(v, _joint(item, v).position) for v in values}
        if len(moving) == 1:
            low, high = ends[moving[0].name]
            offset = _pair((low - moving[0].position, high - moving[0].position))
            params: dict[str, Any] = {"position_range": offset, "velocity_range": [0.0, 0.0]}
            self._term(item, "joints", "reset_joints_by_offset", "reset", params)
            return
        self._approximate(values[0], "Older releases of Isaac Lab lack the term `reset_joints_within_limits_range`.")
        params = {
            "position_range": {name: _pair(pair) for name, pair in ends.items()},
            "velocity_range": {name: [0.0, 0.0] for name in ends},
        }
        self._term(item, "joints", "reset_joints_within_limits_range", "reset", params)

    def _add_joint_parameter(self, value: RandomValue) -> None:
        name, _, joint = value.elements[0].partition(".")
        item = self.scene.object(name)
        key = "armature" if value.quantity is RandomQuantity.ARMATURE else "friction"
        forms = {"uniform": "uniform", "log_uniform": "log_uniform", "normal": "gaussian"}
        if value.form not in forms:
            self._drop(value, "The event term draws no choices.")
            return
        if key == "friction" and value.operation != "scale":
            self._drop(
                value, "The event term would replace the damping of the joint by the drawn friction; use `times`."
            )
            return
        if key == "friction" and _joint(item, value).damping:
            self._approximate(value, "The event term multiplies the damping of the joint by another factor.")
        self._approximate(value, _CUT_OFF if value.form == "normal" else "")
        params = {
            f"{key}_distribution_params": _pair(value.ends),
            "operation": value.operation,
            "distribution": forms[value.form],
        }
        self._term(item, f"{joint}_{key}", "randomize_joint_parameters", "startup", params, {"joint_names": [joint]})

    def _term(
        self,
        item: SceneObject,
        what: str,
        func: str,
        mode: str,
        params: Mapping[str, Any],
        asset: Mapping[str, Any] | None = None,
    ) -> None:
        self.terms[f"{item.name}_{what}"] = EventTerm(func, mode, params, {"name": item.name, **(asset or {})})


_CUT_OFF = "The event term does not cut off the normal distribution."


def _joint(item: SceneObject, value: RandomValue) -> Joint:
    name = value.elements[0].partition(".")[2]
    return next(joint for joint in item.joints if joint.name == name)


def _applied(value: RandomValue, base: float) -> tuple[float, float]:
    """Return the range of the quantity whose value in the scene is ``base``."""
    low, high = value.ends
    match value.operation:
        case "scale":
            low, high = sorted((base * low, base * high))
        case "add":
            low, high = base + low, base + high
    return low, high


def _pair(numbers: tuple[float, ...] | list[float]) -> list[float]:
    return [rounded(number) for number in numbers]
