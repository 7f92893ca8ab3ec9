"""Every build of ``specs/`` before the validators of others: ``python -m tests.corpora.validators``.

- USD's own (``UsdValidation``, all that are registered) on each stage and on each object of OmniGibson.
- NVIDIA's asset validator on the same files, but with each robot once, all other stages without theirs, and objects that
  are the same in many scenes once. It warns of the robots' own meshes. It is found as ``omni_asset_validate`` on the path
  or by ``SIMFOUNDRY_OMNI``.
- ``check_urdf`` on each URDF. Capsules and ball joints, which only PyBullet knows, are other words to it.
- MuJoCo: no warning on loading and in one second of steps.

Names of scenes choose which; all by default. Robots are those of ``SIMFOUNDRY_ROBOTS``; without it scenes are compiled
without them. Prints a table with the errors of each file set; exit code 1 on an error, or where a validator is missing.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

from simfoundry.scene.lower import lower_file
from simfoundry.targets.compile import compile_target
from simfoundry.targets.find import find_target
from tests.specs.documents import SCENES, SPECS, name_of
from tests.targets.everything import LIGHTS, write_everything

TARGETS = ("usd", "isaaclab", "omnigibson", "urdf", "pybullet", "mjcf", "mjx")
ALONE = "usd_without_robots"
"""Where the stage without its robots goes, which the asset validator sees of every scene."""

DESK = SPECS / "captures" / "desk" / "desk.scene.yaml"
OMNI = "SIMFOUNDRY_OMNI"
INSTALL = {
    "omni_asset_validate": "python -m venv omni && omni/bin/pip install omniverse-asset-validator usd-core, "
    f"then {OMNI}=omni/bin/omni_asset_validate",
    "check_urdf": "apt install liburdfdom-tools",
}
FATAL = ("ERROR", "FAILURE")
BULLET_ONLY = {"<capsule": "<cylinder", 'type="spherical"': 'type="fixed"'}
"""Words that only PyBullet knows, and what stands for them while ``check_urdf`` looks at the rest."""

Validator = Callable[[Path], list[str]]


def main() -> int:
    """Print the table."""
    tools = {"omni_asset_validate": os.environ.get(OMNI) or shutil.which("omni_asset_validate")}
    tools["check_urdf"] = shutil.which("check_urdf")
    for name in (name for name, place in tools.items() if place is None):
        print(f"{name} is not here: {INSTALL[name]}")
    omni, checker = tools["omni_asset_validate"], tools["check_urdf"]
    validators: dict[str, tuple[Validator | None, str]] = {
        "UsdValidation": (usd_errors, ".usda"),
        "asset validator": (None if omni is None else lambda file: omni_errors(omni, file), ".usda"),
        "check_urdf": (None if checker is None else lambda file: urdf_errors(checker, file), ".urdf"),
        "MuJoCo": (mujoco_warnings, ".xml"),
    }
    print(f"{'scene':<18}" + "".join(f"{name + ' (files)':>24}" for name in validators))
    failures: list[str] = []
    seen: set[tuple[str, ...] | bytes] = set()
    with tempfile.TemporaryDirectory() as folder:
        for path in (write_everything(Path(folder), *LIGHTS, "background_mesh"), DESK, *SCENES):
            if sys.argv[1:] and name_of(path) not in sys.argv[1:]:
                continue
            with tempfile.TemporaryDirectory() as build:
                robots = built(path, Path(build))
                heavy = bool(robots) and robots in seen
                seen.add(robots)
                cells = []
                for name, (validator, suffix) in validators.items():
                    files = sorted(file for file in Path(build).rglob(f"*{suffix}") if is_ours(file, Path(build)))
                    if name == "asset validator":
                        files = [file for file in files if not (robots and file.name == "environment.usda")]
                        files = [file for file in files if not (heavy and file.parent.name == "usd")]
                        files = [file for file in files if file.read_bytes() not in seen]
                        seen |= {file.read_bytes() for file in files if file.parent.name == "objects"}
                    cells.append(_run(validator, files, Path(build), failures, f"{name_of(path)}: {name}"))
            print(f"{name_of(path):<18}" + "".join(f"{cell:>24}" for cell in cells), flush=True)
    print("\n".join(failures) or "no error")
    return 1 if failures or None in tools.values() else 0


def _run(validator: Validator | None, files: Iterable[Path], build: Path, failures: list[str], what: str) -> str:
    if validator is None:
        return "not here"
    found = [f"{what}: {file.relative_to(build)}: {error}" for file in files for error in validator(file)]
    failures += found
    print("".join(f"{line}\n" for line in found), end="", file=sys.stderr, flush=True)
    return f"{len(found)} ({len(list(files))})"


def built(path: Path, folder: Path) -> tuple[str, ...]:
    """Compile a scene for all targets; returns the robots that were compiled with it, by the files of their models."""
    scene = lower_file(path)
    for name in TARGETS:
        compile_target(scene, find_target(name)).write(folder / name)
    if scene.robots:
        bare = replace(scene, robots=(), mounted=())
        compile_target(bare, find_target("usd")).write(folder / ALONE)
    return tuple(sorted({str(model.file) for robot in scene.robots for model in robot.models.values()}))


def is_ours(file: Path, build: Path) -> bool:
    """Whether a file was written, and not copied with the model of a robot; of MJCF the scene only."""
    inside = file.relative_to(build).parts[1:]
    return "robots" not in inside and (file.suffix != ".xml" or file.name == "scene.xml")


def usd_errors(file: Path) -> list[str]:
    """What all registered validators of USD say of a stage."""
    from pxr import Usd, UsdValidation

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(validators).Validate(Usd.Stage.Open(str(file)))
    return [str(error.GetErrorAsString()) for error in errors]


def omni_errors(tool: str, file: Path) -> list[str]:
    """Errors and failures that NVIDIA's asset validator finds; its warnings are not among them."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        # A Python path that is ours would give it another USD than its own.
        environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
        command = [tool, "--json-output", str(report), str(file)]
        done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
        if not report.is_file():
            return [f"it ends with {done.returncode}: {done.stderr[-300:]}"]
        said = json.loads(report.read_text(encoding="utf-8"))
    if said["status"] != "PASS" and not said["rules"]:  # so it answers for a file that it cannot open
        return [f"it could not read the file: {done.stderr[-300:]}"]
    issues = [issue for rule in said["rules"] for issue in rule["issues"]]
    return [f"{i['rule']['name']}: {i['message']}" for i in issues if i["severity"] in FATAL]


def urdf_errors(tool: str, file: Path) -> list[str]:
    """What ``check_urdf`` says against a URDF; a file for PyBullet is read in words that all readers know."""
    text = file.read_text(encoding="utf-8")
    if file.parent.name == "pybullet":
        for word, known in BULLET_ONLY.items():
            text = text.replace(word, known)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / file.name
        copy.write_text(text, encoding="utf-8")
        done = subprocess.run([tool, str(copy)], capture_output=True, text=True, check=False)
    said = [line.strip() for line in (done.stdout + done.stderr).splitlines()]
    bad = [line for line in said if line.lower().startswith(("error", "warning"))]
    return bad + ([f"exit code {done.returncode}"] if done.returncode else [])


def mujoco_warnings(file: Path) -> list[str]:
    """What MuJoCo warns of when it loads a file and steps it for one second from its keyframe."""
    import mujoco

    said: list[str] = []
    mujoco.set_mju_user_warning(said.append)
    try:
        model = mujoco.MjModel.from_xml_path(str(file))
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        for _ in range(round(1 / model.opt.timestep)):
            mujoco.mj_step(model, data)
    finally:
        mujoco.set_mju_user_warning(None)
    counted = [f"{mujoco.mjtWarning(k).name} {w.number} times" for k, w in enumerate(data.warning) if w.number]
    return said + counted


if __name__ == "__main__":
    sys.exit(main())
