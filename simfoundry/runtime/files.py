"""Write files and folders atomically, so that an interrupted run leaves the previous version intact."""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO

from simfoundry.errors import OutputError

# Files that programs leave in a folder as a side effect; they are safe to delete.
BYSTANDERS = ("__pycache__", ".DS_Store", "MUJOCO_LOG.TXT")

# Age [s] after which a staging folder counts as abandoned on systems that cannot lock folders; no run takes this long.
STALE_S = 3600.0

# Permissions of new files: readable by everyone, as with the usual umask of 022.
NEW_FILE_MODE = 0o644


def write_atomically(path: Path, data: bytes) -> None:
    """Write a file atomically."""
    with writing_atomically(path) as stream:
        stream.write(data)


def write_in_place(path: Path, data: bytes) -> None:
    """Write a file atomically, preserving its permissions; a symbolic link remains, and its target is written."""
    target = path.resolve()
    mode = target.stat().st_mode & 0o7777 if target.exists() else NEW_FILE_MODE
    with writing_atomically(target, mode) as stream:
        stream.write(data)


def write_all_in_place(files: Mapping[Path, tuple[bytes, bytes]]) -> None:
    """Replace the content of several files, or of none of them, preserving their permissions.

    All new files are written before the first one replaces an old one. If this fails for one of them, those that have
    been replaced get their old content again. Only a crash between two replacements leaves some of them.

    Args:
        files: The expected old content and the new content of each file.

    Raises:
        OutputError: If the content of a file is not the expected one, because another program has changed it.
    """
    with ExitStack() as stack:
        staged_files: dict[Path, Path] = {}
        for path, (before, after) in files.items():
            target = path.resolve()
            if target.read_bytes() != before:
                raise OutputError(f"{path} has changed in the meantime; run the command again")
            handle, name = tempfile.mkstemp(prefix=f".{target.name}.", dir=target.parent)
            staged_files[target] = Path(name)
            stack.callback(Path(name).unlink, missing_ok=True)
            with naming(path), os.fdopen(handle, "wb") as stream:
                stream.write(after)
            Path(name).chmod(target.stat().st_mode & 0o7777)
        replaced: list[Path] = []
        try:
            for target, new in staged_files.items():
                os.replace(new, target)
                replaced.append(target)
        except OSError:
            old = {path.resolve(): before for path, (before, _) in files.items()}
            for target in replaced:
                write_in_place(target, old[target])
            raise


@contextmanager
def writing_atomically(path: Path, mode: int = NEW_FILE_MODE) -> Iterator[IO[bytes]]:
    """Yield a stream to a file that appears atomically if the block succeeds. Use it for content larger than memory."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, staging = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with naming(path), os.fdopen(handle, "wb") as stream:
            yield stream
        Path(staging).chmod(mode)
        os.replace(staging, path)
    except BaseException:
        Path(staging).unlink(missing_ok=True)
        raise


def write_file(path: Path, data: bytes) -> None:
    """Write a file in a staging folder, creating parent folders as needed. The write itself is not atomic."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with naming(path):
        path.write_bytes(data)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Add the file name to OS errors that do not include it, such as the error for a full disk."""
    try:
        yield
    except OSError as error:
        if error.filename is None and error.errno is not None:
            raise OSError(error.errno, error.strerror, str(path)) from None
        raise


@contextmanager
def staged(folder: Path) -> Iterator[Path]:
    """Yield an empty folder next to ``folder``.

    The new folder replaces ``folder`` if the block succeeds and is removed otherwise.
    """
    with scratch(folder.parent, folder.name) as staging:
        yield staging
        replace_folder(staging, folder)


@contextmanager
def scratch(parent: Path, name: str) -> Iterator[Path]:
    """Yield a new temporary folder ``parent/.NAME.new.*``, which is removed at the end.

    The folder is locked while it is in use, so that later runs can detect and remove folders left behind by killed
    runs.
    """
    parent.mkdir(parents=True, exist_ok=True)
    _clear(parent, name)
    made = Path(tempfile.mkdtemp(prefix=f".{name}.making.", dir=parent))
    lock = _lock(made)
    staging = made.with_name(made.name.replace(".making.", ".new."))
    made.rename(staging)  # the folder is already locked when this name becomes visible
    try:
        yield staging
    finally:
        shutil.rmtree(staging, ignore_errors=True)
        if lock is not None:
            os.close(lock)


def _clear(parent: Path, name: str) -> None:
    """Remove staging folders that were left behind by killed runs.

    These are folders that are not locked or that have not changed for ``STALE_S``.
    """
    head = tuple(f".{name}.{step}." for step in ("new", "making"))
    with os.scandir(parent) as entries:
        left = [Path(entry.path) for entry in entries if entry.name.startswith(head)]
    for folder in left:
        try:
            lock = _lock(folder) if folder.name.startswith(head[0]) else None
            if lock is not None or time.time() - folder.stat().st_mtime > STALE_S:
                shutil.rmtree(folder, ignore_errors=True)
            if lock is not None:
                os.close(lock)
        except OSError:  # another run has already removed it
            continue


def _lock(folder: Path) -> int | None:
    """Lock a folder and return the file descriptor. The lock is held until it is closed or the process ends.

    Returns None if the folder is already locked, or if folders cannot be locked (on Windows and on some network file
    systems).
    """
    try:
        import fcntl
    except ImportError:
        return None
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        return None
    return handle


@contextmanager
def locked_folder(folder: Path, complaint: str) -> Iterator[None]:
    """Lock a folder while the block runs. The lock also ends when the process is killed.

    Systems that cannot lock folders proceed without a lock.

    Raises:
        OutputError: If another process has locked the folder. ``complaint`` continues the name of the folder.
    """
    try:
        import fcntl
    except ImportError:
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise OutputError(f"{folder} {complaint}") from None
        except OSError:  # some network file systems
            pass
        yield
    finally:
        os.close(handle)


def clear_staged_files(folder: Path) -> None:
    """Remove files that killed runs left behind in :func:`writing_atomically`, from a folder that no other run uses."""
    for path in folder.glob(".*.*"):
        if path.is_file() and re.fullmatch(r"\..+\.[a-z0-9_]{8}", path.name):
            path.unlink(missing_ok=True)


def replace_folder(new: Path, folder: Path) -> None:
    """Swap the folders ``new`` and ``folder``, which must be on the same file system.

    The swap is atomic if the system supports it. Otherwise, if the process is killed between the two renames, the old
    folder remains next to its original location as ``.NAME.old.*``.
    """
    new.chmod(0o755)
    if not folder.exists():
        os.replace(new, folder)
        return
    if _exchange(new, folder):
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
    os.replace(aside / folder.name, new)
    aside.rmdir()


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files below ``folder``, keyed by relative POSIX path. Each parent folder is created only once."""
    for parent in sorted({(folder / path).parent for path in files}):
        parent.mkdir(parents=True, exist_ok=True)
    for path, data in files.items():
        with naming(folder / path):
            (folder / path).write_bytes(data)


def strangers(folder: Path, written: Iterable[str]) -> list[str]:
    """Return the relative POSIX paths of the files in ``folder`` that are not in ``written``, in sorted order.

    Files and folders listed in :data:`BYSTANDERS` are ignored.
    """
    known = set(written)
    files = (p.relative_to(folder) for p in folder.rglob("*") if p.is_symlink() or not p.is_dir())
    return sorted(p.as_posix() for p in files if p.as_posix() not in known and not set(p.parts) & set(BYSTANDERS))


def _exchange(a: Path, b: Path) -> bool:
    """Swap two paths atomically, or return False if the operating system or file system does not support this."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except AttributeError:  # a C library older than 2018
        return False
    here, exchange = -100, 2  # AT_FDCWD and RENAME_EXCHANGE for renameat2(2)
    return int(rename(here, os.fsencode(a), here, os.fsencode(b), exchange)) == 0


MARK = "Generated by SimFoundry"  # Written at the start of each generated page, plot and image

# Number of bytes at the start of a file that must contain the mark; in a PNG, the mark precedes the pixel data.
HEAD_BYTES = 1024

LISTED = 3  # Maximum number of files listed in a message


def ensure_replaceable(
    path: Path, inputs: Iterable[Path] = (), force: bool = False, content: bytes | None = None
) -> None:
    """Ensure that writing a file would not destroy user data.

    Args:
        path: The file to be written.
        inputs: The files that the command reads. They are never overwritten, even with ``force``.
        force: Whether any other file may be replaced.
        content: The new content if it does not contain :data:`MARK`. It may then replace only an identical file.

    Raises:
        OutputError: If user data would be destroyed.
    """
    if not path.exists():
        return
    if any(path.samefile(file) for file in inputs if file.exists()):
        raise OutputError(f"{path} is an input of this command and would be overwritten; choose another file")
    if path.is_dir():
        raise OutputError(f"{path} is a folder; specify a file")
    if not force and not is_generated(path) and (content is None or path.read_bytes() != content):
        reason = "was not generated by SimFoundry" if content is None else "differs from what would be written"
        raise OutputError(f"{path} exists and {reason}; choose another file, or replace it with --force")


def is_generated(path: Path) -> bool:
    """Return True if a file contains :data:`MARK` near its start. Special files, such as pipes, count as generated."""
    if not path.is_file():
        return True
    with path.open("rb") as stream:
        return MARK.encode() in stream.read(HEAD_BYTES)


def ensure_folder_replaceable(folder: Path, index: str, advice: str = "", how: str = "with --force") -> None:
    """Ensure that ``folder`` contains no files that were generated elsewhere or edited after they were generated.

    Args:
        folder: The folder to be replaced; it may be missing.
        index: The JSON file in the folder with the result of :func:`file_digests` under the key ``files``.
        advice: Advice for the user on how to keep the edits, as a clause in the message.
        how: How the user can replace the folder anyway.

    Raises:
        OutputError: If the folder contains such files.
    """
    if not folder.is_dir():
        return
    try:
        listed = json.loads((folder / index).read_bytes())["files"]
        written = {str(path): str(digest) for path, digest in listed.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        written = {}
    foreign = strangers(folder, [*written, *([index] if written else [])])
    if foreign:
        raise OutputError(
            f"{folder} contains files that were not generated there ({_names(foreign)}); choose another folder, "
            f"or replace the entire folder {how}"
        )
    # Deleted files do not count as edited.
    present = ((path, folder / path) for path in sorted(written) if (folder / path).is_file())
    edited = [path for path, file in present if hashlib.sha256(file.read_bytes()).hexdigest() != written[path]]
    if edited:
        keep = f"{advice}; " if advice else ""
        raise OutputError(
            f"{folder} contains files that were edited since they were generated ({_names(edited)}); {keep}choose "
            f"another folder, or discard the edits {how}"
        )


def file_digests(folder: Path) -> dict[str, str]:
    """Return the SHA-256 digest of every file in a folder, keyed by relative POSIX path."""
    files = {p.relative_to(folder).as_posix(): p for p in folder.rglob("*") if p.is_file()}
    return {path: hashlib.sha256(files[path].read_bytes()).hexdigest() for path in sorted(files)}


@contextmanager
def copied_folder(source: Path, folder: Path, index: str) -> Iterator[None]:
    """Replace ``folder`` with a copy of ``source``, and restore the previous state if the block fails.

    The copy contains the file ``index``, by which a later call recognizes that it may replace the folder. Raises
    :class:`OutputError` if the existing folder contains other files or was edited.
    """
    ensure_folder_replaceable(folder, index, how="by deleting it first")
    is_new_parent, is_new = not folder.parent.exists(), not folder.exists()
    try:
        with scratch(folder.parent, folder.name) as staging:
            copy = staging / folder.name
            shutil.copytree(source, copy)
            (copy / index).write_text(json.dumps({"files": file_digests(copy)}, indent=2) + "\n", encoding="utf-8")
            replace_folder(copy, folder)  # the previous folder is now in the staging folder
            try:
                yield
            except BaseException:
                if is_new:
                    shutil.rmtree(folder)
                else:
                    replace_folder(copy, folder)
                raise
    except BaseException:
        if is_new_parent:
            with suppress(OSError):
                folder.parent.rmdir()
        raise


def _names(paths: list[str]) -> str:
    more = f" and {len(paths) - LISTED} more" if len(paths) > LISTED else ""
    return ", ".join(paths[:LISTED]) + more


def shipped(path: str) -> Path:
    """Return the location of the repository folder ``path``, in a checkout or in an installed wheel.

    In a wheel, the folder is located in ``simfoundry/shipped``. The folders that are available there are listed under
    ``force-include`` in pyproject.toml.
    """
    package = Path(__file__).parents[1]
    installed = package / "shipped"
    return (installed if installed.is_dir() else package.parent) / path
