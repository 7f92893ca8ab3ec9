"""Load this world: ``load()`` returns a MuJoCo model and its data; ``python load.py`` opens the viewer."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import mujoco

HERE = Path(__file__).resolve().parent


def load() -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return the model, and its data in the initial state of the scene."""
    model = mujoco.MjModel.from_xml_path(str(HERE / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("initial").id)
    mujoco.mj_forward(model, data)
    return model, data


def has_display() -> bool:
    """Whether a window can open here."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def main() -> None:
    """Open the viewer, or say what was loaded where there is no display."""
    model, data = load()
    if has_display():
        import mujoco.viewer

        mujoco.viewer.launch(model, data)
    else:
        names = [model.body(k).name for k in range(1, model.nbody)]
        bodies = sum(":" not in name for name in names)  # any other says how a body touches some things
        print(f"loaded {HERE / 'scene.xml'}: {bodies} bodies, {model.njnt} joints, {model.ngeom} geoms")


if __name__ == "__main__":
    main()
