"""D6 joints, whose free axes become the axes of one joint."""

from __future__ import annotations

import math

import pytest

from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import JointType
from tests.frontends.conftest import Importing

STAGE = """\
#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Z"
    defaultPrim = "World"
)
def Xform "World" {
  def Cube "base" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI", "PhysicsMassAPI"]) {
    double size = 0.1
    float physics:mass = 2
    bool physics:kinematicEnabled = 1
  }
  def Cube "arm" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI", "PhysicsMassAPI"]) {
    double size = 0.1
    float physics:mass = 1
    double3 xformOp:translate = (0.07, 0, 0.3)
    float3 xformOp:rotateXYZ = (20, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
  }
  def PhysicsJoint "d6" (prepend apiSchemas = ["PhysicsLimitAPI:transX", "PhysicsLimitAPI:transY",
    "PhysicsLimitAPI:transZ", "PhysicsLimitAPI:rotX", "PhysicsLimitAPI:rotY", "PhysicsLimitAPI:rotZ",
    "PhysicsDriveAPI:rotY"]) {
    rel physics:body0 = </World/base>
    rel physics:body1 = </World/arm>
    point3f physics:localPos0 = (0, 0, 0.3)
    float limit:transX:physics:low = -0.1
    float limit:transX:physics:high = 0.1
    float limit:transY:physics:low = 1
    float limit:transY:physics:high = -1
    float limit:transZ:physics:low = 1
    float limit:transZ:physics:high = -1
    float limit:rotX:physics:low = -45
    float limit:rotX:physics:high = 45
    float limit:rotY:physics:low = -30
    float limit:rotY:physics:high = 30
    float limit:rotZ:physics:low = 1
    float limit:rotZ:physics:high = -1
    float drive:rotY:physics:stiffness = 2
    float drive:rotY:physics:damping = 0.1
  }
}
"""


@pytest.mark.parametrize("is_reversed", [False, True])
def test_free_axes_of_a_d6_joint_become_axes(importing: Importing, is_reversed: bool) -> None:
    """The child is where the stage has it, whichever body comes first."""
    text = STAGE
    if is_reversed:
        text = text.replace("body0 = </World/base>", "body0 = </World/arm>")
        text = text.replace("body1 = </World/arm>", "body1 = </World/base>").replace("localPos0", "localPos1")
    report, scene = importing("d6.usda", text)
    (item,) = scene.objects
    joints = {joint.name: joint for joint in item.joints}
    names = ["d6_transx", "d6_rotx", "d6_roty"]
    assert list(joints) == (names[::-1] if is_reversed else names)
    sign = -1.0 if is_reversed else 1.0
    assert joints["d6_transx"].position == pytest.approx(0.07 * sign)
    assert joints["d6_rotx"].position == pytest.approx(math.radians(20) * sign)
    assert joints["d6_roty"].type is JointType.REVOLUTE
    assert joints["d6_roty"].limits == pytest.approx((-math.radians(30), math.radians(30)))
    assert joints["d6_roty"].drive is not None and joints["d6_roty"].drive.stiffness == pytest.approx(math.degrees(2))
    X_WA = item.X_WO @ link_poses(item)[item.links[-1].name]
    X_WG = X_WA @ item.links[-1].colliders[0].X_LG
    assert X_WG.p == pytest.approx([0.07, 0, 0.3], abs=1e-6)
    assert X_WG.rotation[:, 1] == pytest.approx([0, math.cos(math.radians(20)), math.sin(math.radians(20))], abs=1e-6)
    assert not [note for note in report.notes if note.kind == "dropped"]
