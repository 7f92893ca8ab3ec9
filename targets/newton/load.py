"""Load this world into Newton.

``load()`` returns a model, and ``python load.py`` takes one step and prints a summary:

    model = load()
    solver = newton.solvers.SolverMuJoCo(model)
    state, control = model.state(), model.control()

The MJCF specifies the friction of each pair of surfaces, which USD cannot express. Newton's importer ignores the
keyframe and the direction of gravity, so this loader sets both. The initial controls hold the robots in place.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import newton
import numpy as np

SCENE = Path(__file__).resolve().parent / "scene.xml"
TIMESTEP = 1 / 500
"""Time step [s]."""


def load(device: str = "cpu", scene: Path = SCENE) -> newton.Model:
    """Return the model on a Warp device, in the state of the keyframe."""
    root = ET.parse(scene).getroot()
    builder = newton.ModelBuilder()
    builder.add_mjcf(str(scene))
    apply_keyframe(builder, floats(root.find("keyframe/key"), "qpos"), root)
    model = builder.finalize(device=device)
    model.set_gravity(tuple(floats(root.find("option"), "gravity")))
    controls = floats(root.find("keyframe/key"), "ctrl")
    if controls:  # every control() of the model starts with these values
        model.mujoco.ctrl.assign(np.array(controls, dtype=np.float32))
    return model


def several_axes(root: ET.Element) -> dict[str, list[str]]:
    """Return the joints of each body with several, keyed by Newton's label for them.

    Newton combines them into one joint, which moves along axes before it turns about axes.
    """
    groups = [body.findall("joint") for body in root.iter("body")]
    return {
        "_".join(str(joint.get("name")) for joint in group): [
            str(joint.get("name")) for joint in sorted(group, key=lambda joint: joint.get("type") != "slide")
        ]
        for group in groups
        if len(group) > 1
    }


def apply_keyframe(builder: newton.ModelBuilder, qpos: list[float], root: ET.Element) -> None:
    """Set Newton's positions from MuJoCo's, which have the same joint order but wxyz instead of xyzw quaternions."""
    groups = several_axes(root)
    written = {
        name: k for body in root.iter("body") for k, name in enumerate(j.get("name") for j in body.findall("joint"))
    }
    ends = [*builder.joint_q_start[1:], len(builder.joint_q)]
    q, at, carried = np.array(builder.joint_q, dtype=np.float64), 0, set[int]()
    for kind, label, child, start, end in zip(
        builder.joint_type, builder.joint_label, builder.joint_child, builder.joint_q_start, ends, strict=True
    ):
        if child in carried:  # a second joint of the body, which closes a loop and is an equality in MuJoCo
            continue
        carried.add(child)
        count = end - start
        if at + count > len(qpos):
            raise ValueError(f"the keyframe has {len(qpos)} positions, fewer than the model")
        values = np.array(qpos[at : at + count])
        at += count
        if kind == newton.JointType.FREE:
            continue
        order = [written[name] for name in groups.get(label.rpartition("/")[2], ())] or list(range(count))
        q[start:end] = values[[1, 2, 3, 0] if kind == newton.JointType.BALL else order]
    if at != len(qpos):
        raise ValueError(f"the keyframe has {len(qpos)} positions, but the model has {at}")
    builder.joint_q = q.tolist()


def floats(element: ET.Element | None, attribute: str) -> list[float]:
    """Return the numbers in an attribute, or an empty list if the element or attribute does not exist."""
    return [] if element is None else [float(v) for v in element.get(attribute, "").split()]


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
