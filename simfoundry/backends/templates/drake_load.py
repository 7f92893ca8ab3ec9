"""Load this world into Drake: ``load()`` returns a diagram, its plant and the model instances by object name.

    diagram, plant, models = load()
    simulator = pydrake.systems.analysis.Simulator(diagram)

Contact friction, gravity and armature come from ``physics.json``, because URDF has no place for them. Drake takes the
harmonic mean of the frictions of a pair, and has no restitution and no Coulomb friction of joints.
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
from pydrake.multibody.tree import ModelInstanceIndex
from pydrake.systems.framework import Diagram, DiagramBuilder

HERE = Path(__file__).resolve().parent

STILL = 1e-4
"""Below this speed [m/s] contacts stick."""

COMPLIANT = DefaultProximityProperties(
    compliance_type="compliant", hydroelastic_modulus=1e7, resolution_hint=0.01, hunt_crossley_dissipation=50.0
)
"""Contacts over areas: Drake's contacts at single points let a slab sink into a table and hold a box on any slope."""


def load(time_step: float = 1e-3) -> tuple[Diagram, MultibodyPlant, dict[str, ModelInstanceIndex]]:
    """Load every object, and finish the plant."""
    physics = json.loads((HERE / "physics.json").read_text(encoding="utf-8"))
    poses = json.loads((HERE / "poses.json").read_text(encoding="utf-8"))
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step)
    plant.mutable_gravity_field().set_gravity_vector(physics["gravity"])
    plant.set_stiction_tolerance(STILL)
    scene_graph.set_config(SceneGraphConfig(default_proximity_properties=COMPLIANT))
    models = {}
    with tempfile.TemporaryDirectory(prefix="simfoundry-") as temporary:
        for name, item in poses.items():
            urdf = convex(HERE / item["urdf"], Path(temporary))
            models[name] = load_object(plant, scene_graph, urdf, item, physics["objects"].get(name))
    plant.Finalize()
    return builder.Build(), plant, models


def convex(urdf: Path, folder: Path) -> Path:
    """A copy of a URDF in ``folder`` whose collision meshes are called convex, which they are; it has full paths."""
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
    """Load one object in its pose, with its friction, joint positions, and links that do not touch each other.

    A robot with a URDF of its own has no ``physics``: it keeps Drake's surfaces, and its links pass each other.
    """
    parser = Parser(plant)
    parser.SetAutoRenaming(True)  # two robots of a kind have one name in their files
    (model,) = parser.AddModels(str(urdf))
    bodies = [plant.get_body(index) for index in plant.GetBodyIndices(model)]
    X_WO = RigidTransform(Quaternion(np.array(item["q_wxyz"]) / np.linalg.norm(item["q_wxyz"])), item["p"])
    if item["fixed"]:
        plant.WeldFrames(plant.world_frame(), bodies[0].body_frame(), X_WO)
    else:
        plant.SetDefaultFloatingBaseBodyPose(bodies[0], X_WO)
    geometries = {body.name(): plant.GetCollisionGeometriesForBody(body) for body in bodies}
    for link, found in geometries.items():
        if physics is not None:
            set_friction(plant, scene_graph, found, physics["links"][link])
    silent = CollisionFilterDeclaration()
    for a, b in physics["silent"] if physics else combinations(geometries, 2):
        silent.ExcludeBetween(GeometrySet(geometries[a]), GeometrySet(geometries[b]))
    scene_graph.collision_filter_manager().Apply(silent)
    for name, position in item["joints"].items():
        joint = plant.GetJointByName(name, model)
        joint.set_default_positions([position])
        armature = physics["joints"][name]["armature"] if physics else 0.0
        if armature > 0:  # a motor that nobody drives, for the inertia of its rotor
            rotor = plant.AddJointActuator(f"{name}_rotor", joint)
            rotor.set_default_rotor_inertia(armature)
            rotor.set_default_gear_ratio(1.0)
    return model


def set_friction(
    plant: MultibodyPlant, scene_graph: SceneGraph, geometries: list[Any], surfaces: dict[str, dict[str, float]]
) -> None:
    """Give each collision shape its coefficient; Drake calls it ``object::name``."""
    inspector = scene_graph.model_inspector()
    for geometry in geometries:
        surface = surfaces[inspector.GetName(geometry).rpartition("::")[2]]
        mu = surface["friction"]
        properties = ProximityProperties(inspector.GetProximityProperties(geometry))
        properties.UpdateProperty("material", "coulomb_friction", CoulombFriction(mu, mu))
        scene_graph.AssignRole(plant.get_source_id(), geometry, properties, RoleAssign.kReplace)


def main() -> None:
    """Say what was loaded."""
    _, plant, models = load()
    print(f"loaded {HERE / 'poses.json'}: {', '.join(models)}; {plant.num_positions()} positions")


if __name__ == "__main__":
    main()
