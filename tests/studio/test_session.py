"""Sessions: acts, undo, saving, and changes of files on disk."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Pose
from simfoundry.spec.yaml.text import MAX_BYTES
from simfoundry.studio.acts.act import ActError
from simfoundry.studio.acts.move import MoveObject
from simfoundry.studio.acts.names import RenameSymbol
from simfoundry.studio.acts.properties import SetProperties
from simfoundry.studio.session import FROM_DISK, StudioSession
from tests.conftest import REPOSITORY
from tests.studio.conftest import SCENE, TASK


def changed_lines(before: str, after: str) -> list[tuple[str, str]]:
    """Return the pairs of lines that differ; both texts have the same number of lines."""
    pairs = zip(before.splitlines(), after.splitlines(), strict=True)
    return [(old.strip(), new.strip()) for old, new in pairs if old != new]


def test_an_act_changes_one_line_and_undo_restores_every_byte(desk: Path) -> None:
    session = StudioSession(desk)
    session.apply(SetProperties("mug", {"mass": 0.25}))
    assert changed_lines(SCENE, session.text) == [("mass: 0.3", "mass: 0.25")]
    assert desk.read_text() == SCENE
    assert session.undo() == "set mass of mug"
    assert session.text == SCENE and not session.is_modified
    assert session.redo() == "set mass of mug" and "mass: 0.25" in session.text
    assert session.redo() == "" and session.undo() and session.undo() == ""


def test_undo_and_redo_reach_across_saves(desk: Path) -> None:
    session = StudioSession(desk)
    session.apply(SetProperties("mug", {"mass": 0.25}))
    assert session.save() == (desk.resolve(),)
    first = desk.read_text()
    session.apply(SetProperties("tray", {"friction": 0.7}))
    session.save()
    assert session.save() == ()
    session.undo()
    session.undo()
    assert session.text == SCENE and session.is_modified
    session.save()
    assert desk.read_text() == SCENE
    session.redo()
    assert session.text == first


def test_the_diff_is_what_saving_writes(desk: Path) -> None:
    session = StudioSession(desk)
    assert session.diff() == ""
    session.apply(SetProperties("mug", {"mass": 0.25}))
    assert "-    mass: 0.3\n+    mass: 0.25\n" in session.diff()
    assert len(session.diff().splitlines()) == 7  # so few that the panel shows them without scrolling
    session.save()
    assert session.diff() == ""


def test_an_act_that_would_cause_an_error_changes_nothing(desk: Path) -> None:
    session = StudioSession(desk)
    with pytest.raises(ActError, match=r"desk.scene.yaml:\d+:\d+: .*granite"):
        session.apply(SetProperties("mug", {"material": "granite"}))
    with pytest.raises(ActError, match="no object `cup`"):
        session.apply(SetProperties("cup", {"mass": 1.0}))
    with pytest.raises(ActError, match="greater than 0"):
        session.apply(SetProperties("mug", {"mass": -1.0}))
    assert session.text == SCENE and session.undo_label == ""
    session.apply(SetProperties("mug", {"mass": 1.0}))  # and the next act is possible


def test_acts_of_one_gesture_are_undone_together(desk: Path) -> None:
    session = StudioSession(desk)
    for mass in (0.31, 0.32, 0.33):
        session.apply(SetProperties("mug", {"mass": mass}), "mass")
    session.end_gesture()
    session.apply(SetProperties("mug", {"mass": 0.4}), "mass")
    assert len(session.history.labels) == 2
    session.undo()
    assert "mass: 0.33" in session.text
    session.undo()
    assert session.text == SCENE


def test_a_rename_reaches_the_task_and_both_are_saved_together(task: Path) -> None:
    session = StudioSession(task)
    session.apply(RenameSymbol("mug", "beaker"))
    session.save()
    assert task.read_text() == TASK.replace("mug,", "beaker,").replace("    mug:", "    beaker:")
    scene = task.with_name("desk.scene.yaml").read_text()
    assert scene == SCENE.replace("mug:", "beaker:").replace("OnTop(mug", "OnTop(beaker")
    session.undo()
    session.save()
    assert (task.read_text(), task.with_name("desk.scene.yaml").read_text()) == (TASK, SCENE)


def test_a_rename_uses_texts_that_are_not_saved(desk: Path) -> None:
    session = StudioSession(desk)
    session.apply(RenameSymbol("mug", "beaker"))
    session.apply(RenameSymbol("beaker", "cup"))
    assert "OnTop(cup, desk)" in session.text
    with pytest.raises(ActError, match="tray"):
        session.apply(RenameSymbol("cup", "tray"))


# -- changes on disk -------------------------------------------------------------------------------------------------


def test_a_text_without_edits_follows_its_file(desk: Path) -> None:
    session = StudioSession(desk)
    assert session.poll() is False
    desk.write_text(SCENE.replace("mass: 0.3", "mass: 0.35"))
    assert session.poll() is True and session.poll() is False
    assert "mass: 0.35" in session.text and not session.is_modified
    assert session.undo() == FROM_DISK and session.text == SCENE


def test_edits_here_and_on_disk_are_merged_in_the_layout_of_the_file(desk: Path) -> None:
    session = StudioSession(desk)
    session.apply(SetProperties("mug", {"mass": 0.25}))
    desk.write_text(SCENE.replace("mass: 0.5", "mass:   0.6  # weighed"))
    assert session.poll() and session.questions == ()
    assert session.text == SCENE.replace("mass: 0.5", "mass:   0.6  # weighed").replace("mass: 0.3", "mass: 0.25")
    session.save()
    assert desk.read_text() == session.text


def test_comments_at_renamed_objects_survive_a_merge(desk: Path) -> None:
    session = StudioSession(desk)
    session.apply(RenameSymbol("mug", "beaker"))
    edited = session.text
    desk.write_text(SCENE.replace("mass: 0.5", "mass: 0.55  # weighed"))
    session.poll()
    assert session.text == edited.replace("mass: 0.5", "mass: 0.55  # weighed") and "beaker:  # the red one" in edited


@pytest.mark.parametrize(("take_disk", "mass"), [(False, "0.25"), (True, "0.4")])
def test_a_conflict_is_a_question(desk: Path, take_disk: bool, mass: str) -> None:
    session = StudioSession(desk)
    session.apply(SetProperties("mug", {"mass": 0.25}))
    desk.write_text(SCENE.replace("mass: 0.3", "mass: 0.4"))
    session.poll()
    (question,) = session.questions
    assert str(question) == "objects.mug.mass: here 0.25, on disk 0.4, before 0.3"
    assert "mass: 0.25" in session.text and session.is_current
    with pytest.raises(SimfoundryError, match="answer the questions"):
        session.save()
    session.answer(question, take_disk)
    session.save()
    assert desk.read_text() == SCENE.replace("mass: 0.3", f"mass: {mass}")


def test_the_last_good_scene_stays_while_the_file_is_invalid(desk: Path) -> None:
    session = StudioSession(desk)
    scene = session.scene
    desk.write_text(SCENE.replace("mass: 0.3", "mass: heavy"))
    session.poll()
    assert session.scene is scene and not session.is_current
    assert [(d.code, d.line) for d in session.findings] == [("SF103", 22)]
    with pytest.raises(ActError, match="the text has an error"):
        session.apply(SetProperties("tray", {"mass": 1.0}))
    desk.write_text(SCENE.replace("mass: 0.3", "mass: 0.31"))
    session.poll()
    assert session.is_current and not session.findings


def test_a_file_that_cannot_be_merged_is_reported_until_it_can_be(desk: Path) -> None:
    session = StudioSession(desk)
    session.apply(SetProperties("mug", {"mass": 0.25}))
    edited = session.text
    desk.write_text(SCENE.replace("objects:", "objects: ["))
    session.poll()
    assert session.text == edited and session.is_current
    (finding,) = session.findings
    assert "the file on disk could not be parsed" in finding.message
    with pytest.raises(SimfoundryError, match="was not saved"):
        session.save()
    desk.write_text(SCENE)
    session.poll()
    assert session.findings == () and session.text == edited
    session.save()
    assert desk.read_text() == edited


def test_what_is_no_document_file_any_more_is_a_finding_and_nothing_is_lost(desk: Path) -> None:
    session = StudioSession(desk)
    session.apply(SetProperties("mug", {"mass": 0.4}))
    edited = session.text

    def as_pipe() -> None:
        os.mkfifo(desk)

    def too_large() -> None:
        desk.write_text(SCENE + "#" * MAX_BYTES)

    for replace, said in ((desk.mkdir, "is not a file"), (as_pipe, "is not a file"), (too_large, "the limit")):
        desk.unlink()
        replace()
        assert session.poll() and session.text == edited and not session.poll()
        assert said in session.findings[0].message and session.scene is not None
        with pytest.raises(SimfoundryError, match="was not saved"):
            session.save()
        desk.rmdir() if desk.is_dir() else desk.unlink()
        desk.write_text(SCENE)
        assert session.poll() and session.findings == () and session.text == edited
    session.save()
    assert desk.read_text() == edited


def test_a_deleted_file_is_written_again(desk: Path) -> None:
    session = StudioSession(desk)
    session.apply(SetProperties("mug", {"mass": 0.25}))
    desk.unlink()
    assert session.poll() is False
    session.save()
    assert "mass: 0.25" in desk.read_text()


def test_bytes_that_are_not_text_are_kept(desk: Path) -> None:
    session = StudioSession(desk)
    garbled = SCENE.encode().replace(b"red one", b"red \xff one")
    desk.write_bytes(garbled)
    session.poll()
    assert not session.is_current and not session.is_modified
    session.undo()
    session.redo()
    assert session.save() == () and desk.read_bytes() == garbled


def test_the_scene_of_a_task_is_followed(task: Path) -> None:
    session = StudioSession(task)
    scene = task.with_name("desk.scene.yaml")
    scene.write_text(SCENE.replace("mass: 0.3", "mass: 0.35"))
    assert session.poll()
    assert session.scene is not None
    assert session.scene.objects["mug"].root.mass == pytest.approx(0.35)


def test_line_endings_and_byte_order_marks_are_kept(desk: Path) -> None:
    marked = ("\ufeff" + SCENE.replace("\n", "\r\n")).encode()
    desk.write_bytes(marked)
    session = StudioSession(desk)
    session.apply(SetProperties("mug", {"mass": 0.25}))
    session.save()
    assert desk.read_bytes() == marked.replace(b"mass: 0.3", b"mass: 0.25")


def test_documents_outside_the_project_are_not_opened(desk: Path, tmp_path: Path) -> None:
    outside = tmp_path / "elsewhere"
    outside.mkdir()
    inner = desk.parent / "inner"
    inner.mkdir()
    shutil.copy(desk, outside / "desk.scene.yaml")
    (inner / "simfoundry.yaml").touch()
    (inner / "link.scene.yaml").symlink_to(outside / "desk.scene.yaml")
    (inner / "t.task.yaml").write_text(TASK.replace("desk.scene.yaml", "../desk.scene.yaml"))
    session = StudioSession(inner / "t.task.yaml")
    assert session.scene is None and session.findings[0].code == "SF204"


def test_only_scenes_and_tasks_are_opened(desk: Path) -> None:
    shutil.copy(REPOSITORY / "specs/assets/mug.asset.yaml", desk.parent)
    with pytest.raises(SimfoundryError, match="is not a document; the studio opens scenes and tasks"):
        StudioSession(desk.parent / "simfoundry.yaml")
    with pytest.raises(SimfoundryError, match="is of the kind `asset/1`"):
        StudioSession(desk.parent / "mug.asset.yaml")
    with pytest.raises(SimfoundryError, match="is not a file"):
        StudioSession(desk.parent)


@pytest.mark.parametrize("text", ["", "a: [", "simfoundry: scene/9\n", "- 1\n", SCENE.replace("0.3", "x"), "\x00"])
def test_an_invalid_document_is_opened_with_its_findings_and_mended_on_disk(desk: Path, text: str) -> None:
    desk.write_text(text)
    session = StudioSession(desk)
    assert session.scene is None and session.findings and not session.is_current
    with pytest.raises(ActError, match="the text has an error"):
        session.apply(SetProperties("mug", {"mass": 1.0}))
    session.examine()  # which also prepares the next act, as far as the text can be read
    desk.write_text(SCENE)
    assert session.poll() and session.is_current and session.findings == ()


def test_listeners_hear_of_each_change(desk: Path) -> None:
    session = StudioSession(desk)
    heard: list[str] = []
    stop = session.subscribe(heard.append)
    session.apply(MoveObject("ball", Pose.of((0.4, 0.2, 0.3))))
    session.undo()
    session.examine()
    stop()
    session.redo()
    assert heard[:2] == ["move ball", "move ball"] and heard[2:] in ([], ["examine"])


def test_a_folder_that_cannot_be_written_is_named_and_the_edits_stay(desk: Path) -> None:
    session = StudioSession(desk)
    session.apply(SetProperties("mug", {"mass": 0.25}))
    shutil.rmtree(desk.parent)
    desk.parent.touch()  # not even root can write below a file
    with pytest.raises(SimfoundryError, match=r"a file in .* cannot be written .*; the edits stay in the studio"):
        session.save()
    assert "mass: 0.25" in session.text and session.is_modified
    desk.parent.unlink()
    session.save()
    assert desk.read_text() == session.text
