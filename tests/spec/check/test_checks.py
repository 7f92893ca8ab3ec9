"""Names in tasks, recipes, places and mounts; what `allow` silences; what a merge left."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.spec.check.documents import unused
from simfoundry.spec.diagnostics import Severity
from simfoundry.spec.load import load
from tests.foreign_package import write_package

SCENE = """\
simfoundry: scene/1
name: kitchen
viewpoint: arm
objects:
  desk: {fixed: true, shape: {box: [1.4, 0.7, 0.04]}, pose: {xyz: [0.4, 0, -0.02]}}
  cup: {shape: {cylinder: {radius: 0.04, height: 0.1}}, mass: 0.2, pose: {xyz: [0.4, 0.1, 0.05]}}
  bowl: {shape: {cylinder: {radius: 0.1, height: 0.02}}, mass: 0.4, place: {on: desk, left_of: cup}}
  cabinet: {asset: cabinet.asset.yaml, fixed: true, pose: {xyz: [0.6, -0.2, 0.1]}}
robots:
  arm: {model: franka_robotiq, joints: {joint1: 0.3}}
cameras:
  wrist: {size: [64, 48], fx: 60, fy: 60, mount: arm.hand, pose: {look_at: [0, 0, 1]}}
"""
ASSET = """\
simfoundry: asset/1
name: cabinet
links:
  body: {density: 600, parts: {board: {shape: {box: [0.2, 0.2, 0.02]}}}}
  tray: {density: 600, parts: {board: {shape: {box: [0.2, 0.2, 0.02]}}}}
joints:
  drawer: {type: prismatic, parent: body, child: tray, limits: [0, 0.2]}
"""
TASK = """\
simfoundry: task/1
name: store
scene: kitchen.scene.yaml
instruction: Put the cup in the drawer.
robots: [arm]
goal: {all: [Inside(cup, cabinet.drawer), Closed(cabinet.drawer), {not: Grasped(cup, arm)}]}
subtasks:
  open: {goal: Open(cabinet.drawer)}
  place: {goal: Inside(cup, cabinet.tray), start: {joints: {cabinet: {drawer: 0.15}}, place: {cup: {on: desk}}}}
start: {pose: {bowl: {xyz: [0.2, 0.2, 0.01]}}}
reset: {objects: {cup: {x: [0.3, 0.5], y: [0, 0.2]}}}
"""
COUSINS = """\
simfoundry: cousins/1
name: kitchens
twin: store.task.yaml
scene: {anchor: bowl, objects: {cup: [LeftOf, Behind]}}
object: {objects: {bowl: {}}}
task: {objects: [cup]}
"""
FILES = {
    "kitchen.scene.yaml": SCENE,
    "cabinet.asset.yaml": ASSET,
    "store.task.yaml": TASK,
    "kitchens.cousins.yaml": COUSINS,
}


def found(folder: Path, file: str, right: str = "", wrong: str = "") -> list[tuple[str, int, str]]:
    """Code, line and message of what is found in ``file`` where ``right`` is replaced by ``wrong``."""
    for name, text in FILES.items():
        if name == file and right:
            assert right in text, right
        (folder / name).write_text(text.replace(right, wrong) if name == file and right else text)
    return [(d.code, d.line, d.message) for d in load(folder / file).all_findings()]


@pytest.mark.parametrize("file", FILES)
def test_the_documents_are_sound(tmp_path: Path, file: str) -> None:
    assert found(tmp_path, file) == []


# Slips by file and by the text in which they are made, each with its code and the words of its finding.
SLIPS: dict[str, dict[str, list[tuple[str, str, str]]]] = {
    "kitchen.scene.yaml": {
        "{on: desk, left_of": [("{on: dsk, left_of", "SF201", "no object is called `dsk`")],
        "left_of: cup": [
            ("left_of: cpu", "SF201", "no object is called `cpu`"),
            ("left_of: bowl", "SF208", "depends on itself: `bowl` → `bowl`"),
        ],
        "{on: desk, left": [
            ("{on: cabinet.shelf, left", "SF201", "no link or part of `cabinet`"),
            ("{on: cup.rim, left", "SF201", "`cup` does not have any parts"),
        ],
        "left_of: cup}": [
            ("gap: 0.1}", "SF107", "`gap` requires `left_of`"),
            ("left_of: cup, right_of: cup}", "SF107", "specify only one of `left_of`, `right_of`"),
            ("xy: [0, 0], left_of: cup}", "SF107", "specify only one of `xy`, `local_xy`, `left_of`"),
        ],
        "franka_robotiq": [("franka_robotic", "SF201", "no robot is called `franka_robotic`")],
        "joint1": [("joint9", "SF201", "no joint of `franka_robotiq` is called `joint9`")],
        "franka_robotiq, joints: {joint1: 0.3}": [
            ("{mjcf: arm.xml}", "SF203", "file `arm.xml` does not exist"),
            ("{}", "SF107", "one of `file`, `mjcf`, `urdf`, `usd`"),
        ],
        "arm.hand": [
            ("arm.hnd", "SF201", "no link of `arm` is called `hnd`"),
            ("leg.hand", "SF201", "no robot or object is called `leg`"),
        ],
        "viewpoint: arm": [("viewpoint: are", "SF201", "no camera or robot is called `are`")],
    },
    "store.task.yaml": {
        "kitchen.scene": [("kitchn.scene", "SF203", "file `kitchn.scene.yaml` does not exist")],
        "kitchen.scene.yaml": [("cabinet.asset.yaml", "SF006", "a different kind of document")],
        "robots: [arm]": [("robots: [leg]", "SF201", "no robot is called `leg`")],
        "Grasped(cup, arm)": [("Grasped(cup, leg)", "SF201", "no robot is called `leg`")],
        "Closed(cabinet.drawer)": [
            ("Closed(cup)", "SF201", "`cup` does not have any joints"),
            ("Closed(cabinet.door)", "SF201", "no joint of `cabinet` is called `door`"),
            ("Shut(cabinet.drawer)", "SF202", "`Shut` is not a predicate"),
            ("At(cup, 0.4)", "SF202", "`At` takes 3 or 4 arguments, not 2"),
            ("At(cup, x, 0.4)", "SF202", "`x` is not a number"),
        ],
        "{not: Grasped(cup, arm)}": [
            ("{not: {all: []}}", "SF404", "without predicates succeeds immediately"),
            ("{any: []}", "SF404", "without predicates never succeeds"),
        ],
        "{drawer: 0.15}": [
            ("{drawer: 0.25}", "SF205", "outside its limits"),
            ("{door: 0.15}", "SF201", "no joint is called `door`"),
        ],
        "{cup: {on: desk}}": [
            ("{desk: {on: cup}}", "SF107", "`desk` is fixed in the scene"),
            ("{cup: {on: cup}}", "SF208", "depends on itself"),
        ],
        "{objects: {cup: {x: [0.3": [("{objects: {cup: {x: [0.6", "SF104", "the minimum")],
        "{objects: {cup: {x": [("{objects: {mug: {x", "SF201", "no object is called `mug`")],
    },
    "kitchens.cousins.yaml": {
        "store.task": [("stor.task", "SF203", "does not exist")],
        "anchor: bowl": [
            ("anchor: bowls", "SF201", "no object is called `bowls`"),
            ("anchor: cup", "SF107", "`cup` is the anchor"),
        ],
        "{cup: [LeftOf, Behind]}": [("{desk: [LeftOf]}", "SF107", "`desk` is fixed")],
        "[LeftOf, Behind]": [
            ("[]", "SF105", "no predicate is allowed"),
            ("[LeftOf, Beside]", "SF106", "`Beside` is not valid here"),
        ],
        "{bowl: {}}": [("{bowls: {}}", "SF201", "no object is called `bowls`")],
        "task: {": [("task: {engines: [mujoco, bulet], ", "SF106", "scenes cannot be run in `bulet`; available")],
        "[cup]": [("[cupp]", "SF201", "no object is called `cupp`")],
    },
}


@pytest.mark.parametrize(
    ("file", "right", "slip"), [(f, r, slip) for f, slips in SLIPS.items() for r in slips for slip in slips[r]]
)
def test_a_slip_gives_one_finding_at_its_line(
    tmp_path: Path, file: str, right: str, slip: tuple[str, str, str]
) -> None:
    wrong, code, words = slip
    line = FILES[file].partition(right)[0].count("\n") + 1
    ((got_code, got_line, message),) = found(tmp_path, file, right, wrong)
    assert (got_code, got_line) == (code, line) and words in message


def test_a_recipe_may_name_the_simulator_of_another_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    profile = "simfoundry: target/1\nname: bulet\ndescription: a simulator\nbackend: pybullet\n"
    profile += "tested: {how: checked, note: by us}\nworld: bulet_targets.world:BuletWorld\n"
    files = {"bulet_targets/__init__.py": "", "bulet_targets/bulet/profile.yaml": profile}
    write_package(tmp_path / "site", "bulet", {"simfoundry.targets": {"bulet": "bulet_targets.bulet"}}, files)
    monkeypatch.syspath_prepend(tmp_path / "site")
    assert found(tmp_path, "kitchens.cousins.yaml", "task: {", "task: {engines: [mujoco, bulet], ") == []


FOAM = """\
simfoundry: scene/1
name: foam
objects:
  block: {shape: {box: [0.1, 0.1, 0.1]}, density: 3, fixed: true}
  brick: {shape: {box: [0.1, 0.1, 0.1]}, density: 3, fixed: true, pose: {xyz: [1, 0, 0]}}
"""


@pytest.mark.parametrize(
    ("allow", "left", "idle"),
    [
        ("", {"objects.block.density", "objects.brick.density"}, set()),
        ("allow: {SF402: aerogel}\n", set(), set()),
        ("allow: {SF402: {block: aerogel}}\n", {"objects.brick.density"}, set()),
        ("allow: {SF402: {block: aerogel, brock: aerogel}}\n", {"objects.brick.density"}, {"allow.SF402.brock"}),
        ("allow: {SF401: keep}\n", {"objects.block.density", "objects.brick.density"}, {"allow.SF401"}),
    ],
)
def test_a_warning_is_silenced_with_a_reason(tmp_path: Path, allow: str, left: set[str], idle: set[str]) -> None:
    path = tmp_path / "a.scene.yaml"
    path.write_text(FOAM + allow)
    loaded = load(path)
    assert loaded.spec is not None and loaded.document is not None
    assert {d.path for d in loaded.findings} == left
    assert {d.path for d in unused(loaded.document, loaded.spec.allow, loaded.silenced)} == idle


def test_an_error_cannot_be_silenced(tmp_path: Path) -> None:
    path = tmp_path / "a.scene.yaml"
    path.write_text(FOAM.replace("density: 3, fixed: true}", "fixed: true, material: foam}") + "allow: {SF201: why}\n")
    assert [d.code for d in load(path).errors] == ["SF201"]


def test_a_conflict_is_an_error_until_it_is_decided(tmp_path: Path) -> None:
    path = tmp_path / "a.scene.yaml"
    path.write_text(FOAM + "conflicts:\n  objects.block.density: {base: 2, ours: 3, theirs: 4}\n")
    (error,) = load(path).errors
    assert (error.code, error.line, error.severity) == ("SF209", 7, Severity.ERROR)
    assert error.message == "`objects.block.density` is an open conflict: ours `3`, theirs `4`"


@pytest.mark.parametrize(
    ("text", "path"),
    [
        ("objects: {a: {shape: {box: [1, 1, 1]}, mass: }}\n", "objects.a.mass"),
        ("objects: {a: {shape: {box: [1, 1, 1]}, mass: 1, friction: ~}}\n", "objects.a.friction"),
        ("objects: {a: }\n", "objects.a"),
        ("relations: [~]\n", "relations.0"),
        ("cameras:\n", "cameras"),
    ],
)
def test_a_key_without_a_value_is_an_error(tmp_path: Path, text: str, path: str) -> None:
    file = tmp_path / "a.scene.yaml"
    file.write_text(f"simfoundry: scene/1\nname: a\n{text}")
    assert [(d.code, d.path, d.line) for d in load(file).errors] == [("SF103", path, 3)]
