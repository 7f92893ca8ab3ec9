"""Writing files and folders in one step, so that a killed run leaves what was there whole."""

from __future__ import annotations

import ctypes
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

BYSTANDERS = ("__pycache__", ".DS_Store", "MUJOCO_LOG.TXT")
"""What programs leave in a folder by the way; nobody misses it."""

STALE_S = 3600.0
"""No run takes this long to fill a folder [s]."""


def write_atomically(path: Path, data: bytes) -> None:
    """Write a file in one step."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, staging = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
        Path(staging).chmod(0o644)
        os.replace(staging, path)
    except BaseException:
        Path(staging).unlink(missing_ok=True)
        raise


@contextmanager
def staged(folder: Path) -> Iterator[Path]:
    """A new folder to fill beside ``folder``, whose place it takes when the block ends well, and goes otherwise.

    What runs that were killed left there more than ``STALE_S`` ago goes too.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    for left in folder.parent.glob(f".{folder.name}.new.*"):
        if time.time() - left.stat().st_mtime > STALE_S:
            shutil.rmtree(left, ignore_errors=True)
    staging = Path(tempfile.mkdtemp(prefix=f".{folder.name}.new.", dir=folder.parent))
    try:
        yield staging
        replace_folder(staging, folder)
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def replace_folder(new: Path, folder: Path) -> None:
    """Put the folder ``new`` in the place of ``folder``; both lie on one file system.

    In one step where the system can exchange two names; elsewhere a kill between two renames leaves the old folder
    beside its place, in ``.NAME.old.*``.
    """
    new.chmod(0o755)
    if not folder.exists():
        os.replace(new, folder)
        return
    if _exchange(new, folder):
        shutil.rmtree(new, ignore_errors=True)
        return
    aside = Path(tempfile.mkdtemp(prefix=f".{folder.name}.old.", dir=folder.parent))
    try:
        os.replace(folder, aside / folder.name)
        os.replace(new, folder)
    except OSError:
        if (aside / folder.name).exists():
            os.replace(aside / folder.name, folder)
        aside.rmdir()
        raise
    shutil.rmtree(aside, ignore_errors=True)


def strangers(folder: Path, written: Iterable[str]) -> list[str]:
    """Files in ``folder`` that are not among those ``written`` there, by relative POSIX path, sorted."""
    known = set(written)
    files = (p.relative_to(folder) for p in folder.rglob("*") if p.is_symlink() or not p.is_dir())
    return sorted(p.as_posix() for p in files if p.as_posix() not in known and not set(p.parts) & set(BYSTANDERS))


def _exchange(a: Path, b: Path) -> bool:
    """Exchange two names in one step; False where the system or the file system cannot."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except AttributeError:  # a C library from before 2018
        return False
    here, exchange = -100, 2  # AT_FDCWD and RENAME_EXCHANGE of renameat2(2)
    return int(rename(here, os.fsencode(a), here, os.fsencode(b), exchange)) == 0
