"""Every compiled file in the program that it is for; whatever that program complains about is a finding."""

from __future__ import annotations

import sys
from pathlib import Path

from tests.corpora.realtables.commands import run

_MJCF = """
import load
model, data = load.load()
import mujoco
mujoco.mj_step(model, data, 10)
for kind, warning in enumerate(data.warning):
    if warning.number:
        print("warning:", mujoco.mjtWarning(kind), warning.number, "times")
"""

_URDF = """
import sys, pathlib, pybullet
try:
    import yourdfpy
except ImportError:
    yourdfpy = None
pybullet.connect(pybullet.DIRECT)
for file in sorted(pathlib.Path(".").glob("*.urdf")):
    pybullet.loadURDF(str(file))
    if yourdfpy is not None:
        robot = yourdfpy.URDF.load(str(file), build_collision_scene_graph=True, load_collision_meshes=True)
        if not robot.validate():
            print("warning:", file, *robot.errors)
"""

_PYBULLET = """
import pybullet
client = pybullet.connect(pybullet.DIRECT)
import load
bodies = load.load(client)
for _ in range(10):
    pybullet.stepSimulation()
"""

_USD = """
import load
stage = load.load()
for prim in stage.TraverseAll():
    prim.GetAttributes()
for path in stage.GetUsedLayers():
    path.ExportToString()
missing = [c for c in stage.GetCompositionErrors()]
if missing:
    print("warning:", *missing)
"""

_OPENERS = {"mjcf": _MJCF, "urdf": _URDF, "pybullet": _PYBULLET, "usd": _USD}
_LOADERS = ("mjcf", "pybullet", "usd")
_GREETING = "pybullet build time:"


def complaints(build: Path, env: dict[str, str], empty: Path) -> list[str]:
    """What the consumers of the four targets below ``build`` have to say; ``empty`` is an empty folder to run in."""
    found = []
    for target, opener in _OPENERS.items():
        # In the target's own folder, where MuJoCo would leave its log of warnings.
        before = {p.name for p in (build / target).iterdir()}
        found += _said(target, (sys.executable, "-B", "-c", opener), build / target, env)
        found += [f"{target}: left {p.name}" for p in (build / target).iterdir() if p.name not in before]
    for target in _LOADERS:
        command = (sys.executable, "-B", str(build / target / "load.py"))
        ran = run(command, empty, env, timeout=120)
        if ran.code != 0 or _without_greeting(ran.errors) or len(_without_greeting(ran.output)) != 1:
            found.append(f"{target}/load.py: {ran.last_words()}")
    return found + [f"load.py left {p.name}" for p in empty.iterdir()]


def validation_errors(stage_file: Path) -> list[str]:
    """What any validator that OpenUSD knows has against a stage."""
    from pxr import Usd, UsdValidation

    stage = Usd.Stage.Open(str(stage_file))
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    return [str(e.GetErrorAsString()) for e in UsdValidation.ValidationContext(validators).Validate(stage)]


def _said(target: str, command: tuple[str, ...], cwd: Path, env: dict[str, str]) -> list[str]:
    ran = run(command, cwd, env, timeout=120)
    if ran.code != 0:
        return [f"{target}: {ran.last_words()}"]
    return [f"{target}: {line}" for line in _without_greeting(ran.output + "\n" + ran.errors)]


def _without_greeting(text: str) -> list[str]:
    return [line for line in text.splitlines() if line.strip() and not line.startswith(_GREETING)]
