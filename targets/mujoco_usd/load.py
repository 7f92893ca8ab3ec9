"""Load this world into MuJoCo 4, whose decoder reads USD.

``load()`` returns a model and its data in the initial state, and ``python load.py`` takes a few steps and prints a
summary:

    model, data = load()
    mujoco.mj_step(model, data)

``mujoco.MjSpec.from_file("scene.usda")`` reads the same bodies and joints. It reads neither drives, initial positions,
ball joints nor the friction of surfaces, and releases fixed objects with joints, so this loader adds them.

The decoder is an optional dependency: ``pip install 'mujoco[usd]>=4'``.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import mujoco
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade

SCENE = Path(__file__).resolve().parent / "scene.usda"
RIGID = ([0.004, 1.0], [0.99, 0.999, 0.001])
"""Constraint parameters of mimic joints; the time constant is two time steps, which is the smallest stable value."""


def load(scene: Path = SCENE) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return the model and its data, in the initial state of the scene."""
    stage = open_stage(scene)
    spec = decode(stage, scene)
    set_options(spec)
    set_surfaces(spec, stage)
    set_joints(spec, stage)
    for body in spec.bodies[1:]:
        body.gravcomp = number(stage.GetPrimAtPath(body.name), "mjc:gravcomp")
    set_names(spec, stage)
    model = spec.compile()
    set_leaders(model)
    data = mujoco.MjData(model)
    set_state(model, data, stage)
    mujoco.mj_forward(model, data)
    return model, data


def open_stage(scene: Path = SCENE) -> Usd.Stage:
    """Open the stage, and change in its session layer what the decoder does not support.

    It skips ball joints, which therefore become hinges until :func:`set_joints` changes them back. It has no bodies for
    static links, which therefore become rigid bodies that are welded to the world.
    """
    stage = Usd.Stage.Open(str(scene))
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        for prim in [prim for prim in stage.Traverse() if prim.GetTypeName() == "PhysicsSphericalJoint"]:
            prim.CreateAttribute("simfoundry:type", Sdf.ValueTypeNames.Token).Set("ball")
            prim.SetTypeName("PhysicsRevoluteJoint")
        for path in link_names(stage):
            link = stage.GetPrimAtPath(path)
            if not link.HasAPI(UsdPhysics.RigidBodyAPI):
                UsdPhysics.RigidBodyAPI.Apply(link)
                UsdPhysics.MassAPI.Apply(link)
                weld = UsdPhysics.FixedJoint.Define(stage, f"{path}/Weld")
                weld.CreateBody1Rel().SetTargets([path])
    return stage


def decode(stage: Usd.Stage, scene: Path) -> mujoco.MjSpec:
    """Return what MuJoCo reads of a stage and its session layer."""
    with tempfile.TemporaryDirectory() as folder:
        changed = Sdf.Layer.CreateNew(str(Path(folder) / "scene.usda"))
        changed.TransferContent(stage.GetSessionLayer())
        changed.subLayerPaths.append(str(scene))
        for key in ("metersPerUnit", "upAxis", "kilogramsPerUnit"):
            changed.pseudoRoot.SetInfo(key, stage.GetRootLayer().pseudoRoot.GetInfo(key))
        changed.defaultPrim = stage.GetRootLayer().defaultPrim
        changed.Save()
        return mujoco.MjSpec.from_file(changed.realPath)


def set_options(spec: mujoco.MjSpec) -> None:
    """Set the solver options with which objects do not slip below the friction angle."""
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10.0
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    if mujoco.__version__ == "4.0.0":  # its sparse factorization of the Hessian is wrong (google-deepmind/mujoco#3767)
        spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE


def set_surfaces(spec: mujoco.MjSpec, stage: Usd.Stage) -> None:
    """Set each geom's own coefficients. The stage contains square roots for PhysX, which the decoder does not read."""
    for geom in spec.geoms:
        material, _ = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath(geom.name)).ComputeBoundMaterial("physics")
        if material and material.GetPrim().HasAttribute("simfoundry:friction"):
            names = ("simfoundry:friction", "newton:torsionalFriction", "newton:rollingFriction")
            sliding, spinning, rolling = (number(material.GetPrim(), name) for name in names)
            geom.friction = [sliding, spinning, rolling]
            geom.condim = 6 if rolling else 4 if spinning else 3


def set_joints(spec: mujoco.MjSpec, stage: Usd.Stage) -> None:
    """Set the reference positions, ball joints and motors. Bodies in the stage are at their initial positions."""
    for joint in list(spec.joints):
        if joint.type == mujoco.mjtJoint.mjJNT_FREE:
            if not stage.GetPrimAtPath(joint.parent.name).HasAPI(UsdPhysics.RigidBodyAPI):
                spec.delete(joint)  # the prim of a fixed object, which the decoder has released
            continue
        prim = stage.GetPrimAtPath(joint.name)
        if prim.GetAttribute("simfoundry:type").Get() == "ball":
            joint.type = mujoco.mjtJoint.mjJNT_BALL
            joint.parent.quat = wxyz(zero_rotation(prim))  # set_state turns the joint to its initial rotation
            continue
        kind, unit = token_and_unit(prim)
        joint.ref = number(prim, f"state:{kind}:physics:position") * (1.0 if spec.compiler.degree else unit)
        drive = UsdPhysics.DriveAPI.Get(prim, kind)
        if drive:
            add_motor(spec, joint.name, drive, unit)


def add_motor(spec: mujoco.MjSpec, joint: str, drive: UsdPhysics.DriveAPI, unit: float) -> None:
    """Add an actuator that pulls a joint toward the drive's target, which :func:`set_state` sets as its control."""
    stiffness, damping = (float(gain.Get()) / unit for gain in (drive.GetStiffnessAttr(), drive.GetDampingAttr()))
    motor = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    motor.gaintype, motor.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
    motor.gainprm[0] = stiffness
    motor.biasprm[:3] = [0.0, -stiffness, -damping]
    limit = float(drive.GetMaxForceAttr().Get())
    if math.isfinite(limit):
        motor.forcelimited, motor.forcerange = mujoco.mjtLimited.mjLIMITED_TRUE, [-limit, limit]


def set_leaders(model: mujoco.MjModel) -> None:
    """Correct the offsets of mimic joints, because MuJoCo applies them to deviations from the reference positions."""
    for k in range(model.neq):
        if model.eq_type[k] == mujoco.mjtEq.mjEQ_JOINT and model.eq_obj2id[k] >= 0:
            follower, leader = (model.qpos0[model.jnt_qposadr[ids[k]]] for ids in (model.eq_obj1id, model.eq_obj2id))
            model.eq_data[k][0] += model.eq_data[k][1] * leader - follower


def set_state(model: mujoco.MjModel, data: mujoco.MjData, stage: Usd.Stage) -> None:
    """Set the controls to the targets of the drives, and the rotations of ball joints.

    All other joints already are at their initial positions.
    """
    prims = {joint_name(prim): prim for prim in stage.Traverse() if prim.IsA(UsdPhysics.Joint)}
    for k in range(model.nu):
        prim = prims[model.actuator(k).name]
        kind, unit = (
            ("linear", 1.0) if prim.GetTypeName() == "PhysicsPrismaticJoint" else ("angular", math.radians(1.0))
        )
        data.ctrl[k] = float(UsdPhysics.DriveAPI(prim, kind).GetTargetPositionAttr().Get()) * unit
    cache = UsdGeom.XformCache()
    for k in range(model.njnt):
        if model.jnt_type[k] == mujoco.mjtJoint.mjJNT_BALL:
            prim, at = prims[model.joint(k).name], int(model.jnt_qposadr[k])
            ends = (stage.GetPrimAtPath(ref.GetTargets()[0]) for ref in body_relations(prim))
            parent, child = (cache.GetLocalToWorldTransform(end).ExtractRotationQuat() for end in ends)
            data.qpos[at : at + 4] = wxyz(zero_rotation(prim).GetInverse() * parent.GetInverse() * child)


def token_and_unit(joint: Usd.Prim) -> tuple[str, float]:
    """Return the name of a joint's axis in schemas, and the unit of its positions in the stage [m or rad]."""
    return ("linear", 1.0) if joint.GetTypeName() == "PhysicsPrismaticJoint" else ("angular", math.radians(1.0))


def body_relations(joint: Usd.Prim) -> tuple[Usd.Relationship, Usd.Relationship]:
    """Return the relationships to the parent and the child of a joint."""
    return UsdPhysics.Joint(joint).GetBody0Rel(), UsdPhysics.Joint(joint).GetBody1Rel()


def zero_rotation(joint: Usd.Prim) -> Gf.Quatd:
    """Return the rotation of a joint's child in the frame of its parent at joint position zero."""
    parent, child = UsdPhysics.Joint(joint).GetLocalRot0Attr(), UsdPhysics.Joint(joint).GetLocalRot1Attr()
    return Gf.Quatd(parent.Get()) * Gf.Quatd(child.Get()).GetInverse()


def wxyz(q: Gf.Quatd) -> list[float]:
    """Return the components of a quaternion in MuJoCo's order."""
    return [q.GetReal(), *q.GetImaginary()]


def set_names(spec: mujoco.MjSpec, stage: Usd.Stage) -> None:
    """Give bodies, joints, geoms and actuators their names in the scene instead of their paths in the stage.

    The prim of a fixed object with joints, which contains its links, keeps its path.
    """
    bodies, joints = link_names(stage), {}
    for body in spec.bodies:
        body.name = bodies.get(body.name, body.name)
    for joint in spec.joints:
        prim = stage.GetPrimAtPath(joint.name) if joint.name else None
        joints[joint.name] = name = joint_name(prim) if prim else joint.parent.name  # the root of a free object
        joint.name = name
    for geom in spec.geoms:
        path, _, name = geom.name.rpartition("/")
        link, _, kind = path.rpartition("/")
        geom.name = f"{bodies.get(link, link)}{'.' if kind == 'Colliders' else ':'}{name}"
    for pair in spec.excludes:  # a static link is represented by its colliders
        paths = (name.partition("/Colliders/")[0] for name in (pair.bodyname1, pair.bodyname2))
        pair.bodyname1, pair.bodyname2 = (bodies.get(path, path) for path in paths)
    for equality in spec.equalities:
        equality.name1, equality.name2 = (joints.get(name, name) for name in (equality.name1, equality.name2))
        equality.name = equality.name1
        equality.solref[:], equality.solimp[:3] = RIGID
    for motor in spec.actuators:
        motor.name = motor.target = joints[motor.target]


def link_names(stage: Usd.Stage) -> dict[str, str]:
    """Return the names of all links by their paths: ``object.link``, or ``object`` for its first link.

    Robots that are references to their own files keep their own names.
    """
    found = {}
    for scope in filter(None, map(stage.GetPrimAtPath, ("/World/Objects", "/World/Robots"))):
        for item in (item for item in scope.GetChildren() if not item.GetChild("Model")):
            links = [prim for prim in item.GetChildren() if prim.GetTypeName() == "Xform"]
            for k, link in enumerate(links):
                found[str(link.GetPath())] = f"{item.GetName()}.{link.GetName()}" if k else item.GetName()
    return found


def joint_name(prim: Usd.Prim) -> str:
    """Return the name of a joint, ``object.joint``, or its path in a robot that keeps its own names."""
    scope = prim.GetPath().GetParentPath()
    if scope.name != "Joints":
        return str(prim.GetPath())
    return f"{scope.GetParentPath().name}.{prim.GetName()}"


def number(prim: Usd.Prim, name: str) -> float:
    """Return the value of an attribute, or 0 if it has none."""
    value = prim.GetAttribute(name).Get()
    return 0.0 if value is None else float(value)


def main() -> None:
    """Load the world, take a few steps, and print a summary."""
    model, data = load()
    for _ in range(50):
        mujoco.mj_step(model, data)
    print(f"loaded {SCENE}: {model.nbody - 1} bodies, {model.njnt} joints, {model.ngeom} geoms")


if __name__ == "__main__":
    main()
