"""Files and folders are replaced whole or not at all."""

from __future__ import annotations

import errno
import os
import time
from pathlib import Path
from unittest import mock

import pytest

from simfoundry import files
from simfoundry.files import STALE_S, replace_folder, staged, strangers, write_atomically


def folder(path: Path, **content: str) -> Path:
    path.mkdir(parents=True)
    for name, text in content.items():
        (path / name).write_text(text)
    return path


def content(path: Path) -> dict[str, str]:
    return {str(p.relative_to(path)): p.read_text() for p in sorted(path.rglob("*")) if p.is_file()}


def test_a_file_is_written_with_its_folders(tmp_path: Path) -> None:
    write_atomically(tmp_path / "a" / "b.txt", b"new")
    assert (tmp_path / "a" / "b.txt").read_bytes() == b"new"
    assert (tmp_path / "a" / "b.txt").stat().st_mode & 0o777 == 0o644
    assert [p.name for p in (tmp_path / "a").iterdir()] == ["b.txt"]


def test_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    file = tmp_path / "a.txt"
    file.write_text("old")
    with mock.patch.object(os, "replace", side_effect=OSError(errno.EIO, "broken")), pytest.raises(OSError):
        write_atomically(file, b"new")
    assert content(tmp_path) == {"a.txt": "old"}


@pytest.mark.parametrize("exchange", [True, False], ids=["one step", "two renames"])
def test_a_folder_takes_the_place_of_another(tmp_path: Path, exchange: bool) -> None:
    old, new = folder(tmp_path / "out", a="1", b="2"), folder(tmp_path / "new", a="3")
    original = files._exchange
    with mock.patch.object(files, "_exchange", original if exchange else lambda a, b: False):
        replace_folder(new, old)
    assert content(tmp_path) == {"out/a": "3"}
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    assert old.stat().st_mode & 0o777 == 0o755


@pytest.mark.parametrize("failing", [1, 2], ids=["putting aside", "putting in place"])
def test_a_failed_replacement_leaves_the_old_folder(tmp_path: Path, failing: int) -> None:
    old, new = folder(tmp_path / "out", a="1"), folder(tmp_path / "new", a="3")
    real, calls = os.replace, []

    def replace(source: Path, target: Path) -> None:
        calls.append(source)
        if len(calls) == failing:
            raise OSError(errno.EIO, "broken")
        real(source, target)

    with (
        mock.patch.object(files, "_exchange", lambda a, b: False),
        mock.patch.object(os, "replace", replace),
        pytest.raises(OSError),
    ):
        replace_folder(new, old)
    assert content(tmp_path) == {"new/a": "3", "out/a": "1"}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["new", "out"]


def test_strangers(tmp_path: Path) -> None:
    out = folder(tmp_path / "out", a="1", b="2")
    folder(out / "meshes", cup="3", plate="4")
    folder(out / "__pycache__", load="5")
    assert strangers(out, ["a", "meshes/cup"]) == ["b", "meshes/plate"]
    (out / "link").symlink_to(tmp_path)
    assert strangers(out, ["a", "b", "meshes/cup", "meshes/plate"]) == ["link"]


def test_a_new_run_clears_what_killed_ones_left_long_ago(tmp_path: Path) -> None:
    old, recent = tmp_path / ".out.new.old", tmp_path / ".out.new.recent"
    kept = tmp_path / ".out.old.kept"  # the good output of a run killed between two renames
    for folder in (old, recent, kept):
        folder.mkdir()
        (folder / "file").write_text("x")
    long_ago = time.time() - STALE_S - 60
    for folder in (old, kept):
        os.utime(folder, (long_ago, long_ago))
    with staged(tmp_path / "out") as staging:
        (staging / "file").write_text("new")
    assert (tmp_path / "out" / "file").read_text() == "new"
    assert sorted(p.name for p in tmp_path.iterdir()) == [".out.new.recent", ".out.old.kept", "out"]


def test_a_block_that_fails_leaves_the_folder_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "file").write_text("old")
    with pytest.raises(KeyError), staged(tmp_path / "out") as staging:
        (staging / "file").write_text("half")
        raise KeyError
    assert (tmp_path / "out" / "file").read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
