"""The files of a reconstruction that people edit, written so that their edits survive."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simfoundry.capture.findings import CaptureFinding
from simfoundry.capture.outputs.mask_files import MASK_NAMES, MASKS, mask_image, names_text
from simfoundry.capture.outputs.output_folder import LAST_SCENE, STAGES_FOLDER, PreviousOutput
from simfoundry.capture.outputs.overlay import SEGMENTS, segment_image
from simfoundry.capture.outputs.scene_merge import merge_scene
from simfoundry.capture.pipeline import Statements
from simfoundry.capture.segment.masks import Labels
from simfoundry.runtime.files import write_file
from simfoundry.spec.load import load


@dataclass(frozen=True)
class WrittenScene:
    """A scene that was written, perhaps with a person's edits.

    ``is_edited`` is True if it differs from the reconstruction, and ``is_broken`` if it is then not a valid scene.
    """

    is_edited: bool
    is_broken: bool = False
    findings: tuple[CaptureFinding, ...] = ()


def write_merged(previous: PreviousOutput, scene_file: Path) -> WrittenScene:
    """Merge the edits of the last scene into the new one, which is in ``scene_file``.

    The new scene is also kept without edits, for the next merge. Meshes of the last run that only the edited scene uses
    are kept, too.
    """
    theirs = scene_file.read_text(encoding="utf-8")
    write_file(scene_file.parent / STAGES_FOLDER / LAST_SCENE, theirs.encode())
    base, ours = previous.text(f"{STAGES_FOLDER}/{LAST_SCENE}"), previous.text(scene_file.name)
    if ours is None or base is None or scene_file.name not in (*previous.edited, *previous.kept):
        return WrittenScene(is_edited=False)
    added = _last_meshes(previous, scene_file.parent)
    merged = merge_scene(scene_file, base, ours, theirs)
    for path in added:
        if Path(path).stem not in merged.text:
            (scene_file.parent / path).unlink()
    if merged.text == theirs:
        return WrittenScene(is_edited=False)
    write_file(scene_file, merged.text.encode())
    return WrittenScene(True, bool(load(scene_file).errors), merged.findings)


def _last_meshes(previous: PreviousOutput, folder: Path) -> list[str]:
    """Add the meshes of the last run that the new run did not write, and return their relative paths."""
    added = []
    for path in previous.written:
        old, new = previous.folder / path, folder / path
        if path.startswith("meshes/") and not new.exists() and old.is_file():
            new.parent.mkdir(parents=True, exist_ok=True)
            with suppress(OSError):
                os.link(old, new)
            if not new.exists():
                shutil.copyfile(old, new)
            added.append(path)
    return added


def write_masks(
    folder: Path, previous: PreviousOutput, known: Statements, labels: Labels, names: Mapping[str, int]
) -> tuple[str, ...]:
    """Write the masks of the objects and their names. Files that a person edited are kept as they are.

    Args:
        folder: Folder to which the files are written.
        previous: What the last run left.
        known: What is known about the image.
        labels: The number of the object at each pixel, shape (h, w).
        names: The numbers of the objects by name.

    Returns:
        The files that contain edits.
    """
    write_file(folder / SEGMENTS, segment_image(labels))
    edited = known.overrides.edited
    numbers = dict(names)
    if MASKS in edited and known.overrides.masks is not None:  # its numbers may have gaps
        for name, k in names.items():
            numbers[name] = int(np.bincount(known.overrides.masks[labels == k]).argmax())
    for name, content in ((MASKS, mask_image(labels)), (MASK_NAMES, names_text(numbers))):
        write_file(folder / name, (previous.folder / name).read_bytes() if name in edited else content)
    return edited
