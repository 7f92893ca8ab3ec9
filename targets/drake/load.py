"""Load this world into Drake.

``load()`` returns a diagram, its plant, and the model instances by object name:

    diagram, plant, models = load()
    simulator = pydrake.systems.analysis.Simulator(diagram)

Contact friction, gravity, armature and motors are read from ``physics.json``, because URDF cannot represent them. Drake
uses the harmonic mean of two friction coefficients, and supports neither restitution nor Coulomb friction in joints.

Each motor is an actuator with a controller that Drake integrates implicitly. Motor targets are set in the diagram:

    set_targets(diagram, plant, simulator.get_mutable_context(), models["arm"], {"joint1": 0.2})
"""

from __future__ import annotations

import json
import tempfile
import xml.etree.ElementTree as ET
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import (
    CollisionFilterDeclaration,
    DefaultProximityProperties,
    GeometrySet,
    ProximityProperties,
    RoleAssign,
    SceneGraph,
    SceneGraphConfig,
)
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import Joint, JointActuator, ModelInstanceIndex, PdControllerGains
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

HERE = Path(__file__).resolve().parent

LEAST = 1e-9
"""Minimum stiffness of a controller [N/m or N m/rad], because Drake requires a positive value."""

STILL = 1e-4
"""Stiction threshold [m/s]. Contacts with a lower sliding speed stick."""

COMPLIANT = DefaultProximityProperties(
    compliance_type="compliant", hydroelastic_modulus=1e7, resolution_hint=0.01, hunt_crossley_dissipation=50.0
)
"""Settings for hydroelastic contacts.

With Drake's point contacts, a slab sinks into a table and a box never slips on a slope.
"""


def load(time_step: float = 1e-3) -> tuple[Diagram, MultibodyPlant, dict[str, ModelInstanceIndex]]:
    """Load all objects and finalize the plant.

    Returns:
        The diagram, the plant, and the model instances by object name.
    """
    physics = json.loads((HERE / "physics.json").read_text(encoding="utf-8"))
    poses = json.loads((HERE / "poses.json").read_text(encoding="utf-8"))
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step)
    plant.mutable_gravity_field().set_gravity_vector(physics["gravity"])
    plant.set_stiction_tolerance(STILL)
    scene_graph.set_config(SceneGraphConfig(default_proximity_properties=COMPLIANT))
    models, targets = {}, {}
    with tempfile.TemporaryDirectory(prefix="simfoundry-") as temporary:
        for name, item in poses.items():
            urdf = convex(HERE / item["urdf"], Path(temporary))
            said, robot = physics["objects"].get(name), physics.get("robots", {}).get(name)
            models[name] = load_object(plant, scene_graph, urdf, item, said)
            drives = {n: j["drive"] for n, j in said["joints"].items() if "drive" in j} if said else robot["motors"]
            for joint, drive in drives.items():
                add_motor(plant, plant.GetJointByName(joint, models[name]), drive)
            for joint, law in robot["follow"].items() if robot else ():
                follow(plant, models[name], urdf, joint, law)
            targets[name] = {joint: drive["target"] for joint, drive in drives.items()}
    between = physics.get("no_contact", [])
    silence(plant, scene_graph, [[(models[name], link) for name, link in pair] for pair in between])
    plant.Finalize()
    for name, model in models.items():
        if targets[name]:
            source = ConstantVectorSource(desired(plant, model, targets[name]))
            builder.AddNamedSystem(source_name(plant, model), source)
            builder.Connect(source.get_output_port(), plant.get_desired_state_input_port(model))
    return builder.Build(), plant, models


def set_targets(
    diagram: Diagram, plant: MultibodyPlant, context: Context, model: ModelInstanceIndex, targets: dict[str, float]
) -> None:
    """Set the motor targets [rad or m] of an object or robot in the diagram's ``context``, by joint name."""
    source = diagram.GetSubsystemByName(source_name(plant, model))
    value = source.get_mutable_source_value(source.GetMyMutableContextFromRoot(context))
    names = actuated(plant, model)
    for joint, target in targets.items():
        value[names.index(joint)] = target


def source_name(plant: MultibodyPlant, model: ModelInstanceIndex) -> str:
    """Return the name of the system that outputs the motor targets of a model."""
    return f"{plant.GetModelInstanceName(model)}_targets"


def desired(plant: MultibodyPlant, model: ModelInstanceIndex, targets: dict[str, float]) -> np.ndarray:
    """Return the desired positions of all actuators in a model, followed by their desired velocities (zero)."""
    names = actuated(plant, model)
    return np.array([targets.get(name, 0.0) for name in names] + [0.0] * len(names))


def actuated(plant: MultibodyPlant, model: ModelInstanceIndex) -> list[str]:
    """Return the names of the actuated joints in Drake's order."""
    return [plant.get_joint_actuator(k).joint().name() for k in plant.GetJointActuatorIndices(model)]


def add_motor(plant: MultibodyPlant, joint: Joint, drive: dict[str, float]) -> None:
    """Add a motor that pulls the joint toward its target like a spring and damper, up to the force limit."""
    actuator = actuator_of(plant, joint)
    actuator.set_effort_limit(drive.get("force_limit", np.inf))
    actuator.set_controller_gains(PdControllerGains(p=max(drive["stiffness"], LEAST), d=drive["damping"]))


def actuator_of(plant: MultibodyPlant, joint: Joint) -> JointActuator:
    """Return the actuator of a joint, adding one if its URDF has none."""
    for index in plant.GetJointActuatorIndices():
        actuator = plant.get_joint_actuator(index)
        if actuator.joint().index() == joint.index():
            return actuator
    return plant.AddJointActuator(joint.name(), joint)


def follow(plant: MultibodyPlant, model: ModelInstanceIndex, urdf: Path, name: str, law: dict[str, Any]) -> None:
    """Make a joint follow another joint, unless its URDF already specifies this."""
    said = ET.parse(urdf).getroot().findall("joint")
    if not any(joint.get("name") == name and joint.find("mimic") is not None for joint in said):
        joint, leader = (plant.GetJointByName(n, model) for n in (name, law["joint"]))
        plant.AddCouplerConstraint(joint, leader, law["multiplier"], law["offset"])


def convex(urdf: Path, folder: Path) -> Path:
    """Copy a URDF to ``folder`` with absolute paths.

    The collision meshes, which are always convex, are declared as such.
    """
    tree = ET.parse(urdf)
    for element in (*tree.getroot().iter("mesh"), *tree.getroot().iter("texture")):
        element.set("filename", str(urdf.parent / element.get("filename", "")))
    for mesh in tree.getroot().iterfind("link/collision/geometry/mesh"):
        ET.SubElement(mesh, "{http://drake.mit.edu}declare_convex")
    tree.write(folder / urdf.name)
    return folder / urdf.name


def load_object(
    plant: MultibodyPlant, scene_graph: SceneGraph, urdf: Path, item: dict[str, Any], physics: dict[str, Any] | None
) -> ModelInstanceIndex:
    """Load one object at its pose, with its friction, joint positions and collision filters.

    ``physics`` is None for a robot with its own URDF. Such a robot keeps Drake's default surfaces, and its links do not
    collide with each other.
    """
    parser = Parser(plant)
    parser.SetAutoRenaming(True)  # robots of the same model have the same name in their files
    (model,) = parser.AddModels(str(urdf))
    bodies = [plant.get_body(index) for index in plant.GetBodyIndices(model)]
    X_WO = RigidTransform(Quaternion(np.array(item["q_wxyz"]) / np.linalg.norm(item["q_wxyz"])), item["p"])
    if item["fixed"]:
        plant.WeldFrames(plant.world_frame(), bodies[0].body_frame(), X_WO)
    else:
        plant.SetDefaultFloatingBaseBodyPose(bodies[0], X_WO)
    names = [body.name() for body in bodies]
    if physics is not None:
        for body in bodies:
            found = plant.GetCollisionGeometriesForBody(body)
            set_friction(plant, scene_graph, found, physics["links"][body.name()])
    silent = physics["silent"] if physics is not None else combinations(names, 2)
    silence(plant, scene_graph, [[(model, link) for link in pair] for pair in silent])
    for name, position in item["joints"].items():
        joint = plant.GetJointByName(name, model)
        joint.set_default_positions([position])
        armature = physics["joints"][name]["armature"] if physics else 0.0
        if armature > 0:  # joints without a motor can have rotor inertia as well
            rotor = actuator_of(plant, joint)
            rotor.set_default_rotor_inertia(armature)
            rotor.set_default_gear_ratio(1.0)
    return model


def silence(plant: MultibodyPlant, scene_graph: SceneGraph, pairs: list[list[tuple[ModelInstanceIndex, str]]]) -> None:
    """Exclude collisions between the two links in each pair. A link is given by its model and its name in the model."""
    filtered = CollisionFilterDeclaration()
    for pair in pairs:
        bodies = (plant.GetBodyByName(link, model) for model, link in pair)
        filtered.ExcludeBetween(*(GeometrySet(plant.GetCollisionGeometriesForBody(body)) for body in bodies))
    scene_graph.collision_filter_manager().Apply(filtered)


def set_friction(
    plant: MultibodyPlant, scene_graph: SceneGraph, geometries: list[Any], surfaces: dict[str, dict[str, float]]
) -> None:
    """Set the friction coefficients of the collision shapes, which Drake names ``object::name``."""
    inspector = scene_graph.model_inspector()
    for geometry in geometries:
        surface = surfaces[inspector.GetName(geometry).rpartition("::")[2]]
        mu = surface["friction"]
        properties = ProximityProperties(inspector.GetProximityProperties(geometry))
        properties.UpdateProperty("material", "coulomb_friction", CoulombFriction(mu, mu))
        scene_graph.AssignRole(plant.get_source_id(), geometry, properties, RoleAssign.kReplace)


def main() -> None:
    """Load the world and print a summary."""
    _, plant, models = load()
    print(f"loaded {HERE / 'poses.json'}: {', '.join(models)}; {plant.num_positions()} positions")


if __name__ == "__main__":
    main()
