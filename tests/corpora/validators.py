"""Every build of ``specs/`` before the validators of others: ``python -m tests.corpora.validators``.

- The schemas before ``ajv`` (strict mode, no other option) and ``check-jsonschema``, and by both each document of
  ``specs/``. They are found on the path or by ``SIMFOUNDRY_AJV`` and ``SIMFOUNDRY_CHECK_JSONSCHEMA``. The name
  ``schemas`` alone runs only these.
- USD's own (``UsdValidation``, all that are registered) on each stage and on each object of OmniGibson.
- NVIDIA's asset validator on the same files, but with each robot once, all other stages without theirs, and what is the
  same in many builds once. It warns of the robots' own meshes. It is found as ``omni_asset_validate`` on the path or by
  ``SIMFOUNDRY_OMNI``.
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
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from simfoundry.scene.lower import lower_file
from simfoundry.spec.models.kinds import KINDS, suffix
from simfoundry.targets.compile import compile_target
from simfoundry.targets.find import find_target
from tests.specs.documents import SCENES, SPECS, name_of
from tests.targets.everything import LIGHTS, write_everything

TARGETS = ("usd", "isaaclab", "omnigibson", "urdf", "pybullet", "mjcf", "mjx")
ALONE = "usd_without_robots"
"""Where the stage without its robots goes, which the asset validator sees of every scene."""

DESK = SPECS / "captures" / "desk" / "desk.scene.yaml"
OMNI = "SIMFOUNDRY_OMNI"
AJV, CHECK_JSONSCHEMA = "SIMFOUNDRY_AJV", "SIMFOUNDRY_CHECK_JSONSCHEMA"
SCHEMAS = "schemas"
INSTALL = {
    "ajv": f"npm install ajv-cli, then {AJV}=node_modules/.bin/ajv",
    "check-jsonschema": "python -m venv check && check/bin/pip install check-jsonschema, "
    f"then {CHECK_JSONSCHEMA}=check/bin/check-jsonschema",
    "omni_asset_validate": "python -m venv omni && omni/bin/pip install omniverse-asset-validator usd-core, "
    f"then {OMNI}=omni/bin/omni_asset_validate",
    "check_urdf": "apt install liburdfdom-tools",
}
FATAL = ("ERROR", "FAILURE")
BULLET_ONLY = {"<capsule": "<cylinder", 'type="spherical"': 'type="fixed"'}
"""Words that only PyBullet knows, and what stands for them while ``check_urdf`` looks at the rest."""

Validator = Callable[[Path], list[str]]


def main() -> int:
    """Print the tables."""
    schemas = schema_failures()
    if sys.argv[1:] == [SCHEMAS]:
        return 1 if schemas else 0
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
    seen: set[tuple[str, ...] | bytes] = set()  # robots, and layers
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
                        files = _unseen(files, bool(robots), heavy, seen)
                    cells.append(_run(validator, files, Path(build), failures, f"{name_of(path)}: {name}"))
            print(f"{name_of(path):<18}" + "".join(f"{cell:>24}" for cell in cells), flush=True)
    print("\n".join(failures) or "no error")
    return 1 if schemas or failures or None in tools.values() else 0


def schema_failures() -> list[str]:
    """Print a line for each schema: what its validators say of it and of the documents of its kind; return failures."""
    ajv = os.environ.get(AJV) or shutil.which("ajv")
    checker = os.environ.get(CHECK_JSONSCHEMA) or shutil.which("check-jsonschema")
    missing = [name for name, tool in {"ajv": ajv, "check-jsonschema": checker}.items() if tool is None]
    for name in missing:
        print(f"{name} is not here: {INSTALL[name]}")
    failures = [f"{name} is not here" for name in missing]
    for kind in KINDS:
        schema = SPECS.parent / SCHEMAS / f"{kind.partition('/')[0]}.schema.json"
        name = "capture.yaml" if kind == "capture/1" else f"*{suffix(kind)}"
        documents = [str(path) for path in sorted(SPECS.rglob(name))]
        commands = []
        if ajv is not None:
            strict = ["--spec=draft2020", "--strict=true", "-s", str(schema)]
            commands.append([ajv, "compile", *strict])
            given = [word for path in documents for word in ("-d", path)]
            commands += [[ajv, "validate", *strict, *given]] if documents else []
        if checker is not None:
            commands.append([checker, "--check-metaschema", str(schema)])
            commands += [[checker, "--schemafile", str(schema), *documents]] if documents else []
        found = [said for command in commands for said in _refusal(command)]
        print(f"{schema.name:<22}{len(documents):>4} documents: {'; '.join(found) or 'no error'}", flush=True)
        failures += found
    return failures


def _refusal(command: Sequence[str]) -> list[str]:
    """What a validator says if it refuses anything or warns, in its last words."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    said = done.stderr.strip() or (done.stdout.strip() if done.returncode else "")
    return [f"{Path(command[0]).name}: {said[-300:]}"] if done.returncode or said else []


def _unseen(files: Sequence[Path], robots: bool, known: bool, seen: set[tuple[str, ...] | bytes]) -> list[Path]:
    """The stages that are unlike all before; of a scene with ``robots`` that are ``known`` only what has none."""
    out = []
    for file in files:
        stage = file.name in ("scene.usda", "environment.usda") and file.parent.name != ALONE
        if (stage and known) or (robots and file.name == "environment.usda"):
            continue
        data = file.read_bytes()
        if data not in seen or file.name == "environment.usda":  # which says nothing but which stage it is over
            out.append(file)
        seen.add(data)
    return out


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
