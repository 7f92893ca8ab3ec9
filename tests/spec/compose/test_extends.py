"""``extends``: what is joined, replaced and removed, and where findings are said to stand."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.spec.diagnostics import render
from simfoundry.spec.files import Loaded
from simfoundry.spec.load import load
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import TaskSpec

TWIN = """\
simfoundry: scene/1
name: twin
materials:
  wood: {density: 700, friction: 0.5}
objects:
  desk: {fixed: true, shape: {box: [1.4, 0.7, 0.04]}, material: wood, pose: {xyz: [0.4, 0, -0.02]}}
  cup: {shape: {cylinder: {radius: 0.04, height: 0.1}}, mass: 0.2, pose: {xyz: [0.4, 0.1, 0.05], yaw_deg: 30}}
  plate: {shape: {cylinder: {radius: 0.1, height: 0.02}}, mass: 0.4, pose: {xyz: [0.6, 0.1, 0.01]}}
relations: [OnTop(cup, desk), OnTop(plate, desk)]
"""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    (tmp_path / ".git").mkdir()
    (tmp_path / "twin.scene.yaml").write_text(TWIN)
    return tmp_path


def overlay(project: Path, body: str, name: str = "b.scene.yaml", base: str = "twin.scene.yaml") -> Loaded:
    path = project / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"simfoundry: scene/1\nextends: {base}\n{body}")
    return load(path)


def spec_of(loaded: Loaded) -> SceneSpec:
    assert isinstance(loaded.spec, SceneSpec), render(loaded.all_findings())
    return loaded.spec


def test_mappings_are_joined_and_the_rest_is_replaced(project: Path) -> None:
    objects = "objects:\n  cup: {mass: 0.3, pose: {xyz: [0.5, 0, 0.05]}}\n  plate: null\n"
    body = f"name: b\n{objects}relations: [OnTop(cup, desk)]\n"
    spec = spec_of(overlay(project, body))
    assert spec.name == "b" and list(spec.objects) == ["desk", "cup"]
    cup = spec.objects["cup"]
    assert (cup.mass, cup.pose.xyz, cup.pose.yaw_deg) == (0.3, (0.5, 0.0, 0.05), 30.0)
    assert spec.relations == ("OnTop(cup, desk)",) and spec.materials["wood"].friction == 0.5


def test_a_key_replaces_the_ones_it_excludes(project: Path) -> None:
    body = """\
objects:
  cup: {pose: {rpy_deg: [90, 0, 0]}, shape: {box: [0.1, 0.1, 0.1]}, density: 300, mass: null}
  plate: {place: {on: desk, xy: [0.5, 0.1]}, density: 900}
"""
    objects = spec_of(overlay(project, body)).objects
    assert objects["cup"].pose.yaw_deg is None and objects["cup"].pose.rpy_deg == (90, 0, 0)
    assert objects["cup"].mass is None and objects["cup"].density == 300
    assert objects["plate"].place is not None and objects["plate"].mass is None


def test_names_never_exclude_each_other(project: Path) -> None:
    box = "{shape: {box: [0.1, 0.1, 0.1]}, mass: 1, pose: {xyz: [0, 9, 0.05]}}"
    first = overlay(project, f"objects:\n  box: {box}\n  on: {box}\n", "first.scene.yaml")
    assert first.spec is not None
    body = f"objects:\n  sphere: {box}\n  inside: {box}\n"
    spec = spec_of(overlay(project, body, "second.scene.yaml", "first.scene.yaml"))
    assert {"box", "on", "sphere", "inside"} <= set(spec.objects)


def test_overlays_stack_and_bases_are_named(project: Path) -> None:
    overlay(project, "objects: {cup: {mass: 0.3}}\n", "one.scene.yaml")
    loaded = overlay(project, "objects: {cup: {friction: 0.9}}\n", "deep/two.scene.yaml", "../one.scene.yaml")
    cup = spec_of(loaded).objects["cup"]
    assert (cup.mass, cup.friction) == (0.3, 0.9)
    assert [p.name for p in loaded.bases] == ["one.scene.yaml", "twin.scene.yaml"]


def test_files_of_a_base_are_meant_from_where_it_stands(project: Path) -> None:
    (project / "lib" / "meshes").mkdir(parents=True)
    (project / "lib" / "meshes" / "a.obj").write_text("")
    text = TWIN.replace("shape: {cylinder: {radius: 0.04, height: 0.1}}", "asset: meshes/a.obj")
    (project / "lib" / "twin.scene.yaml").write_text(text)
    loaded = overlay(project, "name: b\n", "cousins/b.scene.yaml", "../lib/twin.scene.yaml")
    assert spec_of(loaded).objects["cup"].asset == "../lib/meshes/a.obj"
    assert loaded.file("../lib/meshes/a.obj").is_file()


def test_a_finding_names_the_file_that_it_stands_in(project: Path) -> None:
    (project / "twin.scene.yaml").write_text(TWIN.replace("mass: 0.2", "mass: -0.2"))
    found = overlay(project, "objects:\n  plate: {mas: 0.3}\n").all_findings()
    places = {(Path(d.file).name, d.line, d.code) for d in found}
    assert places == {("twin.scene.yaml", 7, "SF104"), ("b.scene.yaml", 4, "SF101")}


def test_a_name_that_the_overlay_breaks_is_found_where_it_is_used(project: Path) -> None:
    found = overlay(project, "objects: {plate: null}\n").all_findings()
    assert [(Path(d.file).name, d.line, d.code) for d in found] == [("twin.scene.yaml", 9, "SF201")]


@pytest.mark.parametrize(
    ("body", "base", "code", "words"),
    [
        ("objects: {bowl: null}\n", "twin.scene.yaml", "SF201", "cannot be removed"),
        ("", "twn.scene.yaml", "SF203", "does not exist"),
        ("", "../outside.scene.yaml", "SF204", "is outside the project"),
        ("", "b.scene.yaml", "SF207", "`b.scene.yaml` extends `b.scene.yaml`"),
        ("", "[twin.scene.yaml]", "SF103", "expected a string"),
        ("", "a.asset.yaml", "SF006", "this is a `scene/1` document"),
        ("", "other.yaml", "SF006", "`asset/1`"),
        ("", "broken.scene.yaml", "SF002", "is not closed"),
    ],
)
def test_what_cannot_be_extended_is_said(project: Path, body: str, base: str, code: str, words: str) -> None:
    (project / "a.asset.yaml").write_text("simfoundry: asset/1\nname: a\n")
    (project / "other.yaml").write_text("simfoundry: asset/1\nname: a\n")
    (project / "broken.scene.yaml").write_text("simfoundry: scene/1\nname: [a\n")
    (project.parent / "outside.scene.yaml").write_text(TWIN)
    found = overlay(project, body, base=base).all_findings()
    assert [d.code for d in found] == [code]
    assert words in found[0].message


def test_a_long_ring_is_named(project: Path) -> None:
    for name, base in (("a", "b"), ("b", "c"), ("c", "a")):
        (project / f"{name}.scene.yaml").write_text(f"simfoundry: scene/1\nextends: {base}.scene.yaml\n")
    found = load(project / "a.scene.yaml").all_findings()
    assert [d.code for d in found] == ["SF207"]
    assert found[0].message.count("extends") == 3 and Path(found[0].file).name == "c.scene.yaml"


def test_a_chain_has_an_end(project: Path) -> None:
    for k in range(30):
        (project / f"c{k}.scene.yaml").write_text(f"simfoundry: scene/1\nextends: c{k + 1}.scene.yaml\n")
    (project / "c30.scene.yaml").write_text(TWIN)
    assert [d.code for d in load(project / "c0.scene.yaml").all_findings()] == ["SF005"]
    assert load(project / "c20.scene.yaml").all_findings() == []


def test_starts_by_place_and_by_pose_do_not_exclude_each_other(project: Path) -> None:
    head = "simfoundry: task/1\nname: a\nscene: twin.scene.yaml\ninstruction: go\ngoal: Lifted(cup)\n"
    (project / "a.task.yaml").write_text(f"{head}start: {{place: {{cup: {{on: desk}}}}}}\n")
    (project / "b.task.yaml").write_text(
        "simfoundry: task/1\nextends: a.task.yaml\nstart: {pose: {plate: {xyz: [0.5, 0, 0.01]}}}\ngoal: {any: []}\n"
    )
    spec = load(project / "b.task.yaml").spec
    assert isinstance(spec, TaskSpec)
    assert list(spec.start.place) == ["cup"] and list(spec.start.pose) == ["plate"]
