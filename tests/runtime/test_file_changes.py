"""A change of files is noticed once, when they have been written completely."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from simfoundry.runtime import file_changes
from simfoundry.runtime.file_changes import Stamp, file_stamp, folder_stamps, wait_for_change


def test_stamps_tell_written_files_apart(tmp_path: Path) -> None:
    (tmp_path / "stages").mkdir()
    (tmp_path / "a" / "stages").mkdir(parents=True)
    paths = [tmp_path / "masks.png", tmp_path / "a" / "stages" / "b.yaml"]
    for path in (*paths, tmp_path / "stages" / "c"):
        path.write_bytes(b"1")
    before = folder_stamps(tmp_path, ("stages",))
    assert set(before) == set(paths)
    os.utime(paths[0], ns=(0, 0))
    paths[1].unlink()
    assert folder_stamps(tmp_path, ("stages",)) == {paths[0]: file_stamp(paths[0])} != before
    assert file_stamp(paths[1]) == () and folder_stamps(tmp_path / "none") == {}


def test_waiting_ends_when_nothing_is_written_any_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(file_changes, "INTERVAL_S", 0.0)
    written: list[Stamp] = [(1, 1, 1), (1, 1, 1), (1, 2, 2), (1, 3, 3), (1, 3, 3)]
    undone: list[Stamp] = [(1, 2, 2), (1, 1, 1), (1, 1, 1), (), ()]
    for stamps, last in ((written, (1, 3, 3)), (undone, ())):
        assert wait_for_change(looks_at(stamps), {MASKS: (1, 1, 1)}) == {MASKS: last}


MASKS = Path("masks.png")


def looks_at(stamps: list[Stamp]) -> Callable[[], dict[Path, Stamp]]:
    """Return a function that sees one stamp of a file after the other."""
    left = iter(stamps)
    return lambda: {MASKS: next(left)}
