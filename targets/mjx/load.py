"""Load this world into MJX.

``load()`` returns a model and data on a JAX device, and ``python load.py`` prints a summary:

    model, data = load()
    step = jax.jit(mjx.step)
    data = step(model, data)

The first step is compiled, which can take minutes on a CPU if many geoms can collide.
"""

from __future__ import annotations

from pathlib import Path

import jax
import mujoco
from mujoco import mjx

HERE = Path(__file__).resolve().parent


def load() -> tuple[mjx.Model, mjx.Data]:
    """Return the model, along with its data in the scene's initial state."""
    model = mujoco.MjModel.from_xml_path(str(HERE / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("initial").id)
    for start in model.jnt_qposadr[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]:  # they start at the pose of the body
        data.qpos[start : start + 7] = model.qpos0[start : start + 7]
    mujoco.mj_forward(model, data)
    return mjx.put_model(model), mjx.put_data(model, data)


def main() -> None:
    """Load the world and print a summary."""
    model, _ = load()
    device = jax.devices()[0].platform
    print(
        f"loaded {HERE / 'scene.xml'} on {device}: {model.nbody - 1} bodies, {model.njnt} joints, {model.ngeom} geoms"
    )


if __name__ == "__main__":
    main()
