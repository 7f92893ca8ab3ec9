"""Saving edited documents: only edited lines change, and a failed save leaves everything as it was."""

from __future__ import annotations

import difflib
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random
from typing import Any

import pytest

import simfoundry as sf
from simfoundry.errors import OutputError
from simfoundry.spec.load import load
from simfoundry.spec.yaml.text import parse

TEXT = """\
simfoundry: scene/1
name: desk                             # as seen by the camera
gravity: [0, 0, -9.81]  # g

materials:
  wood:    {density: 700, friction: 0.5}
  ceramic: {density: 2400, friction: 0.35}

objects:
  table:
    fixed: true
    shape: {box: [1.4, 0.7, 0.04]}
    material: wood
    pose: {xyz: [0.45, 0, -0.02]}
  # the one with a chip
  mug:
    # not bolted down
    fixed: false  # check
    shape: {cylinder: {radius: 0.04, height: 0.095}}
    scale: 1
    material: ceramic
    mass: 0.31
    collision: auto  # mesh later
    place: {on: table, xy: [0.42, 0.12]}

robots:
  arm:
    model: franka_panda
    pose:
      xyz: [0, 0, 0]    # at the origin
      yaw_deg: 10

cameras:
  front: {size: [640, 480], fx: 600, fy: 600, pose: {xyz: [1, 0, 1], look_at: [0, 0, 0]}}

lights:
  sun:
    type: distant
    intensity: 1  # full
    direction: [0, 0, -1]

no_contact: []
relations: [OnTop(mug, table)]
"""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    (tmp_path / "simfoundry.yaml").touch()
    (tmp_path / "desk.scene.yaml").write_text(TEXT)
    return tmp_path


@pytest.fixture
def scene(project: Path) -> sf.SceneDocument:
    return sf.load(project / "desk.scene.yaml")


def _changed(before: str, after: str) -> list[str]:
    """The lines that are not in both texts, with a sign, as in a diff."""
    lines = difflib.ndiff(before.splitlines(keepends=True), after.splitlines(keepends=True))
    return [line[0] + line[2:].rstrip("\n") for line in lines if line[0] in "+-"]


EDITS: dict[str, tuple[Callable[[sf.SceneDocument], object], list[str]]] = {
    "a number": (lambda s: setattr(s.objects["mug"], "mass", 0.5), ["-    mass: 0.31", "+    mass: 0.5"]),
    "in braces": (
        lambda s: setattr(s.materials["wood"], "density", 650),
        ["-  wood:    {density: 700, friction: 0.5}", "+  wood:    {density: 650, friction: 0.5}"],
    ),
    "beside defaults": (lambda s: setattr(s.lights["sun"], "color", [1, 1, 0.5]), ["+    color: [1, 1, 0.5]"]),
    "in a pose": (lambda s: setattr(s.robots["arm"].pose, "yaw_deg", 30), ["-      yaw_deg: 10", "+      yaw_deg: 30"]),
    "a default itself": (
        lambda s: setattr(s.objects["mug"], "fixed", True),
        ["-    fixed: false  # check", "+    fixed: true  # check"],
    ),
    "a removed default": (lambda s: delattr(s.objects["mug"], "scale"), ["-    scale: 1"]),
    "the rest of a pose": (lambda s: delattr(s.robots["arm"].pose, "yaw_deg"), ["-      yaw_deg: 10"]),
}


@pytest.mark.parametrize("name", EDITS)
def test_an_edit_keeps_lines_that_state_a_default(scene: sf.SceneDocument, name: str) -> None:
    edit, wanted = EDITS[name]
    edit(scene)
    assert _changed(TEXT, scene.save().read_text()) == wanted


SCENES = sorted(Path("specs/scenes").rglob("*.scene.yaml"))

# Lines that state the defaults of some keys, with comments, by the section in which they are inserted.
STATED = {
    "objects": ["fixed: false  # {}", "scale: 1.0  # {}", "collision: auto  # {}", "labels: []  # {}"],
    "lights": ["intensity: 1  # {}"],
}


def _stating_defaults(text: str, data: dict[str, Any]) -> str:
    """The text with a line for each default that an entry could state, where entries have several lines."""
    out, section, lines = list[str](), "", text.splitlines()
    for k, line in enumerate(lines):
        out.append(line)
        if line[:1].isalpha():
            section = line.partition(":")[0]
        name = line.strip().partition(":")[0]
        entry = data.get(section, {}).get(name) if line.startswith("  ") and line[2:3].isalpha() else None
        if section in STATED and isinstance(entry, dict) and lines[k + 1 :] and lines[k + 1].startswith("    "):
            stated = [row for row in STATED[section] if row.partition(":")[0] not in entry]
            out += [f"    {row}".format(f"{name} {n}") for n, row in enumerate(stated)]
    return "\n".join(["# states defaults", *out, ""])


def _numbers(data: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """The paths of all numbers in mappings."""
    if isinstance(data, dict):
        for key, value in data.items():
            yield from _numbers(value, (*path, key))
    elif isinstance(data, float) and data > 0:
        yield path


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_any_single_edit_of_a_scene_leaves_all_other_lines_as_they_are(path: Path) -> None:
    text = path.read_text()
    text = _stating_defaults(text, parse(text).data)

    def document() -> sf.SceneDocument:
        loaded = load(path.with_name("stated.scene.yaml"), text=text)
        assert not loaded.errors
        return sf.SceneDocument(loaded)

    random, places = Random(path.stem), list(_numbers(document()._data))
    for place in random.sample(places, min(len(places), 12)):
        edited = document()
        edited._edit({place: round(edited._get(place) * 0.99, 6)})
        changed = _changed(text, edited.text)
        assert changed and len([line for line in changed if line[0] == "-"]) <= 1, (place, changed)
    for name in document().objects:
        edited = document()
        was = edited.objects[name].friction
        edited.objects[name].friction = 0.123
        changed = _changed(text, edited.text)
        assert "friction: 0.123" in changed[-1], changed
        assert len([line for line in changed if line[0] == "-"]) <= 1, changed
        edited.objects[name].friction = was
        assert edited.text == text


def test_an_overlay_keeps_the_defaults_with_which_it_overrides_its_base(project: Path) -> None:
    text = "simfoundry: scene/1\nextends: desk.scene.yaml\nname: loose\nobjects:\n  table:\n    fixed: false  # loose\n"
    text += "    pose: {xyz: [0.45, 0, 0.02]}\n  mug: {pose: {xyz: [0.4, 0, 0.1]}}  # not placed\n"
    (project / "loose.scene.yaml").write_text(text)
    loose = sf.load(project / "loose.scene.yaml")
    loose.objects["table"].mass = 3
    loose.objects["mug"].mass = 0.4
    wanted = ["+    mass: 3", "-  mug: {pose: {xyz: [0.4, 0, 0.1]}}  # not placed"]
    assert _changed(text, loose.save().read_text()) == [
        *wanted,
        "+  mug: {mass: 0.4, pose: {xyz: [0.4, 0, 0.1]}}  # not placed",
    ]
    loose.objects["mug"].update(pose=None, place={"on": "table"})
    assert sf.load(loose.save()).objects["mug"].to_data()["place"] == {"on": "table"}


def test_saving_keeps_symbolic_links_and_permissions(project: Path) -> None:
    (project / "real").mkdir()
    real = (project / "desk.scene.yaml").rename(project / "real" / "desk.scene.yaml")
    link = project / "link.scene.yaml"
    link.symlink_to("real/desk.scene.yaml")
    for mode in (0o600, 0o664):
        real.chmod(mode)
        scene = sf.load(link)
        scene.objects["mug"].mass = mode / 1000
        assert scene.save() == link
        assert link.is_symlink() and real.stat().st_mode & 0o777 == mode
        assert f"mass: {mode / 1000}" in real.read_text()


MJCF = """\
<mujoco model="m">
  <asset><mesh name="tet" vertex="0 0 0  0.1 0 0  0 0.1 0  0 0 0.1"/></asset>
  <worldbody><body name="cup" pos="0 0 1"><freejoint/><geom type="mesh" mesh="tet" mass="{mass}"/></body></worldbody>
</mujoco>
"""


@pytest.fixture
def model(project: Path) -> Path:
    (project / "scene.xml").write_text(MJCF.format(mass=0.2))
    return project / "scene.xml"


def test_a_failed_save_of_an_imported_model_writes_nothing(model: Path, project: Path) -> None:
    imported = sf.load(model)
    imported.objects["cup"].place = {"on": "shelf"}
    before = sorted(project.rglob("*"))
    with pytest.raises(sf.SpecError):
        imported.save(project / "a" / "imp.scene.yaml")
    assert sorted(project.rglob("*")) == before
    del imported.objects["cup"].place
    imported.objects["cup"].pose.xyz = (0, 0, 1)
    saved = imported.save(project / "a" / "imp.scene.yaml")
    assert "cup" in sf.load(saved).lower().object("cup").name
    files = {path: path.read_bytes() for path in sorted(saved.parent.rglob("*")) if path.is_file()}
    again = sf.load(model)
    again.objects["cup"].place = {"on": "shelf"}
    with pytest.raises(sf.SpecError):
        again.save(saved)
    assert {path: path.read_bytes() for path in sorted(saved.parent.rglob("*")) if path.is_file()} == files


def test_importing_again_replaces_the_mesh_folder_unless_it_was_edited(model: Path, project: Path) -> None:
    out = project / "a" / "imp.scene.yaml"
    sf.load(model).save(out)
    model.write_text(MJCF.format(mass=0.3))
    sf.load(model).save(out)
    assert sf.load(out).lower().object("cup").links[0].mass == pytest.approx(0.3)
    with pytest.raises(OutputError, match="contains files that were not generated there"):
        sf.load(model).save(out.with_name("other.scene.yaml"))
    asset = out.parent / "scene_files" / "cup.asset.yaml"
    asset.write_text(asset.read_text() + "# mine\n")
    with pytest.raises(OutputError, match=r"edited since they were generated \(cup.asset.yaml\)"):
        sf.load(model).save(out)
    assert asset.read_text().endswith("# mine\n")


def test_a_whole_number_may_be_given_as_a_float(scene: sf.SceneDocument) -> None:
    scene.cameras["front"].size = (320.0, 240.0)  # type: ignore[assignment]
    assert scene.cameras["front"].size == (320, 240) and "size: [320, 240]" in scene.text
    task = sf.load_task("specs/tasks/cup_in_bowl.task.yaml")
    task.horizon = 77.0  # type: ignore[assignment]
    assert task.horizon == 77 and "horizon: 77\n" in task.text


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda s: setattr(s.objects["mug"], "place", {}), "SF107 one of `on`, `inside` is needed"),
        (lambda s: setattr(s.cameras["front"], "size", [640.5, 480]), "SF103 expected an integer"),
        (lambda s: setattr(s.objects["mug"], "mass", True), "SF103"),
    ],
)
def test_a_rejected_value_has_the_message_of_check(
    scene: sf.SceneDocument, edit: Callable[[sf.SceneDocument], object], said: str
) -> None:
    with pytest.raises(sf.SpecError, match=said) as caught:
        edit(scene)
    assert caught.value.diagnostics and scene.text == TEXT and not scene.changes


def test_many_objects_come_and_go_in_reasonable_time(scene: sf.SceneDocument) -> None:
    start = time.process_time()
    for k in range(400):
        scene.objects.add(f"o{k}", shape={"box": [0.1, 0.1, 0.1]}, mass=0.1, pose={"xyz": [k, 0, 0.05]})
        scene.relations.append(f"OnTop(o{k}, table)")
    text = scene.save().read_text()
    assert time.process_time() - start < 3  # 0.3 s in practice; 12 s if each object has its own pass
    names = [line for line in text.splitlines() if line.startswith("  o")]
    assert names == [f"  o{k}:" for k in range(400)]
    for k in range(400):
        del scene.objects[f"o{k}"]
    scene.relations = ["OnTop(mug, table)"]
    assert scene.save().read_text() == TEXT.replace(": [OnTop(mug, table)]", ":\n  - OnTop(mug, table)")
    assert time.process_time() - start < 6


def test_a_base_that_vanished_is_named(project: Path) -> None:
    (project / "b.scene.yaml").write_text("simfoundry: scene/1\nextends: desk.scene.yaml\nname: b\n")
    scene = sf.load(project / "b.scene.yaml")
    (project / "desk.scene.yaml").unlink()
    scene.objects["mug"].mass = 0.5
    assert "mass: 0.5" in scene.text
    with pytest.raises(sf.SpecError, match=r"b.scene.yaml:2:10: SF203 file `desk.scene.yaml` does not exist"):
        scene.save()


@pytest.mark.parametrize("suffix", [".yml", ".YAML"])
def test_a_document_is_saved_under_the_name_by_which_it_was_loaded(project: Path, suffix: str) -> None:
    (project / f"y.scene{suffix}").write_text(TEXT)
    scene = sf.load(project / f"y.scene{suffix}")
    scene.objects["mug"].mass = 0.5
    assert "mass: 0.5" in scene.save().read_text()
