"""Files and folders are replaced whole or not at all."""

from __future__ import annotations

import errno
import os
import signal
import time
from pathlib import Path
from unittest import mock

import pytest

from simfoundry.errors import OutputError
from simfoundry.runtime import files
from simfoundry.runtime.files import (
    STALE_S,
    replace_folder,
    staged,
    strangers,
    write_all_in_place,
    write_atomically,
    write_files,
)
from tests.cli.command import python


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


def test_several_files_are_replaced_together_or_not_at_all(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("a", "b", "c")]
    for path in paths:
        path.write_text("old")
    new = dict.fromkeys(paths, (b"old", b"new"))
    real = os.replace

    def failing(source: Path, target: Path) -> None:
        if target == paths[2]:
            raise OSError(errno.ENOSPC, "full")
        real(source, target)

    with mock.patch.object(os, "replace", failing), pytest.raises(OSError):
        write_all_in_place(new)
    assert content(tmp_path) == dict.fromkeys("abc", "old")
    paths[1].write_text("edited")
    with pytest.raises(OutputError, match="has changed in the meantime"):
        write_all_in_place(new)
    assert content(tmp_path) == {"a": "old", "b": "edited", "c": "old"}
    write_all_in_place(new | {paths[1]: (b"edited", b"new")})
    assert content(tmp_path) == dict.fromkeys("abc", "new")


@pytest.mark.parametrize("exchange", [True, False], ids=["one step", "two renames"])
def test_a_folder_takes_the_place_of_another(tmp_path: Path, exchange: bool) -> None:
    old, new = folder(tmp_path / "out", a="1", b="2"), folder(tmp_path / "new", a="3")
    original = files._exchange
    with mock.patch.object(files, "_exchange", original if exchange else lambda a, b: False):
        replace_folder(new, old)
    assert content(tmp_path) == {"out/a": "3", "new/a": "1", "new/b": "2"}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["new", "out"]
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


def test_a_new_run_clears_what_killed_ones_left(tmp_path: Path) -> None:
    killed, making = tmp_path / ".out.new.killed", tmp_path / ".out.making.recent"
    kept = tmp_path / ".out.old.kept"  # the good output of a run killed between two renames
    other = tmp_path / ".outer.new.other"  # of another folder
    for place in (killed, making, kept, other):
        folder(place, file="x")
    with staged(tmp_path / "out") as alive:
        (alive / "file").write_text("first")
        with staged(tmp_path / "out") as staging:
            (staging / "file").write_text("second")
        assert (alive / "file").read_text() == "first"  # of a run that lives nothing is touched
    assert (tmp_path / "out" / "file").read_text() == "first"
    left = [".out.making.recent", ".out.old.kept", ".outer.new.other", "out"]
    assert sorted(p.name for p in tmp_path.iterdir()) == left


def test_a_killed_process_leaves_nothing_to_the_next(tmp_path: Path) -> None:
    folder(tmp_path / "out", a="old")
    program = (
        "import os, signal, sys; from pathlib import Path; from simfoundry.runtime.files import staged\n"
        "with staged(Path(sys.argv[1])) as s:\n"
        "    (s / 'a').write_text('half'); os.kill(os.getpid(), signal.SIGKILL)"
    )
    assert python(program, tmp_path / "out").code == -signal.SIGKILL
    assert len(list(tmp_path.glob(".out.new.*"))) == 1 and content(tmp_path / "out") == {"a": "old"}
    with staged(tmp_path / "out") as staging:
        assert list(tmp_path.glob(".out.new.*")) == [staging]
        (staging / "a").write_text("new")
    assert content(tmp_path) == {"out/a": "new"}


def test_where_folders_cannot_be_locked_age_decides(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    old, recent = folder(tmp_path / ".out.new.old", a="x"), folder(tmp_path / ".out.new.recent", a="x")
    long_ago = time.time() - STALE_S - 60
    os.utime(old, (long_ago, long_ago))
    monkeypatch.setattr(files, "_lock", lambda _: None)
    with staged(tmp_path / "out") as staging:
        (staging / "a").write_text("new")
    assert sorted(p.name for p in tmp_path.iterdir()) == [recent.name, "out"]


def test_files_are_written_below_a_folder(tmp_path: Path) -> None:
    write_files(tmp_path / "new", {"a": b"1", "b/c/d": b"2", "b/e": b"3"})
    assert content(tmp_path) == {"new/a": "1", "new/b/c/d": "2", "new/b/e": "3"}


def test_a_block_that_fails_leaves_the_folder_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "file").write_text("old")
    with pytest.raises(KeyError), staged(tmp_path / "out") as staging:
        (staging / "file").write_text("half")
        raise KeyError
    assert (tmp_path / "out" / "file").read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
