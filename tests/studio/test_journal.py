"""Journals: what was not saved when a session ended can be restored by the next one."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from simfoundry.errors import SimfoundryError
from simfoundry.studio.acts.names import RenameSymbol
from simfoundry.studio.acts.properties import SetProperties
from simfoundry.studio.journal import FILE, SLOTS, Journal, state_folder
from simfoundry.studio.marks import ObjectMarks, read_marks, write_marks
from simfoundry.studio.session import StudioSession
from tests.studio.conftest import SCENE, TASK


def opened(path: Path) -> tuple[StudioSession, Journal]:
    """Open a session with a journal."""
    session = StudioSession(path)
    return session, Journal(session)


def files() -> list[Path]:
    """Return the journals that contain something."""
    return [path for path in state_folder().rglob(FILE) if path.stat().st_size]


def test_unsaved_acts_are_restored_with_their_history(desk: Path) -> None:
    session, journal = opened(desk)
    for mass in (0.31, 0.32, 0.33):
        session.apply(SetProperties("mug", {"mass": mass}), "mass")
    session.end_gesture()
    session.apply(RenameSymbol("mug", "beaker"))
    session.apply(SetProperties("tray", {"mass": 0.6}))
    session.undo()
    before = session.text, session.history.labels, session.redo_label
    journal.close()  # a killed process does no more than that

    again, kept = opened(desk)
    assert again.text == SCENE and not again.is_modified
    (state,) = kept.unsaved
    assert state.history.labels == ("set mass of mug", "rename mug to beaker")
    kept.restore(state)
    assert (again.text, again.history.labels, again.redo_label) == before and kept.unsaved == ()
    again.redo()
    assert "mass: 0.6" in again.text
    for _ in range(3):
        again.undo()
    assert again.text == SCENE and files() == []


def test_a_journal_is_empty_once_everything_is_saved(desk: Path) -> None:
    session, journal = opened(desk)
    session.apply(SetProperties("mug", {"mass": 0.25}))
    assert len(files()) == 1
    session.save()
    assert files() == []
    session.undo()  # an unsaved edit again, whose history reaches back beyond the save
    journal.close()
    again, kept = opened(desk)
    kept.restore(kept.unsaved[0])
    assert again.text == SCENE and again.redo() and "mass: 0.25" in again.text


def test_changes_on_disk_since_are_merged(desk: Path) -> None:
    session, journal = opened(desk)
    session.apply(SetProperties("mug", {"mass": 0.25}))
    journal.close()
    desk.write_text(SCENE.replace("mass: 0.5", "mass:   0.6  # weighed"))
    again, kept = opened(desk)
    kept.restore(kept.unsaved[0])
    assert again.text == SCENE.replace("mass: 0.5", "mass:   0.6  # weighed").replace("mass: 0.3", "mass: 0.25")
    assert desk.read_text() == SCENE.replace("mass: 0.5", "mass:   0.6  # weighed")


def test_conflicts_are_asked_again(desk: Path) -> None:
    session, journal = opened(desk)
    session.apply(SetProperties("mug", {"mass": 0.25}))
    desk.write_text(SCENE.replace("mass: 0.3", "mass: 0.4"))
    session.poll()
    assert len(session.questions) == 1
    journal.close()
    again, kept = opened(desk)
    kept.restore(kept.unsaved[0])
    assert [str(question) for question in again.questions] == [str(question) for question in session.questions]


def test_all_documents_are_restored(task: Path) -> None:
    session, journal = opened(task)
    session.apply(RenameSymbol("mug", "beaker"))
    journal.close()
    again, kept = opened(task)
    assert (again.text, again.is_modified) == (TASK, False)
    kept.restore(kept.unsaved[0])
    assert again.texts == session.texts and again.is_modified


def test_edits_made_meanwhile_are_not_replaced(desk: Path) -> None:
    session, journal = opened(desk)
    session.apply(SetProperties("mug", {"mass": 0.25}))
    journal.close()
    again, kept = opened(desk)
    again.apply(SetProperties("tray", {"mass": 0.7}))
    with pytest.raises(SimfoundryError, match="save or undo the edits made here"):
        kept.restore(kept.unsaved[0])
    kept.close()
    third, both = opened(desk)  # both are still there
    assert {state.history.labels for state in both.unsaved} == {("set mass of mug",), ("set mass of tray",)}
    for state in both.unsaved:
        both.discard(state)
    both.close()
    assert files() == [] and opened(desk)[1].unsaved == ()
    assert third.text == SCENE


def test_the_journal_of_a_running_studio_is_not_offered(desk: Path) -> None:
    session, journal = opened(desk)
    session.apply(SetProperties("mug", {"mass": 0.25}))
    other, second = opened(desk)
    assert second.unsaved == ()
    other.apply(SetProperties("mug", {"mass": 0.26}))
    journal.close()
    second.close()
    assert sorted(len(state.texts) for state in opened(desk)[1].unsaved) == [1, 1]


def test_documents_outside_of_the_project_are_not_restored(desk: Path, tmp_path: Path) -> None:
    session, journal = opened(desk)
    session.apply(SetProperties("mug", {"mass": 0.25}))
    journal.close()
    (path,) = files()
    outside = str(tmp_path.parent / "outside_of_the_journal.scene.yaml")
    path.write_text(path.read_text().replace(str(desk.resolve()), outside))
    again, kept = opened(desk)
    with pytest.raises(SimfoundryError, match="outside of the project"):
        kept.restore(kept.unsaved[0])
    assert again.text == SCENE and not Path(outside).exists()


def test_a_line_that_was_cut_off_ends_the_journal(desk: Path) -> None:
    session, journal = opened(desk)
    session.apply(SetProperties("mug", {"mass": 0.25}))
    first = session.text
    session.apply(SetProperties("mug", {"mass": 0.26}))
    journal.close()
    (path,) = files()
    path.write_bytes(path.read_bytes()[:-5])
    again, kept = opened(desk)
    kept.restore(kept.unsaved[0])
    assert again.text == first and again.history.labels == ("set mass of mug",)


@pytest.mark.parametrize(
    "line", [b"[]\n", b"{\n", b'{"files": 3}\n', b'{"done": [0, [[1]]]}\n', b"\xff\n", b"[" * 9999 + b"\n"]
)
def test_a_damaged_journal_is_ignored(desk: Path, line: bytes) -> None:
    opened(desk)[1].close()
    (path,) = state_folder().rglob(FILE)
    path.write_bytes(line)
    assert opened(desk)[1].unsaved == ()


def test_without_a_folder_the_studio_works_and_says_so(desk: Path, state_folder: Path) -> None:
    shutil.rmtree(state_folder)
    state_folder.write_text("in the way")
    session, journal = opened(desk)
    assert "not kept if the studio is killed" in journal.problem
    session.apply(SetProperties("mug", {"mass": 0.25}))
    state_folder.unlink()
    state_folder.mkdir()


def test_more_studios_than_journals(desk: Path) -> None:
    every = [opened(desk) for _ in range(SLOTS + 1)]
    assert [bool(journal.problem) for _, journal in every] == [False] * SLOTS + [True]


def test_locked_and_hidden_objects_stay_so_in_the_next_studio(desk: Path, state_folder: Path) -> None:
    path = desk.resolve()
    assert read_marks(path) == ObjectMarks()
    marks = ObjectMarks(frozenset({"mug", "größe"}), frozenset({"tray"}))
    write_marks(path, marks)
    assert read_marks(path) == marks and read_marks(desk.with_name("other.scene.yaml")) == ObjectMarks()
    (file,) = state_folder.rglob("marks.json")
    for damaged in (b"", b"[]", b'{"locked": 3, "hidden": []}', b"\xff", b"[" * 100_000):
        file.write_bytes(damaged)
        assert read_marks(path) == ObjectMarks()
    write_marks(path, ObjectMarks())
    assert not file.exists()
