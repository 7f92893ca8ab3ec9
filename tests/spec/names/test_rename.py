"""Renames across the documents of a project: what is edited, and when nothing is."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.names.plan import RenamePlan, plan_rename
from simfoundry.spec.names.rename import RenameError
from tests.corpora import renames
from tests.spec.names.projects import FILES, VARY, write_project

# For each kind of name: the file and the name to rename, and a line of another place after the rename to `zz`.
RENAMES = {
    "object": ("desk.scene.yaml", "mug", "vary.cousins.yaml", "  objects: [zz, bowl]"),
    "object of an overlay": ("evening.scene.yaml", "spoon", "lift_late.task.yaml", "goal: OnTop(zz, cup_1)"),
    "repeated object": ("desk.scene.yaml", "cup", "hall.scene.yaml", "  west_zz_1: {mass: 0.3}"),
    "leader": ("desk.scene.yaml", "cup", "lift_late.task.yaml", "goal: OnTop(spoon, zz_1)"),
    "joint": ("lift.task.yaml", "commode.slide", "hall.scene.yaml",
              "relations: [OnTop(ball, east_table), Closed(west_commode.zz)]"),
    "axis": ("cabinet.asset.yaml", "pan", "desk.scene.yaml", "    joints: {slide: 0.1, zz: 0.1}"),
    "link": ("desk.scene.yaml", "commode.tray", "hall_late.scene.yaml",
             "      - framepos: {name: where, objtype: body, objname: west_commode.zz}"),
    "site": ("cabinet.asset.yaml", "tip", "hall_late.scene.yaml", "      - touch: {name: felt, site: west_commode.zz}"),
    "sensor": ("cabinet.asset.yaml", "feeler", "hall_late.scene.yaml", "    order: {sensor: [west_commode.zz]}"),
    "material": ("evening.scene.yaml", "wood", "evening.scene.yaml", "    material: &stuff zz"),
    "material of an asset": ("cabinet.asset.yaml", "materials.oak", "cabinet.asset.yaml", "    material: zz"),
    "camera": ("pi.policy.yaml", "portrait", "desk.scene.yaml", "viewpoint: zz"),
    "frame": ("lift.task.yaml", "corner", "desk.scene.yaml", "  deep: {frame: zz, xyz: [0.05, 0, 0]}"),
    "template": ("desk.scene.yaml", "jug", "desk.scene.yaml",
                 "  bowl: {like: zz, place: {on: table, right_of: mug, seen_from: portrait, gap: $clearance * 2}}"),
    "parameter": ("hall.scene.yaml", "clearance", "desk.scene.yaml", "  rise: $zz * 2  # see clearance"),
    "parameter by its include": ("hall.scene.yaml", "west.clearance", "vary.cousins.yaml", "parameters: {zz: 0.2}"),
    "include": ("hall.scene.yaml", "west", "sort.task.yaml", "goal: OnTop(zz_mug, east_table)"),
    "include that is a frame": ("hall.scene.yaml", "east", "hall.scene.yaml",
        "  ball: {shape: {sphere: 0.03}, mass: 0.1, place: {on: zz_table, behind: west_mug, frame: zz}}"),
    "variant": ("evening.scene.yaml", "mug.big", "desk.scene.yaml", "    variant: zz"),
    "part": ("desk.scene.yaml", "shelf.slab", "desk.scene.yaml",
             "        zz: {shape: {box: [0.3, 0.3, 0.02]}, pose: {xyz: [0, 0, 0.2]}}"),
    "robot": ("desk.scene.yaml", "arm", "lift.task.yaml", "    - not: Grasped(mug, zz)"),
    "subtask": ("lift.task.yaml", "seize", "lift.task.yaml", "  zz: {goal: {any: [Grasped(mug)]}}"),
    "light": ("desk.scene.yaml", "lamp", "desk.scene.yaml", "  zz: {type: point, xyz: [0, 0, 1], frame: corner}"),
    "actuator": ("cabinet.asset.yaml", "pusher", "cabinet.asset.yaml", "  zz: {type: motor, joint: slide}"),
}  # fmt: skip


def _after(plan: RenamePlan) -> dict[str, str]:
    return {edit.file.name: edit.after for edit in plan.edits}


def _refused(folder: Path, file: str, old: str, new: str, kind: str = "") -> str:
    before = renames.contents(folder)
    with pytest.raises(RenameError) as error:
        plan_rename(folder / file, old, new, kind)
    assert renames.contents(folder) == before
    return str(error.value)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_project(tmp_path_factory.mktemp("project"))


@pytest.mark.parametrize("what", RENAMES)
def test_every_kind_of_name_is_renamed_everywhere(folder: Path, what: str) -> None:
    file, old, other, line = RENAMES[what]
    after = _after(plan_rename(folder / file, old, "zz"))
    assert line in after[other].splitlines()
    for name, text in after.items():
        found = renames.other_changes(FILES[name].encode(), text.encode(), old.rpartition(".")[2], "zz")
        assert found == []


@pytest.mark.slow  # 4 s
def test_random_renames_change_only_the_name_and_can_be_undone() -> None:
    report = renames.run(4, seed=7, lints=False, specs=False)
    assert report.failures == []
    assert report.renames.total() == 4


def test_texts_and_comments_that_mention_the_name_are_listed(folder: Path) -> None:
    (note,) = plan_rename(folder / "desk.scene.yaml", "mug", "beaker").notes
    assert [line.rpartition(": ")[2] for line in note.splitlines()[1:]] == [
        "# a mug beside the commode",
        "# A darker desk, with the mug elsewhere.",
        "Lift the mug.",
    ]


def test_a_name_that_is_also_a_category_is_noted(tmp_path: Path) -> None:
    scene = "simfoundry: scene/1\nname: s\nobjects: {mug: {shape: {box: [0.1, 0.1, 0.1]}, mass: 0.3}}\n"
    folder = write_project(tmp_path, {"simfoundry.yaml": "", "a.scene.yaml": scene})
    (note,) = plan_rename(folder / "a.scene.yaml", "mug", "beaker").notes
    assert "add `category: mug`" in note


REFUSED = {
    ("desk.scene.yaml", "mug", "bowl", ""): "desk.scene.yaml:30:3: `bowl` already means object `bowl`",
    ("desk.scene.yaml", "mug", "spoon", ""): "evening.scene.yaml:10:3: `spoon` already means object `spoon`",
    ("desk.scene.yaml", "mug", "Mug", ""): "a name starts with a lower-case letter",
    ("desk.scene.yaml", "mug", "m" * 65, ""): "at most 64 characters",
    ("desk.scene.yaml", "mug", "mug", ""): "it already has this name",
    ("desk.scene.yaml", "mug", "null", ""): "YAML reads `null` as a value",
    ("desk.scene.yaml", "mug", "world", ""): "an object cannot be called `world`",
    ("desk.scene.yaml", "mug", "arm", ""): "an object and a robot are both called `arm`",
    ("desk.scene.yaml", "mug", "corner", ""): "`corner`",
    ("desk.scene.yaml", "mug", "cup_2", ""): "desk.scene.yaml:31:3: `cup_2` already means object `cup`",
    ("desk.scene.yaml", "mug.big", "default", ""): "`default` is the object without overrides",
    ("desk.scene.yaml", "mug.big", "small", ""): "evening.scene.yaml:7:",
    ("desk.scene.yaml", "cup_1", "x", ""): "it is a copy of object `cup`",
    ("hall.scene.yaml", "west_mug", "x", ""): "it is object `mug` of",
    ("desk.scene.yaml", "mgu", "x", ""): "did you mean `mug`?",
    ("desk.scene.yaml", "mug", "x", "jiont"): "did you mean `joint`?",
    ("desk.scene.yaml", "mug", "x", "joint"): "there is `--kind object`",
    ("lift.task.yaml", "commode.slide", "pan", ""): "cabinet.asset.yaml:27:7: `pan` already means joint `pan`",
    ("cabinet.asset.yaml", "base", "knob", ""): "`knob` already exists beside it",
    ("hall.scene.yaml", "west", "east", ""): "`east` already means include `east`",
}


@pytest.mark.parametrize(("rename", "reason"), REFUSED.items(), ids=[" ".join(rename)[:40] for rename in REFUSED])
def test_nothing_is_renamed_to_what_is_taken_or_no_name(
    folder: Path, rename: tuple[str, str, str, str], reason: str
) -> None:
    assert reason in _refused(folder, *rename)


def test_a_name_of_several_things_needs_a_kind_or_a_section(tmp_path: Path) -> None:
    asset = FILES["cabinet.asset.yaml"].replace("slide", "tray")
    files = {n: t.replace("slide", "tray") for n, t in FILES.items()} | {"cabinet.asset.yaml": asset}
    folder = write_project(tmp_path, files)
    message = _refused(folder, "desk.scene.yaml", "commode.tray", "zz")
    assert "link `tray`" in message and "joint `tray`" in message and "--kind" in message
    of_link = _after(plan_rename(folder / "desk.scene.yaml", "commode.tray", "zz", "link"))
    assert "inside: commode.zz" in of_link["desk.scene.yaml"] and "Closed( commode.tray )" in of_link["desk.scene.yaml"]
    of_joint = _after(plan_rename(folder / "cabinet.asset.yaml", "joints.tray", "zz"))
    assert "inside: commode.tray" in of_joint["desk.scene.yaml"] and "( commode.zz )" in of_joint["desk.scene.yaml"]


def test_a_document_that_cannot_be_parsed_and_has_the_word_stops_the_rename(tmp_path: Path) -> None:
    folder = write_project(tmp_path, FILES | {"broken.scene.yaml": "simfoundry: scene/1\nobjects: {mug: {\n"})
    assert "broken.scene.yaml:3:1: this document contains `mug`" in _refused(folder, "desk.scene.yaml", "mug", "zz")
    assert plan_rename(folder / "desk.scene.yaml", "bowl", "zz").edits
    with pytest.raises(SpecError):
        plan_rename(folder / "broken.scene.yaml", "mug", "zz")


def test_an_alias_for_two_things_stops_the_rename(tmp_path: Path) -> None:
    text = FILES["desk.scene.yaml"].replace("material: wood, pose", "material: &w wood, pose")
    text = text.replace("  wood: {density: 700}", "  wood: {density: 700}").replace(
        "on: table, right_of", "on: *w, right_of"
    )
    text = text.replace("  coin:", "  wood: {shape: {box: [1, 1, 0.1]}, fixed: true, pose: {xyz: [3, 0, 0]}}\n  coin:")
    folder = write_project(tmp_path, FILES | {"desk.scene.yaml": text})
    message = _refused(folder, "desk.scene.yaml", "materials.wood", "zz")
    assert "an alias of this text names object `wood` as well" in message


def test_a_name_with_escapes_stops_the_rename(tmp_path: Path) -> None:
    text = FILES["desk.scene.yaml"].replace('"mug"', '"m\\x75g"')
    folder = write_project(tmp_path, FILES | {"desk.scene.yaml": text})
    assert "desk.scene.yaml:53:21: the name is written with escapes" in _refused(folder, "lift.task.yaml", "mug", "zz")


def test_assets_that_one_object_can_have_keep_the_same_names(tmp_path: Path) -> None:
    files = FILES | {
        "other.asset.yaml": FILES["cabinet.asset.yaml"].replace("name: cabinet", "name: other"),
        "night.scene.yaml": "simfoundry: scene/1\nextends: desk.scene.yaml\nname: night\n"
        "objects: {commode: {asset: other.asset.yaml}}\n",
    }
    after = _after(plan_rename(write_project(tmp_path, files) / "lift.task.yaml", "commode.slide", "zz"))
    assert (
        "  zz: {type: prismatic" in after["other.asset.yaml"]
        and "  zz: {type: prismatic" in after["cabinet.asset.yaml"]
    )
    after = _after(plan_rename(tmp_path / "other.asset.yaml", "trunk", "zz"))
    assert list(after) == ["other.asset.yaml"]


def test_names_in_conflicts_follow(tmp_path: Path) -> None:
    files = {
        "simfoundry.yaml": "",
        "a.scene.yaml": "simfoundry: scene/1\nname: a\nobjects:\n  mug: {shape: {sphere: 0.1}, mass: 1}\n"
        "  cup: {shape: {sphere: 0.1}, mass: 1, place: {on: mug}}\n  on: {shape: {sphere: 0.1}, mass: 1}\n"
        "conflicts:\n  objects.cup.place: {base: {on: mug}, ours: {on: mug}, theirs: {on: on}}\n"
        "  'objects.mug.mass #2': {ours: 1, theirs: 2}\n  relations: {ours: [OnTop(cup, mug)], theirs: []}\n",
    }
    after = _after(plan_rename(write_project(tmp_path, files) / "a.scene.yaml", "mug", "zz"))["a.scene.yaml"]
    assert after == files["a.scene.yaml"].replace("mug", "zz")
    after = _after(plan_rename(tmp_path / "a.scene.yaml", "on", "zz"))["a.scene.yaml"]
    assert after == files["a.scene.yaml"].replace("on: on", "on: zz").replace("  on: {shape", "  zz: {shape")


def test_an_excluded_document_is_changed_only_if_others_use_it(tmp_path: Path) -> None:
    files = FILES | {
        "simfoundry.yaml": "exclude: [cabinet.asset.yaml, old]\n",
        "old/old.scene.yaml": "simfoundry: scene/1\nextends: ../desk.scene.yaml\nname: old\n"
        "objects: {mug: {mass: 1}}\n",
    }
    (tmp_path / "old").mkdir()
    folder = write_project(tmp_path, files)
    assert "cabinet.asset.yaml" in _after(plan_rename(folder / "desk.scene.yaml", "commode.slide", "zz"))
    plan = plan_rename(folder / "desk.scene.yaml", "mug", "zz")
    assert "old.scene.yaml" not in _after(plan)
    assert any("excluded" in note and "old.scene.yaml" in note for note in plan.notes)


def test_links_to_documents_are_followed_and_links_out_of_the_project_refused(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    files = {name: text for name, text in FILES.items() if name != "vary.cousins.yaml"}
    folder = write_project(tmp_path / "project", files)
    (folder / "again.scene.yaml").symlink_to("desk.scene.yaml")
    edits = plan_rename(folder / "again.scene.yaml", "mug", "zz").edits
    assert [edit.file.name for edit in edits].count("desk.scene.yaml") == 1
    assert "again.scene.yaml" not in {edit.file.name for edit in edits}
    outside = tmp_path / "elsewhere" / "lone.scene.yaml"
    outside.write_text("simfoundry: scene/1\nextends: desk.scene.yaml\nname: lone\nobjects: {mug: {mass: 1}}\n")
    (folder / "lone.scene.yaml").symlink_to(outside)
    assert "lone.scene.yaml: this document contains `mug`, but it is a link out of the project" in _refused(
        folder, "desk.scene.yaml", "mug", "zz"
    )
    (folder / "loop.scene.yaml").symlink_to("loop.scene.yaml")
    (folder / "folder.scene.yaml").mkdir()
    assert plan_rename(folder / "desk.scene.yaml", "bowl", "zz").edits


def test_a_policy_for_several_scenes_stays_and_is_listed(tmp_path: Path) -> None:
    camera = "cameras: {portrait: {size: [64, 48], fov_deg: 60, pose: {xyz: [-1, 0, 1], look_at: [0, 0, 0]}}}\n"
    files = FILES | {"alone.scene.yaml": f"simfoundry: scene/1\nname: alone\nobjects: {{}}\n{camera}"}
    plan = plan_rename(write_project(tmp_path, files) / "desk.scene.yaml", "portrait", "zz")
    assert "pi.policy.yaml" not in _after(plan)
    assert any("pi.policy.yaml:8:31" in note for note in plan.notes)
    back = plan_rename(tmp_path / "desk.scene.yaml", "bird", "portrait2")
    assert list(_after(back)) == ["desk.scene.yaml", "evening.scene.yaml"]


def test_patterns_of_recipes_that_stand_for_other_values_are_listed(tmp_path: Path) -> None:
    files = FILES | {"vary.cousins.yaml": VARY.replace("camera.*.fov_deg", "camera.*r*.fov_deg")}
    desk = write_project(tmp_path, files) / "desk.scene.yaml"
    (note,) = [each for each in plan_rename(desk, "bird", "view").notes if "patterns" in each]
    assert note.endswith("vary.cousins.yaml: camera.*r*.fov_deg")
    assert not [each for each in plan_rename(desk, "bird", "crow").notes if "patterns" in each]


def test_paths_and_names_in_allow_follow(tmp_path: Path) -> None:
    text = (
        FILES["desk.scene.yaml"] + "allow:\n  SF402: {objects.mug.mass: heavy, mug: heavy, 'materials.clay': dense}\n"
    )
    over = FILES["hall.scene.yaml"] + "allow:\n  SF402: {west_mug: heavy, objects.west_mug.mass: heavy}\n"
    folder = write_project(tmp_path, FILES | {"desk.scene.yaml": text, "hall.scene.yaml": over})
    after = _after(plan_rename(folder / "desk.scene.yaml", "mug", "zz"))
    assert "{objects.zz.mass: heavy, zz: heavy, 'materials.clay': dense}" in after["desk.scene.yaml"]
    assert "{west_zz: heavy, objects.west_zz.mass: heavy}" in after["hall.scene.yaml"]
    after = _after(plan_rename(folder / "desk.scene.yaml", "materials.clay", "zz"))
    assert "'materials.zz': dense" in after["desk.scene.yaml"]


def test_a_base_may_use_what_only_its_overlay_defines(tmp_path: Path) -> None:
    files = {
        "simfoundry.yaml": "",
        "base.scene.yaml": "simfoundry: scene/1\nname: base\nobjects:\n"
        "  cup: {shape: {sphere: 0.1}, mass: 1, place: {on: plate}}\n",
        "over.scene.yaml": "simfoundry: scene/1\nextends: base.scene.yaml\nname: over\nobjects:\n"
        "  plate: {shape: {box: [1, 1, 0.1]}, fixed: true}\n",
    }
    after = _after(plan_rename(write_project(tmp_path, files) / "over.scene.yaml", "plate", "zz"))
    assert after == {name: files[name].replace("plate", "zz") for name in ("base.scene.yaml", "over.scene.yaml")}


def test_links_of_an_extended_asset_follow(tmp_path: Path) -> None:
    files = FILES | {
        "tall.asset.yaml": "simfoundry: asset/1\nextends: cabinet.asset.yaml\nname: tall\n"
        "links: {tray: {parts: {knob: {color: [1, 0, 0]}}}}\njoints: {slide: {damping: 2}}\n",
    }
    folder = write_project(tmp_path, files)
    assert (
        "links: {zz: {parts" in _after(plan_rename(folder / "lift.task.yaml", "commode.tray", "zz"))["tall.asset.yaml"]
    )
    assert "{zz: {color" in _after(plan_rename(folder / "cabinet.asset.yaml", "tray.knob", "zz"))["tall.asset.yaml"]
    assert "joints: {zz: " in _after(plan_rename(folder / "tall.asset.yaml", "slide", "zz"))["tall.asset.yaml"]
