"""Load this world into OpenUSD.

``load()`` opens the stage in Python, and ``python load.py`` opens it in a viewer.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from pxr import Usd, UsdPhysics

SCENE = Path(__file__).resolve().parent / "scene.usda"


def load(own_friction: bool = False, own_restitution: bool = False) -> Usd.Stage:
    """Open the stage.

    Contact materials contain square roots for PhysX, which multiplies the values of two surfaces. For a simulator that
    averages the two values or uses the larger value, request the surfaces' own values. They are set in the session
    layer, so the files remain unchanged.
    """
    stage = Usd.Stage.Open(str(SCENE))
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        for prim in stage.GetPrimAtPath("/World/Contacts").GetChildren():
            material = UsdPhysics.MaterialAPI(prim)
            if own_friction:
                friction = prim.GetAttribute("simfoundry:friction").Get()
                material.GetStaticFrictionAttr().Set(friction)
                material.GetDynamicFrictionAttr().Set(friction)
            if own_restitution:
                material.GetRestitutionAttr().Set(prim.GetAttribute("simfoundry:restitution").Get())
    return stage


def main() -> None:
    """Open usdview if it is installed and there is a display. Otherwise, print a summary."""
    display = sys.platform in ("darwin", "win32") or "DISPLAY" in os.environ or "WAYLAND_DISPLAY" in os.environ
    viewer = shutil.which("usdview")
    if display and viewer:
        subprocess.run([viewer, str(SCENE)], check=True)
        return
    stage = load()
    prims = list(stage.Traverse())
    bodies = sum(prim.HasAPI(UsdPhysics.RigidBodyAPI) for prim in prims)
    joints = sum(prim.IsA(UsdPhysics.Joint) for prim in prims)
    objects, robots = (
        sum(str(prim.GetParent().GetPath()) == f"/World/{group}" for prim in prims) for group in ("Objects", "Robots")
    )
    counted = f"{objects} objects" + (f", {robots} robots" if robots else "")
    print(f"{SCENE.name}: {counted}, {bodies} rigid bodies, {joints} joints")


if __name__ == "__main__":
    main()
