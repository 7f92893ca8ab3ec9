"""``simfoundry fmt``: what it writes, what it leaves, and what it says."""

from __future__ import annotations

import io
import sys
from pathlib import Path
from unittest import mock

import pytest

from tests.cli.command import Done, run
from tests.spec.change.test_format_layout import EIGHT_OBJECTS

TIDY = "simfoundry: scene/1\nname: a  # why\n"
UNTIDY = "name:   a #why\r\nsimfoundry: scene/1"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / ".hidden").mkdir()
    (tmp_path / "deep").mkdir()
    for name in ("deep/a.scene.yaml", ".hidden/b.scene.yaml", "notes.yaml"):
        (tmp_path / name).write_bytes(UNTIDY.encode())
    (tmp_path / "tidy.scene.yaml").write_text(TIDY)
    return tmp_path


def texts(folder: Path) -> dict[str, str]:
    files = (p for p in folder.rglob("*.yaml"))
    return {p.relative_to(folder).as_posix(): p.read_bytes().decode() for p in files}


def piped(text: bytes, *args: str) -> Done:
    with mock.patch.object(sys, "stdin", io.TextIOWrapper(io.BytesIO(text))):
        return run("fmt", "-", *args)


def test_it_writes_what_is_not_in_form_and_nothing_else(folder: Path) -> None:
    before = (folder / "tidy.scene.yaml").stat().st_mtime_ns
    done = run("fmt")
    assert (done.code, done.err) == (0, "")
    assert done.out == "wrote deep/a.scene.yaml\n2 documents: 1 changed\n"
    written = {"deep/a.scene.yaml": TIDY, "tidy.scene.yaml": TIDY}
    assert texts(folder) == {".hidden/b.scene.yaml": UNTIDY, "notes.yaml": UNTIDY, **written}
    assert (folder / "tidy.scene.yaml").stat().st_mtime_ns == before
    assert run("fmt").out == "2 documents: none changed\n"


def test_files_that_are_named_are_formatted_whatever_they_are_called(folder: Path) -> None:
    assert run("fmt", "notes.yaml", ".hidden", "notes.yaml").out.count("wrote ") == 2
    assert texts(folder)["notes.yaml"] == texts(folder)[".hidden/b.scene.yaml"] == TIDY


def test_a_folder_above_is_searched_too(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder / "deep")
    assert "2 documents: 1 changed" in run("fmt", "..").out
    assert "2 documents" in run("check", "..").out


def test_check_writes_nothing_and_gives_1(folder: Path) -> None:
    before = texts(folder)
    done = run("fmt", "--check", "deep", "tidy.scene.yaml")
    assert (done.code, done.out) == (
        1,
        "would change deep/a.scene.yaml\n2 documents: 1 would change; `--diff` shows how\n",
    )
    assert texts(folder) == before
    assert run("fmt", "--check", "tidy.scene.yaml").code == 0


def test_diff_writes_nothing_and_shows_the_change(folder: Path) -> None:
    before = texts(folder)
    done = run("fmt", "--diff")
    assert done.code == 0 and texts(folder) == before
    assert "--- deep/a.scene.yaml\n+++ deep/a.scene.yaml (formatted)\n" in done.out
    assert "+name: a  # why\n" in done.out and "tidy" not in done.out
    assert run("fmt", "--diff", "--check").code == 1
    assert run("fmt", "--diff", "tidy.scene.yaml").out == ""


@pytest.mark.usefixtures("folder")
def test_json_says_what_changed() -> None:
    done = run("fmt", "--check", "--diff", "--json")
    assert done.code == 1 and done.err == ""
    assert done.json["files"] == ["deep/a.scene.yaml", "tidy.scene.yaml"]
    assert done.json["changed"] == ["deep/a.scene.yaml"] and done.json["findings"] == []
    assert list(done.json["diffs"]) == ["deep/a.scene.yaml"]
    assert run("fmt", "--json").json.keys() == {"files", "changed", "findings"}


def test_what_cannot_be_read_is_reported_and_left_and_the_others_are_written(folder: Path) -> None:
    (folder / "bad.scene.yaml").write_text("simfoundry: scene/1\na: [\n")
    (folder / "twice.scene.yaml").write_text("simfoundry: scene/1\na: 1\na: 2\n")
    before = texts(folder)
    done = run("fmt")
    assert done.code == 2
    done.one_line("bad.scene.yaml:3:", "error[SF002]")
    done.one_line("twice.scene.yaml:3:1", "error[SF003]")
    assert texts(folder) == {**before, "deep/a.scene.yaml": TIDY}
    as_json = run("fmt", "--json")
    assert as_json.code == 2 and as_json.err == ""
    assert [f["code"] for f in as_json.json["findings"]] == ["SF002", "SF003"]


def test_a_scene_that_is_written_on_few_lines_stays_on_them(tmp_path: Path) -> None:
    path = tmp_path / "breakfast.scene.yaml"
    path.write_text(EIGHT_OBJECTS)
    assert run("fmt", path).out == "1 document: none changed\n" and path.read_text() == EIGHT_OBJECTS
    assert run("check", path).code == 0


def test_it_writes_through_links_and_keeps_rights(folder: Path) -> None:
    target = folder / "deep" / "a.scene.yaml"
    target.chmod(0o600)
    (folder / "link.scene.yaml").symlink_to(target)
    assert run("fmt", "link.scene.yaml").code == 0
    assert (folder / "link.scene.yaml").is_symlink() and target.read_text() == TIDY
    assert target.stat().st_mode & 0o777 == 0o600


def test_a_stream_is_formatted_to_a_stream() -> None:
    assert piped(UNTIDY.encode()) == Done(0, TIDY, "")
    assert piped(UNTIDY.encode(), "--check") == Done(1, "", "")
    assert piped(TIDY.encode(), "--check") == Done(0, "", "")
    assert "+name: a  # why\n" in piped(UNTIDY.encode(), "--diff").out
    bad = piped(b"a: [")
    assert bad.code == 2 and bad.out == "" and "<stdin>:" in bad.err and "SF002" in bad.err
    assert "SF001" in piped(b"a: \xff").err
    assert piped(b"", "--json").code == run("fmt", "-", "x.scene.yaml").code == 2


def test_wrong_calls_say_why(tmp_path: Path) -> None:
    assert "does not exist" in run("fmt", tmp_path / "x.scene.yaml").err
    assert "could not find any documents below" in run("fmt", tmp_path).err
