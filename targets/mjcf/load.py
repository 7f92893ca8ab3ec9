"""Load this world: ``load()`` returns a MuJoCo model and its data; ``python load.py`` opens the viewer.

``load()`` makes all contacts exact, based on the current surface values in ``scene.xml``. If you change a friction, run
``python load.py --contacts`` to update ``contacts.xml`` for programs that open ``scene.xml`` directly.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from pathlib import Path
from types import ModuleType

import mujoco

HERE = Path(__file__).resolve().parent


def read_rules() -> ModuleType:
    """Import ``contact_rules.py`` from this file's folder, regardless of the working directory."""
    spec = importlib.util.spec_from_file_location("contact_rules", HERE / "contact_rules.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def load() -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return the model, and its data in the scene's initial state."""
    rules = read_rules()
    spec = rules.read_scene(HERE)
    if (HERE / rules.CONTACTS_FILE).is_file():
        rules.make_exact(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("initial").id)
    mujoco.mj_forward(model, data)
    return model, data


def write_contacts() -> None:
    """Update the contact pairs from the values in ``scene.xml``."""
    rules = read_rules()
    spec = rules.read_scene(HERE)
    text = rules.contacts_text(rules.read_geoms(spec)[0], rules.excluded_bodies(spec))
    (HERE / rules.CONTACTS_FILE).write_text(text, encoding="utf-8")
    print(f"wrote {HERE / rules.CONTACTS_FILE}")


def has_display() -> bool:
    """Return true if a window can be opened."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def main() -> None:
    """Open the viewer; without a display, print a summary."""
    if "--contacts" in sys.argv[1:]:
        write_contacts()
        return
    model, data = load()
    if has_display():
        import mujoco.viewer

        mujoco.viewer.launch(model, data)
    else:
        bodies = sum(":" not in model.body(k).name for k in range(1, model.nbody))  # excludes the bodies of proxy geoms
        print(f"loaded {HERE / 'scene.xml'}: {bodies} bodies, {model.njnt} joints")


if __name__ == "__main__":
    main()
