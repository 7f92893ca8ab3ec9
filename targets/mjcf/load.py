"""Load this world into MuJoCo.

``load()`` returns a MuJoCo model and its data, and ``python load.py`` opens the viewer.

``load()`` makes all contacts exact, based on the current surface values in ``scene.xml``. If you change a friction
coefficient, run ``python load.py --contacts`` to update ``contacts.xml`` for programs that open ``scene.xml`` directly.
"""

from __future__ import annotations

import importlib.util
import os
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from types import ModuleType

import mujoco

HERE = Path(__file__).resolve().parent
SCENE = HERE / "scene.xml"


def read_rules() -> ModuleType:
    """Import ``contact_rules.py`` from this file's folder, regardless of the working directory."""
    spec = importlib.util.spec_from_file_location("contact_rules", HERE / "contact_rules.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def load() -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return the model, along with its data in the scene's initial state."""
    rules = read_rules()
    spec = read_scene(rules)
    if is_exact(rules):
        rules.make_exact(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("initial").id)
    for start in model.jnt_qposadr[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]:
        data.qpos[start : start + 7] = model.qpos0[start : start + 7]
    mujoco.mj_forward(model, data)
    return model, data


def read_scene(rules: ModuleType) -> mujoco.MjSpec:
    """Read the specification of the scene, without its contact pairs."""
    return mujoco.MjSpec.from_file(str(SCENE), include={rules.CONTACTS_FILE: rules.EMPTY.encode()})


def is_exact(rules: ModuleType) -> bool:
    """Return true if the scene includes contact pairs. It does not if the option `contacts` is set to `native`."""
    return any(element.get("file") == rules.CONTACTS_FILE for element in ET.parse(SCENE).iter("include"))


def write_contacts() -> None:
    """Update the contact pairs from the values in ``scene.xml``."""
    rules = read_rules()
    if not is_exact(rules):
        sys.exit(
            f"{rules.CONTACTS_FILE} is not written: scene.xml does not include it, so all contacts use MuJoCo's own "
            "rule; for exact contacts, compile without the option `contacts: native`"
        )
    spec = read_scene(rules)
    geoms = rules.read_geoms(spec)[0]
    named = [geom for geom in geoms if rules.PROXY not in geom.name]
    bodies = (geom.body.partition(rules.PROXY)[0] for geom in geoms if rules.PROXY in geom.name)
    unnamed = dict.fromkeys(body or "(no name)" for body in bodies)
    (HERE / rules.CONTACTS_FILE).write_text(rules.contacts_text(named, rules.excluded_bodies(spec)), encoding="utf-8")
    print(f"wrote {HERE / rules.CONTACTS_FILE}")
    if unnamed:
        print(f"geoms without a name have no pairs; name those in the following bodies: {', '.join(unnamed)}")


def has_display() -> bool:
    """Return true if a window can be opened."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def main() -> None:
    """Open the viewer. Without a display, print a summary."""
    if "--contacts" in sys.argv[1:]:
        write_contacts()
        return
    model, data = load()
    if has_display():
        import mujoco.viewer

        mujoco.viewer.launch(model, data)
    else:
        bodies = sum(":" not in model.body(k).name for k in range(1, model.nbody))  # excludes the bodies of proxy geoms
        print(f"loaded {SCENE}: {bodies} bodies, {model.njnt} joints")


if __name__ == "__main__":
    main()
