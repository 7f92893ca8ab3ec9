"""The Drake session, which reads back a URDF build that its ``load_drake.py`` loaded."""

from __future__ import annotations

import math
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Mesh, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointIndex, ModelInstanceIndex, RigidBody
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram

from simfoundry.geometry.frames import Pose
from simfoundry.verify import readback as rb

_UNLIMITED = 1e6
"""Velocity that the URDF states for joints without a limit, because it requires a number."""


def open_build(folder: Path, loader: ModuleType) -> rb.Session:
    """Return a session for the diagram that the loader creates."""
    return DrakeSession(*loader.load(rb.TIMESTEP))


class DrakeSession(rb.Session):
    """A Drake diagram with a discrete plant."""

    def __init__(self, diagram: Diagram, plant: MultibodyPlant, models: dict[str, ModelInstanceIndex]) -> None:
        self.diagram, self.plant = diagram, plant
        self._simulator = Simulator(diagram)
        self._context = plant.GetMyContextFromRoot(self._simulator.get_mutable_context())
        self._bodies: dict[str, RigidBody] = {}
        self._joints: dict[str, Any] = {}
        for name, model in models.items():
            owner = name.partition(".")[0]  # freely moving parts, such as `pot.lid`, are separate models
            for k, index in enumerate(plant.GetBodyIndices(model)):
                body = plant.get_body(index)
                self._bodies[name if k == 0 else f"{owner}.{body.name()}"] = body
            for index in plant.GetJointIndices(model):
                joint = plant.get_joint(JointIndex(index))
                if joint.num_positions() == 1:
                    self._joints[f"{owner}.{joint.name()}"] = joint

    def step(self) -> None:
        """Advance the discrete plant by one step."""
        self._simulator.AdvanceTo(self._simulator.get_context().get_time() + self.timestep)

    def moment(self, time: float) -> rb.Moment:
        """Return the poses of the root links and the positions of the joints."""
        poses = {name: rb.pose_numbers(self._pose(body)) for name, body in self._bodies.items() if "." not in name}
        return rb.Moment(time, poses, {name: self._position(joint) for name, joint in self._joints.items()})

    def read(self) -> rb.WorldReadback:
        """Return the links, the joints and the gravity in the plant."""
        joints = {name: self._joint(joint) for name, joint in self._joints.items()}
        return rb.WorldReadback(
            links={name: self._link(body) for name, body in self._bodies.items()},
            joints=joints,
            gravity=rb.numbers(self.plant.gravity_field().gravity_vector()),
            actuators=rb.driven(joints),
        )

    def _pose(self, body: RigidBody) -> Pose:
        return _pose(self.plant.EvalBodyPoseInWorld(self._context, body))

    def _position(self, joint: Any) -> float:
        return float(joint.GetOnePosition(self._context))

    def _link(self, body: RigidBody) -> rb.LinkReadback:
        spatial = body.default_spatial_inertia()
        com = np.asarray(spatial.get_com())
        about_com = spatial.Shift(com).CalcRotationalInertia().CopyToFullMatrix3()
        inspector = self._simulator_inspector()
        colliders = tuple(_collider(inspector, g) for g in self.plant.GetCollisionGeometriesForBody(body))
        return rb.LinkReadback(rb.pose_numbers(self._pose(body)), float(spatial.get_mass()), rb.numbers(com),
                         rb.numbers(about_com), self._held(body), colliders)  # fmt: skip

    def _held(self, body: RigidBody) -> str:
        """Return the parent of a body, which is its joint's parent, or ``free`` for a floating body."""
        if body.is_floating():
            return rb.FREE
        for index in self.plant.GetJointIndices():
            joint = self.plant.get_joint(index)
            if joint.child_body().index() == body.index():
                above = joint.parent_body().index()
                return next((name for name, each in self._bodies.items() if each.index() == above), rb.WORLD)
        return rb.FREE

    def _simulator_inspector(self) -> Any:
        (scene_graph,) = [s for s in self.diagram.GetSystems() if s.get_name() == "scene_graph"]
        return scene_graph.model_inspector()

    def _joint(self, joint: Any) -> rb.JointReadback:
        """Return the values of a joint. Drake has no Coulomb friction, and the armature is the loader's rotor inertia.

        The target is read at the plant's input, so that an unconnected port is detected.
        """
        kind = joint.type_name()
        low, high = float(joint.position_lower_limit()), float(joint.position_upper_limit())
        axis = joint.translation_axis() if kind == "prismatic" else joint.revolute_axis()
        X_CJ = _pose(joint.frame_on_child().GetFixedPoseInBodyFrame())
        actuator = self._actuator(joint)
        drive: rb.Numbers = ()
        if actuator is not None and actuator.has_controller():
            gains = actuator.get_controller_gains()
            drive = (float(gains.p), float(gains.d), *self._target(actuator))
        limit = math.inf if actuator is None else float(actuator.effort_limit())
        return rb.JointReadback(
            type=kind,
            axis=rb.numbers(X_CJ.rotation @ axis),
            limits=(low, high) if math.isfinite(low) and math.isfinite(high) else (),
            damping=float(joint.default_damping()),
            friction=0.0,
            armature=0.0 if actuator is None else float(actuator.default_reflected_inertia()),
            position=self._position(joint),
            drive=drive,
            effort=(limit,) if drive and math.isfinite(limit) else (),
            max_velocity=_limit(joint.velocity_upper_limit()),
        )

    def _actuator(self, joint: Any) -> Any:
        """Return the actuator of a joint, or None if the joint is not actuated."""
        for index in self.plant.GetJointActuatorIndices(joint.model_instance()):
            actuator = self.plant.get_joint_actuator(index)
            if actuator.joint().index() == joint.index():
                return actuator
        return None

    def _target(self, actuator: Any) -> rb.Numbers:
        """Return a controller's target, or nothing if its port is not connected.

        An unconnected port disables the controller.
        """
        model = actuator.model_instance()
        port = self.plant.get_desired_state_input_port(model)
        if not port.HasValue(self._context):
            return ()
        rank = [int(k) for k in self.plant.GetJointActuatorIndices(model)].index(int(actuator.index()))
        return (float(port.Eval(self._context)[rank]),)


def _limit(value: float) -> rb.Numbers:
    """Return a velocity limit, or nothing for the value that the URDF states for joints without a limit."""
    return (float(value),) if value < _UNLIMITED else ()


def _collider(inspector: Any, geometry: Any) -> rb.ColliderReadback:
    name = inspector.GetName(geometry).rpartition("::")[2]
    kind, bounds = _shape(inspector.GetShape(geometry), inspector, geometry)
    properties = inspector.GetProximityProperties(geometry)
    friction = properties.GetProperty("material", "coulomb_friction").dynamic_friction()
    return rb.ColliderReadback(name, kind, bounds, float(friction))


def _shape(shape: Any, inspector: Any, geometry: Any) -> tuple[str, rb.Numbers | None]:
    X_LG = _pose(inspector.GetPoseInFrame(geometry))
    match shape:
        case Box():
            return "box", rb.shape_bounds("box", shape.size(), X_LG)
        case Sphere():
            return "sphere", rb.shape_bounds("sphere", [shape.radius()], X_LG)
        case Cylinder():
            return "cylinder", rb.shape_bounds("cylinder", [shape.radius(), shape.length()], X_LG)
        case Capsule():
            return "capsule", rb.shape_bounds("capsule", [shape.radius(), shape.length()], X_LG)
        case Mesh() | Convex():
            hull = shape.GetConvexHull()
            vertices = np.array([hull.vertex(k) for k in range(hull.num_vertices())])
            return "mesh", rb.mesh_bounds(vertices, X_LG)
    return "other", None


def _pose(transform: RigidTransform) -> Pose:
    return Pose.from_matrix(np.asarray(transform.GetAsMatrix4()))
