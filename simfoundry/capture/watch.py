"""Run a capture again whenever a person changes its inputs or corrects its output."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from simfoundry.capture.inputs import images_of
from simfoundry.capture.outputs.output_folder import output_stamps
from simfoundry.capture.run import CaptureRun
from simfoundry.capture.shared_modules import SHARED_MODULES
from simfoundry.capture.statements.overrides import OVERRIDES_FOLDER
from simfoundry.runtime.file_changes import Stamp, file_stamp, folder_stamps, wait_for_change
from simfoundry.runtime.process_pair import import_modules
from simfoundry.spec.models.capture import CaptureSpec

# What a change needs to settle, and a run without changes does not.
SETTLING_MODULES = ("cv2", "mujoco", "simfoundry.worlds.mujoco_world", "trimesh")


def follow(run: CaptureRun, again: Callable[[], CaptureRun | None], ready: Callable[[], object]) -> None:
    """Call ``again`` after each change of the files that the run read, or wrote for a person to edit. This never ends.

    ``again`` returns None if it failed, for example because a document is not valid yet. A change during a run leads to
    another run. ``ready`` is called once, when changes are noticed from then on.
    """
    seen = _stamps(run)
    ready()
    import_modules((*SHARED_MODULES, *SETTLING_MODULES))
    while True:
        seen = wait_for_change(partial(_stamps, run), seen)
        following = again()
        if following is not None:
            run = following
            written = output_stamps(run.scene_file.parent)
            seen = {path: stamp if path in written else seen.get(path, stamp) for path, stamp in _stamps(run).items()}


def _stamps(run: CaptureRun) -> dict[Path, Stamp]:
    """Return the stamps of the capture document, its images, the corrections beside it, and the output."""
    assert isinstance(run.document.spec, CaptureSpec)
    images = {run.document.file(image) for shot in run.document.spec.frames.values() for image in images_of(shot)}
    files = {path: file_stamp(path) for path in (run.document.path, *sorted(images))}
    corrections = folder_stamps(run.document.path.parent / OVERRIDES_FOLDER)
    return files | corrections | output_stamps(run.scene_file.parent)
