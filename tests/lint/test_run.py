"""What is linted, once; what is silenced; and that it is cheap."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from simfoundry.lint.lints import lint
from simfoundry.spec.load import load
from tests.conftest import REPOSITORY
from tests.lint.scenes import ARM, codes, findings, task, written

SUNK = "cup: {shape: {cylinder: {radius: 0.04, height: 0.1}}, mass: 0.2, pose: {xyz: [0, 0, 0.03]}}"


@pytest.mark.parametrize("allow", ["SF410: why not", "SF410: {cup: why not}", "SF410: {desk: why not}"])
def test_a_finding_is_silenced_by_code_and_by_either_name(allow: str, tmp_path: Path) -> None:
    assert codes(written(tmp_path, SUNK)) == ["SF410"]
    assert codes(written(tmp_path, SUNK, f"allow: {{{allow}}}\n")) == []


def test_an_allow_that_silences_nothing_is_a_finding(tmp_path: Path) -> None:
    path = written(tmp_path, SUNK, "allow: {SF410: {cup: sunk, mug: gone}, SF411: it hangs}\n")
    assert [(d.code, d.path) for d in findings(path)] == [("SF403", "allow.SF410.mug"), ("SF403", "allow.SF411")]


def test_an_allow_of_a_base_is_the_matter_of_the_base(tmp_path: Path) -> None:
    written(tmp_path, SUNK, "allow: {SF410: it is sunk into its holder}\n")
    overlay = tmp_path / "free.scene.yaml"
    text = "simfoundry: scene/1\nextends: desk.scene.yaml\nname: free\nobjects: {cup: {pose: {xyz: [0, 0, 0.05]}}}\n"
    overlay.write_text(text)
    assert codes(overlay) == []
    overlay.write_text(text + "allow: {SF411: it hangs}\n")
    assert [(d.code, d.path) for d in findings(overlay)] == [("SF403", "allow.SF411")]


def test_an_allow_for_the_language_counts_as_used(tmp_path: Path) -> None:
    material = "materials: {steel: {density: 7800}}\nallow: {SF401: for the cousins}\n"
    assert codes(written(tmp_path, SUNK.replace("0.03]", "0.05]"), material)) == []


def test_a_scene_is_linted_once_for_all_its_tasks(tmp_path: Path) -> None:
    written(tmp_path, SUNK, ARM)
    tasks = [task(tmp_path, "Lifted(cup)", name=f"t{k}.task.yaml") for k in range(3)]
    seen = set[Path]()
    found = [[d.code for d in lint(load(path), seen)] for path in (*tasks, tmp_path / "desk.scene.yaml")]
    assert found == [["SF410"], [], [], []]
    assert len(seen) == 4


def test_documents_with_errors_are_left_to_their_errors(tmp_path: Path) -> None:
    path = written(tmp_path, SUNK + "\nmug: {shape: {sphere: -1}, mass: 1}")
    assert load(path).errors != []
    assert lint(load(path)) == ()


HUGE = ["1.0e308", "1.0e-308", "1.0e150", "5.0e6"]


@pytest.mark.parametrize("number", HUGE)
def test_numbers_beyond_reason_are_survived(number: str, tmp_path: Path) -> None:
    objects = f"""
        box: {{shape: {{box: [{number}, 1, 1]}}, mass: 1}}
        far: {{shape: {{sphere: 0.1}}, mass: 1, pose: {{xyz: [{number}, -{number}, 0]}}}}
        cup: {{shape: {{lathe: {{profile: [[0, 0], [{number}, 0], [{number}, {number}], [0, {number}]]}}}}, mass: 1}}
        can: {{shape: {{cylinder: {{radius: {number}, height: {number}}}}}, mass: 1, place: {{on: desk}}}}
        jar: {{shape: {{capsule: {{radius: {number}, height: 1}}}}, mass: 1, place: {{inside: can, left_of: box}}}}
        tile: {{shape: {{prism: {{outline: [[0, 0], [{number}, 0], [0, {number}]], height: 1}}}}, mass: 1}}
    """
    pose = f"{{xyz: [{number}, 0, 0], look_at: [0, 9, 0]}}"
    cameras = f"cameras: {{eye: {{size: [8, 8], fx: {number}, fy: 1, pose: {pose}}}}}\n"
    path = written(
        tmp_path, objects, cameras + ARM + "relations: [OnTop(far, desk), Inside(cup, can), LeftOf(far, box)]\n"
    )
    if not load(path).errors:
        findings(path)


def test_primitives_need_numpy_alone(tmp_path: Path) -> None:
    things = """
        cup: {shape: {cylinder: {radius: 0.03, height: 0.1}}, mass: 0.2, pose: {xyz: [0, 0, 0.05]}}
        plate: {shape: {cylinder: {radius: 0.1, height: 0.02}}, mass: 0.4, pose: {xyz: [0.4, 0, 0.01]}}
        ball: {shape: {sphere: 0.03}, mass: 0.1, pose: {xyz: [0.4, 0, 0.05]}}
        box: {shape: {box: [0.1, 0.06, 0.1]}, mass: 0.1, pose: {xyz: [0.055, 0.058, 0.05], yaw_deg: 45}}
        pen: {shape: {capsule: {radius: 0.005, height: 0.1}}, mass: 0.1, place: {on: box}}
    """
    path = task(tmp_path, "{all: [Lifted(cup), OnTop(cup, plate)]}")
    relations = (
        "[OnTop(cup, desk), OnTop(ball, plate), OnTop(pen, box), Upright(cup), LeftOf(box, cup), Touching(box, desk)]"
    )
    written(tmp_path, things, ARM + f"relations: {relations}\n")
    code = (
        "import sys; from pathlib import Path\n"
        "from simfoundry.lint.lints import lint; from simfoundry.spec.load import load\n"
        f"found = lint(load(Path({str(path)!r})))\n"
        "heavy = {'trimesh', 'scipy', 'shapely', 'rich', 'mujoco'} & set(sys.modules)\n"
        "print(len(found), *sorted(heavy))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=REPOSITORY)
    assert done.stdout.split() == ["0"]


def test_the_specs_of_the_project_are_clean() -> None:
    seen = set[Path]()
    paths = sorted((REPOSITORY / "specs").rglob("*.yaml"))
    assert len(paths) > 50
    assert [d for path in paths for d in lint(load(path), seen)] == []
