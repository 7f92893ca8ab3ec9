"""USD in: units, up axes, scales, joints whichever way round, masses."""

from __future__ import annotations

import math

import numpy as np
import pytest

from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.geometry.shapes import Box, Capsule
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import JointType
from tests.frontends.conftest import Importing

CENTIMETERS = """#usda 1.0
( defaultPrim = "World"; metersPerUnit = 0.01; upAxis = "Y"; kilogramsPerUnit = 0.001 )
def Xform "World" {
  def PhysicsScene "Physics" {
    vector3f physics:gravityDirection = (0, -1, 0)
    float physics:gravityMagnitude = 981
  }
  def Xform "Box" ( prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"] ) {
    double3 xformOp:translate = (10, 20, 30)
    float3 xformOp:rotateXYZ = (30, 0, 0)
    double3 xformOp:scale = (2, 2, 2)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ", "xformOp:scale"]
    float physics:mass = 500
    point3f physics:centerOfMass = (1, 2, 3)
    float3 physics:diagonalInertia = (5000, 6000, 7000)
    def Cube "Shape" ( prepend apiSchemas = ["PhysicsCollisionAPI"] ) {
      double size = 2
      double3 xformOp:scale = (1, 2, 3)
      uniform token[] xformOpOrder = ["xformOp:scale"]
    }
  }
  def Capsule "Rod" ( prepend apiSchemas = ["PhysicsCollisionAPI"] ) {
    double radius = 5
    double height = 40
    uniform token axis = "X"
  }
}
"""


def test_centimeters_grams_and_y_up_become_si_and_z_up(importing: Importing) -> None:
    _, scene = importing("s.usda", CENTIMETERS)
    box = scene.object("box")
    (link,) = box.links
    assert scene.gravity == pytest.approx([0, 0, -9.81])
    assert box.X_WO.p == pytest.approx([0.1, -0.3, 0.2])
    c, s = math.cos(math.radians(30)), math.sin(math.radians(30))
    up = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    assert box.X_WO.rotation == pytest.approx(up @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]]), abs=1e-8)
    assert link.mass == pytest.approx(0.5)
    assert link.com == pytest.approx([0.02, 0.04, 0.06])
    assert np.diag(link.inertia) == pytest.approx(np.array([5, 6, 7]) * 1e-4)
    geometry = link.colliders[0].geometry
    assert isinstance(geometry, Box) and geometry.size == pytest.approx([0.04, 0.08, 0.12])


def test_a_static_capsule_lies_along_its_axis(importing: Importing) -> None:
    _, scene = importing("s.usda", CENTIMETERS)
    rod = scene.object("rod")
    collider = rod.links[0].colliders[0]
    assert rod.fixed and collider.geometry == Capsule(0.05, 0.4)
    assert abs((rod.X_WO @ collider.X_LG).rotation[:, 2]) == pytest.approx([1, 0, 0], abs=1e-8)


HINGED = """#usda 1.0
( defaultPrim = "Door"; metersPerUnit = 1; upAxis = "Z" )
def Xform "Door" ( prepend apiSchemas = ["PhysicsArticulationRootAPI"] ) {{
  def Xform "Frame" ( prepend apiSchemas = ["PhysicsRigidBodyAPI"] ) {{
    double3 xformOp:translate = (0, 0, 1)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Cube "A" ( prepend apiSchemas = ["PhysicsCollisionAPI"] ) {{
      double size = 0.1
    }}
  }}
  def Xform "Leaf" ( prepend apiSchemas = ["PhysicsRigidBodyAPI"] ) {{
    double3 xformOp:translate = (0.3, 0, 1)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Cube "B" ( prepend apiSchemas = ["PhysicsCollisionAPI"] ) {{
      double size = 0.2
    }}
  }}
  def PhysicsFixedJoint "Ground" {{
    rel physics:body1 = </Door/Frame>
    point3f physics:localPos0 = (0, 0, 1)
  }}
  def PhysicsRevoluteJoint "Hinge" {{
    rel physics:body0 = <{body0}>
    rel physics:body1 = <{body1}>
    uniform token physics:axis = "Z"
    point3f physics:localPos0 = {pos0}
    point3f physics:localPos1 = {pos1}
    float physics:lowerLimit = -10
    float physics:upperLimit = 100
  }}
}}
"""
FORWARD = HINGED.format(body0="/Door/Frame", body1="/Door/Leaf", pos0=(0.1, 0, 0), pos1=(-0.2, 0, 0))
BACKWARD = HINGED.format(body0="/Door/Leaf", body1="/Door/Frame", pos0=(-0.2, 0, 0), pos1=(0.1, 0, 0))


@pytest.mark.parametrize(("text", "turn"), [(FORWARD, 1), (BACKWARD, -1)], ids=["forward", "backward"])
def test_a_hinge_turns_the_same_way_however_it_is_written(importing: Importing, text: str, turn: int) -> None:
    _, scene = importing("s.usda", text)
    (door,) = scene.objects
    (hinge,) = door.joints
    assert (door.name, door.fixed, hinge.type) == ("door", True, JointType.REVOLUTE)
    assert hinge.limits == pytest.approx(np.radians([-10, 100]))
    assert (hinge.parent, hinge.child) == ("frame", "leaf")
    opened = link_poses(door, {"hinge": math.pi / 2})["leaf"]
    leaf = next(link for link in door.links if link.name == "leaf")
    center = (door.X_WO @ opened).apply(leaf.colliders[0].X_LG.p)
    assert center == pytest.approx([0.1, 0.2 * turn, 1], abs=1e-8)


def test_without_a_mass_the_density_of_usd_is_taken(importing: Importing) -> None:
    report, scene = importing("s.usda", FORWARD)
    assert [link.mass for link in scene.objects[0].links] == pytest.approx([1.0, 8.0])
    assert sum(n.what.startswith("mass of") for n in report.notes) == 2


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("no usd at all", "OpenUSD rejects the file"),
        ('#usda 1.0\ndef Xform "a" {\n float \udcc2 = 1\n}\n', "OpenUSD rejects the file"),
        (
            '#usda 1.0\ndef Cube "a" {\n double3 xformOp:translate = (0, nan, 0)\n'
            ' uniform token[] xformOpOrder = ["xformOp:translate"]\n}\n',
            "the transform of `/a` has non-finite numbers",
        ),
        (
            '#usda 1.0\ndef Cube "a" {\n double size = inf\n}\n',
            "which is invalid in a document: Input should be a finite",
        ),
        (
            FORWARD.replace(
                "point3f physics:localPos1", "quatf physics:localRot1 = (0.2, inf, 1, 0)\n point3f physics:localPos1"
            ),
            "a frame of `/Door/Hinge` has non-finite numbers",
        ),
        (
            CENTIMETERS.replace(
                "float3 physics:diag", "quatf physics:principalAxes = (nan, 0, 0, 0)\n float3 physics:diag"
            ),
            "a frame of `/World/Box` has non-finite numbers",
        ),
        ('#usda 1.0\ndef Xform "a" {}\n', "the stage has no geometry"),
        ('#usda 1.0\ndef Xform "a" (references = @./none.usda@) {}\n', "the stage has no geometry: .*none.usda"),
    ],
)
def test_what_cannot_be_read_is_refused_with_its_reason(importing: Importing, text: str, reason: str) -> None:
    with pytest.raises(ImportRefusedError, match=reason):
        importing("s.usda", text)
