"""The output folder of a capture: what may be replaced in it, and the results of stages that stay in it."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from simfoundry.capture.stages.store import StageStore
from simfoundry.errors import OutputError, PicklableError
from simfoundry.runtime.file_changes import Stamp, folder_stamps
from simfoundry.runtime.files import LISTED, locked_folder, replace_folder, scratch, strangers

# Folder in the output with the results of stages.
STAGES_FOLDER = "stages"

REPORT = "report.json"

# Ending of the tasks in the output, which people may edit as well.
TASK = ".task.yaml"

# Files that people may edit in the output, and that later runs take into account.
EDITABLE = ("masks.png", "masks.yaml")

# File in the folder of stages with the scene as the last run reconstructed it, with which later edits are compared.
LAST_SCENE = "last.scene.yaml"


@dataclass(frozen=True, eq=False)
class PreviousOutput:
    """The output of the last run, and a person's edits of it since.

    Attributes:
        folder: The output folder, which may be missing.
        written: Digests of the files that the last run wrote, by relative path.
        kept: Files among them that contain edits from before the last run.
        edited: Files among them that a person has edited since.
        foreign: Relative paths of the files that no run wrote.
        numbers: Numbers of the objects in the last run, by name.
        stamps: Stamps of all files, by which an edit during the run is noticed.
    """

    folder: Path
    written: Mapping[str, str] = field(default_factory=dict)
    kept: tuple[str, ...] = ()
    edited: tuple[str, ...] = ()
    foreign: tuple[str, ...] = ()
    numbers: Mapping[str, int] = field(default_factory=dict)
    stamps: Mapping[Path, Stamp] = field(default_factory=dict)

    def edited_masks(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Return which of the files ``names`` contain edits, from before or since the last run."""
        return tuple(n for n in names if n in (*self.kept, *self.edited) and (self.folder / n).is_file())

    def text(self, name: str) -> str | None:
        """Return the text of a file, or None if it is missing or not text."""
        try:
            return (self.folder / name).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError):
            return None


def previous_output(out: Path, document: Path, scene: str, force: bool) -> PreviousOutput:
    """Return the content of ``out``, which a run for the capture ``document`` is about to replace.

    Edits of the masks and of the file ``scene``, and files beside them, survive. With ``force``, all are discarded.

    Raises:
        OutputError: ``out`` contains the capture, or edits that would be lost, or was not written by a capture.
    """
    if document.resolve().is_relative_to(out):
        raise OutputError(f"{out} contains the capture itself; choose another output folder")
    stamps = output_stamps(out)
    if force or not out.is_dir():
        return PreviousOutput(out, stamps=stamps)
    report = _report_of(out)
    written = {str(path): str(digest) for path, digest in report.get("files", {}).items()}
    known = [*written, *([REPORT] if written else [])]
    foreign = [path for path in strangers(out, known) if not path.startswith(f"{STAGES_FOLDER}/")]
    if foreign and not written:
        raise OutputError(
            f"{out} contains files that were not generated there ({_names(foreign)}); choose another folder, or "
            "replace the entire folder with --force"
        )
    present = [(path, out / path) for path in sorted(written) if (out / path).is_file()]
    edited = [path for path, file in present if hashlib.sha256(file.read_bytes()).hexdigest() != written[path]]
    can_merge = (out / STAGES_FOLDER / LAST_SCENE).is_file()
    kept_edits = {*EDITABLE, *(path for path in edited if path.endswith(TASK))}
    lost = [path for path in edited if path not in kept_edits and not (path == scene and can_merge)]
    if lost:
        raise OutputError(
            f"{out} contains files that were edited since they were generated ({_names(lost)}); state corrections in "
            f"overrides/objects.yaml beside the capture (edits of the masks, and of {scene} if {STAGES_FOLDER}/"
            f"{LAST_SCENE} exists, are merged), choose another folder, or discard the edits with --force"
        )
    kept = tuple(str(path) for path in report.get("edited", ()))
    return PreviousOutput(out, written, kept, tuple(edited), tuple(foreign), numbers_in(report), stamps)


def output_stamps(out: Path) -> dict[Path, Stamp]:
    """Return the stamps of the files in ``out``, without the results of stages."""
    return folder_stamps(out, (STAGES_FOLDER,))


def numbers_in(report: Mapping[str, Any]) -> dict[str, int]:
    """Return the numbers of objects by their names, as a report lists them."""
    objects = report.get("objects", {})
    listed = objects.items() if isinstance(objects, dict) else ()
    return {str(name): int(item["segment"]) for name, item in listed if isinstance(item, dict) and "segment" in item}


def _report_of(out: Path) -> dict[str, Any]:
    """Return the report of the last run, or an empty mapping if there is none or if it is damaged."""
    try:
        report = json.loads((out / REPORT).read_bytes())
        return report if isinstance(report["files"], dict) and isinstance(report.get("edited", []), list) else {}
    except (OSError, ValueError, KeyError, TypeError):
        return {}


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
def staged_output(previous: PreviousOutput) -> Iterator[Path]:
    """Yield an empty folder that replaces the output folder if the block succeeds.

    The results of stages and the files that no run wrote stay in the output folder.

    Raises:
        OutputError: The run wrote a file whose name one of these files has, or someone edited files meanwhile.
    """
    out = previous.folder
    with scratch(out.parent, out.name) as staging:
        yield staging
        changed = [str(path) for path, _ in {*output_stamps(out).items()} ^ {*previous.stamps.items()}]
        if changed:
            raise OutputError(f"{min(changed)} was changed during the run; run the command again to use it")
        for path in previous.foreign:
            if (staging / path).exists():
                raise OutputError(f"{out / path} was not written by a capture and would be replaced; move it away")
            (staging / path).parent.mkdir(parents=True, exist_ok=True)
            _link(str(out / path), str(staging / path))
        kept = out / STAGES_FOLDER
        if kept.is_dir():
            old = shutil.ignore_patterns(LAST_SCENE)
            shutil.copytree(kept, staging / STAGES_FOLDER, ignore=old, copy_function=_link, dirs_exist_ok=True)
        replace_folder(staging, out)


def _link(source: str, target: str) -> None:
    """Give a file a second name, or copy it where file systems have no hard links."""
    with suppress(OSError):
        os.link(source, target)
        return
    shutil.copy2(source, target)
