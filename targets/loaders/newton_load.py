"""Load this world into Newton: ``load()`` returns a model; ``python load.py`` takes a tenth of a second.

    model = load()
    solver = newton.solvers.SolverMuJoCo(model)

The stage has the importers of USD: ``pip install newton[importers]``.
"""

from __future__ import annotations

from pathlib import Path

import newton
from pxr import Usd, UsdPhysics

SCENE = Path(__file__).resolve().parent / "scene.usda"
TIMESTEP = 1 / 500
"""Seconds a step."""


def open_stage() -> Usd.Stage:
    """The stage, in its session layer with the surfaces' own coefficients: Newton knows no square roots under PhysX."""
    stage = Usd.Stage.Open(str(SCENE))
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        for prim in stage.GetPrimAtPath("/World/Contacts").GetChildren():
            material = UsdPhysics.MaterialAPI(prim)
            friction = prim.GetAttribute("simfoundry:friction").Get()
            material.GetStaticFrictionAttr().Set(friction)
            material.GetDynamicFrictionAttr().Set(friction)
            material.GetRestitutionAttr().Set(prim.GetAttribute("simfoundry:restitution").Get())
    return stage


def load(device: str = "cpu") -> newton.Model:
    """Return the model on a device of Warp."""
    builder = newton.ModelBuilder()
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)  # else the importer passes over friction of joints
    builder.add_usd(open_stage())
    return builder.finalize(device=device)


def main() -> None:
    """Say what was loaded, and that it steps."""
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
