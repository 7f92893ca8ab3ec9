"""Find the folders of a project that contain recordings or runs of cousins, so that people choose them from a list."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection
from pathlib import Path

from simfoundry.cousins.run.run import MANIFEST
from simfoundry.data.index import INDEX
from simfoundry.evaluate.statistics.sensitivity import MANIFEST_VERSION

# Number of folders that are looked into, which takes some seconds, and number of those that are listed.
MAX_SEARCHED, MAX_LISTED = 20_000, 200

# Number of bytes of a manifest in which its version is; it is the first key.
HEAD_BYTES = 4096

# Decides about a folder by its path and the names of its files and folders.
IsWanted = Callable[[Path, Collection[str], Collection[str]], bool]


def found_folders(root: Path, is_wanted: IsWanted) -> tuple[str, ...]:
    """Return the folders of a project that are wanted, the latest first, as paths relative to its root.

    Folders whose names start with a dot are skipped, links to folders are not followed, and the insides of a folder
    that is found are not searched.
    """
    found: list[tuple[float, str]] = []
    for k, (parent, folders, files) in enumerate(os.walk(root)):
        if k >= MAX_SEARCHED:
            break
        here = Path(parent)
        if here != root and is_wanted(here, files, folders):
            found.append((-here.stat().st_mtime, here.relative_to(root).as_posix()))
            folders.clear()
        folders[:] = sorted(name for name in folders if not name.startswith(".") and name != "node_modules")
    return tuple(path for _, path in sorted(found)[:MAX_LISTED])


def has_recordings(_folder: Path, files: Collection[str], folders: Collection[str]) -> bool:
    """Return True for a folder that `simfoundry eval` or `simfoundry record` has written."""
    return INDEX in files or "rollouts" in folders


def has_cousins(folder: Path, files: Collection[str], _folders: Collection[str]) -> bool:
    """Return True for a folder that `simfoundry cousins` has written."""
    if MANIFEST not in files:
        return False
    try:
        with (folder / MANIFEST).open("rb") as stream:
            return MANIFEST_VERSION.encode() in stream.read(HEAD_BYTES)
    except OSError:
        return False
