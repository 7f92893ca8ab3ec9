"""Notice that other programs changed files, by their sizes and times."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Collection, Mapping
from pathlib import Path

# Inode number, size and time of modification [ns] of a file; empty if the file is missing.
Stamp = tuple[int, ...]

# Time [s] between two looks at the files. A program that saves one of them has finished writing by the next look.
INTERVAL_S = 0.2


def file_stamp(path: Path) -> Stamp:
    """Return the stamp of a file, which changes whenever the file is written."""
    try:
        found = path.stat()
    except OSError:
        return ()
    return found.st_ino, found.st_size, found.st_mtime_ns


def folder_stamps(folder: Path, ignored: Collection[str] = ()) -> dict[Path, Stamp]:
    """Return the stamps of the files below a folder, except for those in its subfolders ``ignored``."""
    found: dict[Path, Stamp] = {}
    for parent, folders, names in os.walk(folder):
        if Path(parent) == folder:
            folders[:] = [name for name in folders if name not in ignored]
        found |= {Path(parent, name): file_stamp(Path(parent, name)) for name in names}
    return found


def wait_for_change(look: Callable[[], Mapping[Path, Stamp]], before: Mapping[Path, Stamp]) -> dict[Path, Stamp]:
    """Wait until files have changed and then stay unchanged for :data:`INTERVAL_S`, and return their new stamps.

    ``look`` returns the current stamps.
    """
    last = dict(before)
    while True:
        time.sleep(INTERVAL_S)
        now = dict(look())
        if now == last and now != before:
            return now
        last = now
