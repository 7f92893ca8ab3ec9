"""The output folder of a capture: what may be replaced in it, and the results of stages that stay in it."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from simfoundry.capture.stages.store import StageStore
from simfoundry.errors import OutputError, PicklableError
from simfoundry.runtime.files import LISTED, locked_folder, replace_folder, scratch, strangers

# Folder in the output with the results of stages.
STAGES_FOLDER = "stages"

REPORT = "report.json"


def ensure_output_replaceable(out: Path, document: Path, force: bool) -> None:
    """Ensure that replacing ``out`` destroys neither the capture ``document`` nor the user's own files.

    Raises:
        OutputError: It would. ``force`` permits to replace the user's files, but not the capture.
    """
    if document.resolve().is_relative_to(out):
        raise OutputError(f"{out} contains the capture itself; choose another output folder")
    if force or not out.is_dir():
        return
    written = written_files(out)
    known = [*written, *([REPORT] if written else [])]
    foreign = [path for path in strangers(out, known) if not path.startswith(f"{STAGES_FOLDER}/")]
    if foreign:
        raise OutputError(
            f"{out} contains files that were not generated there ({_names(foreign)}); choose another folder, or "
            "replace the entire folder with --force"
        )
    edited = edited_files(out, written)
    if edited:
        raise OutputError(
            f"{out} contains files that were edited since they were generated ({_names(edited)}); choose another "
            "folder, or discard the edits with --force"
        )


def written_files(out: Path) -> dict[str, str]:
    """Return the digests of the files that the last run wrote to ``out``, by relative path; empty if unknown."""
    try:
        files = json.loads((out / REPORT).read_bytes())["files"]
        return {str(path): str(digest) for path, digest in files.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def edited_files(out: Path, written: Mapping[str, str]) -> list[str]:
    """Return the files in ``out`` that differ from what the last run wrote. Deleted files do not count."""
    present = [(path, out / path) for path in sorted(written) if (out / path).is_file()]
    return [path for path, file in present if hashlib.sha256(file.read_bytes()).hexdigest() != written[path]]


def _names(paths: list[str]) -> str:
    more = f" and {len(paths) - LISTED} more" if len(paths) > LISTED else ""
    return ", ".join(paths[:LISTED]) + more


@contextmanager
def stage_store(out: Path) -> Iterator[StageStore]:
    """Yield the results of stages in ``out``, which no other run uses in the meantime.

    Results remain if the block is interrupted, so that the next run goes on from there. If the block fails for a reason
    that the user has to correct, and there were no results before, they are removed.

    Raises:
        OutputError: Another run uses the folder.
    """
    folder = out / STAGES_FOLDER
    is_new = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    with locked_folder(folder, "is in use by another run"):
        try:
            yield StageStore(folder)
        except PicklableError:
            if is_new:
                shutil.rmtree(folder, ignore_errors=True)
                with suppress(OSError):  # the output folder had other files
                    out.rmdir()
            raise


@contextmanager
def staged_output(out: Path) -> Iterator[Path]:
    """Yield an empty folder that replaces ``out`` if the block succeeds. The results of stages stay in ``out``."""
    with scratch(out.parent, out.name) as staging:
        yield staging
        kept = out / STAGES_FOLDER
        if kept.is_dir():
            shutil.copytree(kept, staging / STAGES_FOLDER, copy_function=_link)
        replace_folder(staging, out)


def _link(source: str, target: str) -> None:
    """Give a file a second name, or copy it where file systems have no hard links."""
    with suppress(OSError):
        os.link(source, target)
        return
    shutil.copy2(source, target)
