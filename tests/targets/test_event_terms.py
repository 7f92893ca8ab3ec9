"""Random values as event terms of Isaac Lab: the signatures of the real functions, the ranges, and every loss."""

from __future__ import annotations

import importlib.util
import json
import math
import re
import shutil
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tests.cli.command import Done, run
from tests.conftest import REPOSITORY

# Names of functions and parameters in Isaac Lab's source, which was read but cannot run here.
RECORDED: dict[str, Any] = json.loads((Path(__file__).parent / "recorded" / "isaaclab_events.json").read_text())

SCENE = """\
simfoundry: scene/1
name: cell
gravity: [0, 0, -9.81]
materials:
  steel: {density: 7800, friction: 0.36, restitution: 0.25}
objects:
  desk: {fixed: true, shape: {box: [1, 1, 0.04]}, material: steel, pose: {xyz: [0, 0, -0.02]}}
  can: {shape: {cylinder: {radius: 0.03, height: 0.1}}, material: steel, mass: {value: 0.3, range: [0.2, 0.5]},
        place: {on: desk, xy: [0.2, 0]}}
  brick: {shape: {box: [0.08, 0.04, 0.03]}, friction: 0.64, mass: 0.4, place: {on: desk, xy: [-0.2, 0]}}
  tray: {shape: {box: [0.1, 0.1, 0.01]}, mass: 0.2, pose: {xyz: [0, 0.3, 0.2], rpy_deg: [40, 0, 0]}}
  cabinet: {asset: cabinet.asset.yaml, fixed: true, pose: {xyz: [0.3, 0.3, 0]}}
  flap: {asset: flap.asset.yaml, fixed: true, pose: {xyz: [-0.3, 0.3, 0]}}
lights: {key: {type: distant, intensity: 1, direction: [0, 0, -1]}}
cameras: {eye: {size: [64, 48], fx: 60, fy: 60, pose: {xyz: [1, 0, 1], look_at: [0, 0, 0]}}}
"""

FLAP = """\
simfoundry: asset/1
name: flap
category: box
links:
  base: {parts: {box: {shape: {box: [0.1, 0.1, 0.05]}}}, mass: 1}
  lid: {parts: {board: {shape: {box: [0.1, 0.1, 0.01]}}}, mass: 0.1}
joints:
  hinge: {type: revolute, parent: base, child: lid, axis: [1, 0, 0], limits_deg: [0, 90], armature: 0.01, friction: 0.1,
          pose: {xyz: [0, 0, 0.04]}}
"""

VARY = """\
object.can.mass: {range: estimate}
object.brick.mass: {times: [0.5, 2]}
object.tray.mass: {normal: 0.02}
object.flap.mass: {times: [0.9, 1.1]}
material.steel.friction: {times: [0.25, 1]}
object.brick.friction: {uniform: [0.16, 0.81]}
object.brick.restitution: {uniform: [0.04, 0.09], together: bounce}
object.tray.friction: {choose: [0.5, 0.6]}
object.can.pose: {shift: [0.02, 0.03, 0], yaw_deg: 90}
object.brick.height: {shift: [0.01, 0.02]}
object.tray.pose: {shift: 0.01, turn_deg: 10}
object.desk.height: {shift: 0.02}
cabinet.drawer: {uniform: [0.02, 0.1]}
cabinet.bottom_drawer: {uniform: [0, 0.05]}
flap.hinge.deg: {uniform: [10, 30]}
flap.hinge.armature: {log_uniform: [0.005, 0.02]}
flap.hinge.friction: {times: [0.5, 2]}
cabinet.drawer.damping: {times: [0.5, 2]}
cabinet.drawer.friction: {uniform: [0, 1]}
gravity: {times: [0.9, 1.1]}
light.key.intensity: {uniform: [0, 1]}
camera.eye.fx: {times: [0.9, 1.1]}
object.brick.color: {choose: [red, blue]}
background: {choose: [room.obj]}
options.timestep: {choose: [0.001]}
"""


@dataclass
class Compiled:
    """What the compilation of a recipe wrote."""

    folder: Path
    done: Done
    terms: dict[str, Any] = field(default_factory=dict)
    losses: dict[str, list[dict[str, Any]]] = field(default_factory=dict)


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Compiled:
    folder = tmp_path_factory.mktemp("events")
    (folder / "simfoundry.yaml").write_text("")
    (folder / "cell.scene.yaml").write_text(SCENE)
    (folder / "flap.asset.yaml").write_text(FLAP)
    (folder / "room.obj").write_text("v -3 -3 -1\nv 3 -3 -1\nv 3 3 -1\nv 0 3 2\nf 1 2 3\nf 1 3 4\n")
    shutil.copy(REPOSITORY / "specs" / "assets" / "cabinet.asset.yaml", folder)
    vary = "".join(f"  {line}\n" for line in VARY.splitlines())
    recipe = folder / "cells.cousins.yaml"
    more = "distractors: {count: [0, 1]}\n"
    recipe.write_text(f"simfoundry: cousins/1\nname: cells\ntwin: cell.scene.yaml\nvary:\n{vary}{more}")
    done = run("compile", recipe, "-t", "isaaclab", "-t", "mjcf", "-t", "newton", "-o", folder / "build", "--json")
    found = Compiled(folder / "build" / "isaaclab", done)
    found.terms = json.loads((found.folder / "events.json").read_text())["terms"]
    for target, entry in json.loads((folder / "build" / "loss.json").read_text()).items():
        found.losses[target] = [loss for loss in entry["losses"] if loss["feature"] == "vary"]
    return found


def test_terms_fit_the_signatures_of_the_real_functions(compiled: Compiled) -> None:
    used = set()
    for name, term in compiled.terms.items():
        known = RECORDED["parameters"][term["func"]]
        given = {*term["params"], *(["asset_cfg"] if term["asset"] else [])}
        assert set(known["required"]) <= given <= {*known["required"], *known["optional"]}, name
        assert term["mode"] in RECORDED["modes"] and set(term["asset"]) <= set(RECORDED["scene_entity"])
        for key in ("operation", "distribution"):
            assert term["params"].get(key, "add") in [*RECORDED["choices"][key], "add"]
        assert set(term["params"].get("pose_range", {})) <= set(RECORDED["choices"]["pose_range"])
        used.add(term["func"])
    assert used == set(RECORDED["parameters"])  # the recipe above uses all of them


def params(compiled: Compiled, name: str) -> dict[str, Any]:
    found: dict[str, Any] = compiled.terms[name]["params"]
    return found


def test_the_ranges_are_those_of_the_recipe(compiled: Compiled) -> None:
    can, brick = params(compiled, "can_mass"), params(compiled, "brick_mass")
    assert (can["mass_distribution_params"], can["operation"]) == ([0.2, 0.5], "abs")
    assert (brick["mass_distribution_params"], brick["operation"]) == ([0.5, 2.0], "scale")
    tray = params(compiled, "tray_mass")
    assert (tray["mass_distribution_params"], tray["distribution"], tray["operation"]) == ([0, 0.02], "gaussian", "add")
    # The stage contains square roots: 0.36 * [0.25, 1] and a restitution of 0.25.
    steel = params(compiled, "can_material")
    assert steel["static_friction_range"] == steel["dynamic_friction_range"] == pytest.approx([0.3, 0.6])
    assert steel["restitution_range"] == pytest.approx([0.5, 0.5])
    own = params(compiled, "brick_material")
    assert own["static_friction_range"] == pytest.approx([0.4, 0.9])
    assert own["restitution_range"] == pytest.approx([0.2, 0.3])
    assert params(compiled, "can_pose")["pose_range"] == {
        "x": [-0.02, 0.02], "y": [-0.03, 0.03], "yaw": pytest.approx([-math.pi / 2, math.pi / 2])
    }  # fmt: skip
    assert params(compiled, "brick_pose")["pose_range"] == {"z": [0.01, 0.02]}
    assert params(compiled, "cabinet_joints")["position_range"] == {"drawer": [0.02, 0.1], "bottom_drawer": [0, 0.05]}
    assert params(compiled, "flap_joints")["position_range"] == pytest.approx([math.radians(10), math.radians(30)])
    assert compiled.terms["flap_hinge_armature"]["asset"] == {"name": "flap", "joint_names": ["hinge"]}
    assert params(compiled, "gravity")["gravity_distribution_params"] == [[0.9] * 3, [1.1] * 3]
    assert compiled.terms["gravity"]["asset"] == {}


def test_whatever_is_not_written_is_a_stated_loss(compiled: Compiled) -> None:
    entries = [line.partition(":")[0] for line in VARY.splitlines()] + ["distractors"]
    lost = {loss["path"]: loss for loss in compiled.losses["isaaclab"]}
    dropped = {path for path, loss in lost.items() if loss["fidelity"] == "dropped"}
    assert dropped == {
        "object.tray.friction", "object.desk.height", "cabinet.drawer.damping", "cabinet.drawer.friction",
        "light.key.intensity", "camera.eye.fx", "object.brick.color", "background", "options.timestep", "distractors",
    }  # fmt: skip
    assert "does not check that" not in lost["vary"]["reason"] and "settles" in lost["vary"]["reason"]
    reasons = {(loss["path"], loss["reason"]) for loss in compiled.losses["isaaclab"]}
    assert ("object.tray.pose", "Roll, pitch and yaw are drawn separately.") in reasons
    assert ("object.tray.pose", "A shift in a ball becomes one in a box.") in reasons
    assert ("object.flap.mass", "Each of the 2 links is drawn by itself.") in reasons
    assert any(path == "object.brick.restitution" and "by itself" in reason for path, reason in reasons)
    assert any(path == "material.steel.friction" and "desk" in reason for path, reason in reasons)
    for target in ("mjcf", "newton"):
        assert {loss["path"] for loss in compiled.losses[target]} == set(entries)
        assert {loss["fidelity"] for loss in compiled.losses[target]} == {"dropped"}
    assert compiled.done.code == 0 and not (compiled.folder.parent / "mjcf" / "events.json").exists()


def _isaaclab() -> dict[str, ModuleType]:
    """Modules with the recorded functions, whose calls check the parameters as Isaac Lab's managers do."""
    mdp, managers, utils = (ModuleType(f"isaaclab.{name}") for name in ("envs.mdp", "managers", "utils"))
    for name in RECORDED["parameters"]:
        setattr(mdp, name, type(name, (), {}) if name in RECORDED["classes"] else (lambda env, env_ids, **_: None))
        getattr(mdp, name).__name__ = name

    @dataclass
    class EventTermCfg:
        func: Any
        mode: str
        params: dict[str, Any] = field(default_factory=dict)

    @dataclass
    class SceneEntityCfg:
        name: str
        joint_names: Any = None

    managers.EventTermCfg, managers.SceneEntityCfg = EventTermCfg, SceneEntityCfg  # type: ignore[attr-defined]
    utils.configclass = lambda cls: cls  # type: ignore[attr-defined]
    envs = ModuleType("isaaclab.envs")
    envs.mdp = mdp  # type: ignore[attr-defined]
    found = {"isaaclab": ModuleType("isaaclab"), "isaaclab.envs": envs, "isaaclab.envs.mdp": mdp}
    return found | {"isaaclab.managers": managers, "isaaclab.utils": utils}


def test_the_loader_builds_the_configuration(compiled: Compiled, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, module in _isaaclab().items():
        monkeypatch.setitem(sys.modules, name, module)
    spec = importlib.util.spec_from_file_location("isaaclab_load", compiled.folder / "load.py")
    assert spec is not None and spec.loader is not None
    loader = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loader)
    events = loader.events_cfg()
    assert {name for name in vars(type(events)) if not name.startswith("__")} == set(compiled.terms)
    term = events.can_mass
    assert term.func.__name__ == "randomize_rigid_body_mass" and term.mode == "startup"
    assert term.params["mass_distribution_params"] == (0.2, 0.5) and term.params["asset_cfg"].name == "can"
    assert events.cabinet_joints.params["position_range"] == {"drawer": (0.02, 0.1), "bottom_drawer": (0.0, 0.05)}
    assert events.gravity.params["gravity_distribution_params"] == ((0.9,) * 3, (1.1,) * 3)
    (compiled.folder / "events.json").rename(compiled.folder / "moved.json")
    try:
        with pytest.raises(FileNotFoundError, match=r"compile the recipe \(\*\.cousins\.yaml\) instead of its scene"):
            loader.events_cfg()
    finally:
        (compiled.folder / "moved.json").rename(compiled.folder / "events.json")


def test_recipes_without_random_values_are_refused(tmp_path: Path) -> None:
    (tmp_path / "cell.scene.yaml").write_text("simfoundry: scene/1\nname: cell\nobjects: {}\n")
    recipe = tmp_path / "cells.cousins.yaml"
    recipe.write_text("simfoundry: cousins/1\nname: cells\ntwin: cell.scene.yaml\ndistractors: {count: [0, 1]}\n")
    done = run("compile", recipe, "-t", "isaaclab", "-o", tmp_path / "build")
    assert done.code == 2 and "has no `vary`" in done.err and "Traceback" not in done.err


def test_the_command_of_the_page(tmp_path: Path) -> None:
    page = (REPOSITORY / "docs" / "cousins.md").read_text()
    section = page.partition("### Event terms of Isaac Lab")[2].partition("\n### ")[0].partition("\n## ")[0]
    words = section.partition("```\n")[2].partition("\n```")[0].split()
    done = run(*words[1:-1], tmp_path / "build")
    assert done.code == 0 and (tmp_path / "build" / "isaaclab" / "events.json").exists()
    functions = {word for word in re.findall(r"`(\w+)`", section) if word.startswith(("randomize_", "reset_"))}
    assert functions == set(RECORDED["parameters"])
