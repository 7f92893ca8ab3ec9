"""Load this world into Newton.

``load()`` returns a model, and ``python load.py`` takes one step and prints a summary:

    model = load()
    solver = newton.solvers.SolverMuJoCo(model)

The USD importer is an optional dependency: ``pip install newton[importers]``.
"""

from __future__ import annotations

from pathlib import Path

import newton
from pxr import Gf, Usd, UsdGeom, UsdPhysics

SCENE = Path(__file__).resolve().parent / "scene.usda"
TIMESTEP = 1 / 500
"""Time step [s]."""


def load(device: str = "cpu", scene: Path = SCENE) -> newton.Model:
    """Return the model on a Warp device."""
    stage = open_stage(scene)
    builder = newton.ModelBuilder()
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)  # otherwise the importer ignores joint friction
    builder.add_usd(stage, schema_resolvers=[newton.usd.SchemaResolverNewton(), newton.usd.SchemaResolverMjc()])
    turn_balls(builder, stage)
    return builder.finalize(device=device)


def open_stage(scene: Path = SCENE) -> Usd.Stage:
    """Open the stage, and set the surfaces' own coefficients in its session layer.

    The stage contains square roots for PhysX's combine mode, which Newton does not support.
    """
    stage = Usd.Stage.Open(str(scene))
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        for prim in stage.GetPrimAtPath("/World/Contacts").GetChildren():
            material = UsdPhysics.MaterialAPI(prim)
            friction = prim.GetAttribute("simfoundry:friction").Get()
            material.GetStaticFrictionAttr().Set(friction)
            material.GetDynamicFrictionAttr().Set(friction)
            material.GetRestitutionAttr().Set(prim.GetAttribute("simfoundry:restitution").Get())
    return stage


def turn_balls(builder: newton.ModelBuilder, stage: Usd.Stage) -> None:
    """Set each ball joint's rotation from the poses of its two bodies, because the importer leaves it at zero."""
    cache = UsdGeom.XformCache()
    for joint, label in enumerate(builder.joint_label):
        if builder.joint_type[joint] != newton.JointType.BALL:
            continue
        prim = UsdPhysics.SphericalJoint(stage.GetPrimAtPath(label))
        frames = [
            _turned(prim.GetLocalRot0Attr(), prim.GetBody0Rel(), stage, cache),
            _turned(prim.GetLocalRot1Attr(), prim.GetBody1Rel(), stage, cache),
        ]
        rotation = frames[0].GetInverse() * frames[1]
        start = builder.joint_q_start[joint]
        builder.joint_q[start : start + 4] = [*rotation.GetImaginary(), rotation.GetReal()]


def _turned(own: Usd.Attribute, body: Usd.Relationship, stage: Usd.Stage, cache: UsdGeom.XformCache) -> Gf.Quatd:
    """Return the rotation in the world of a joint's frame, as attached to one of its bodies."""
    path = body.GetTargets()
    world = cache.GetLocalToWorldTransform(stage.GetPrimAtPath(path[0])) if path else Gf.Matrix4d(1.0)
    return world.RemoveScaleShear().ExtractRotationQuat() * Gf.Quatd(own.Get())


def main() -> None:
    """Load the world, take one step, and print a summary."""
    model = load()
    solver = newton.solvers.SolverMuJoCo(model, use_mujoco_cpu=True)
    state, following, control = model.state(), model.state(), model.control()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    for _ in range(50):
        state.clear_forces()
        solver.step(state, following, control, None, TIMESTEP)
        state, following = following, state
    print(f"loaded {SCENE}: {model.body_count} bodies, {model.joint_count} joints, {model.shape_count} shapes")


if __name__ == "__main__":
    main()
