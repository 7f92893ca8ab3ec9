"""The inputs of a reconstruction: the frame, a person's statements, and the output of the last run."""

from __future__ import annotations

import hashlib
from collections.abc import Collection
from dataclasses import replace
from functools import partial
from pathlib import Path

from simfoundry.assets.cache import Cache
from simfoundry.capture.cad.library import CadLibrary, open_library
from simfoundry.capture.description.describe import SUPPORT_NAME
from simfoundry.capture.findings import MODEL_FAILED
from simfoundry.capture.frame import CaptureError, Frame
from simfoundry.capture.frames.fusion import fused_frames, load_fused_frame, posed_views
from simfoundry.capture.frames.load import checked_frame_name, open_capture
from simfoundry.capture.outputs.mask_files import MASK_NAMES, MASKS, read_mask_names, read_masks
from simfoundry.capture.outputs.output_folder import STAGES_FOLDER, PreviousOutput, previous_output
from simfoundry.capture.pipeline import Statements, reconstruct
from simfoundry.capture.settling.settle_stage import picture_inputs, settle_inputs
from simfoundry.capture.stages.runner import StageResult, StageRunner
from simfoundry.capture.stages.status import StageStatus, listed_states, read_source
from simfoundry.capture.stages.store import StageStore
from simfoundry.capture.statements.overrides import load_overrides
from simfoundry.errors import SimfoundryError
from simfoundry.models.setup import ModelSetup, load_setup
from simfoundry.spec.diagnostics import SpecError, nearest
from simfoundry.spec.files import Loaded
from simfoundry.spec.models.capture import CaptureSpec, Shot


def never() -> None:
    """Take the place of a computation that a runner which only examines never starts.

    Raises:
        AssertionError: Always.
    """
    raise AssertionError("a runner that only examines computes nothing")


def load_stage(loaded: Loaded, frame_name: str, stages: StageRunner, setup: ModelSetup) -> StageResult[Frame]:
    """Load a frame of a capture, or reuse what an earlier run loaded if neither its files nor its keys changed.

    ``setup`` names the models of depth, for a frame that needs one.
    """
    assert isinstance(loaded.spec, CaptureSpec)
    shot = loaded.spec.frames[frame_name]
    used = {name: loaded.spec.frames[name] for name in (frame_name, *fused_frames(loaded.spec, frame_name))}
    inputs = {name: each.model_dump_json() for name, each in used.items()}
    for image in sorted({image for each in used.values() for image in images_of(each)}):
        try:
            inputs[image] = hashlib.sha256(loaded.file(image).read_bytes()).hexdigest()
        except OSError:
            inputs[image] = ""  # reported by the stage
    if shot.depth is None:
        inputs["model"] = str(setup.source("depth" if shot.stereo is None else "stereo"))
    read = partial(load_fused_frame, loaded, frame_name, setup)
    result = stages.run(
        "frames",
        inputs,
        lambda: replace(read(), decomposition=None, support=None),
        quick=True,
        provisional=lambda frame: any(finding.code == MODEL_FAILED for finding in frame.findings),
    )
    return replace(result, value=replace(result.value, decomposition=shot.decomposition, support=shot.support))


def images_of(shot: Shot) -> list[str]:
    """Return the images of a frame, as they are named in the capture."""
    depth = [] if shot.depth is None else [shot.depth.image]
    stereo = [] if shot.stereo is None else [shot.stereo.right]
    return [shot.color, *depth, *stereo, *([] if shot.masks is None else [shot.masks.image])]


def statements(loaded: Loaded, frame_name: str, previous: PreviousOutput, frame: Frame) -> Statements:
    """Return the statements about a frame, from its capture, from overrides and from the last run.

    Raises:
        SimfoundryError, SpecError: A correction of a person cannot be used.
    """
    assert isinstance(loaded.spec, CaptureSpec)
    frames = loaded.spec.frames
    size = (frame.color.shape[0], frame.color.shape[1])
    overrides = load_overrides(loaded.path, frame_name, frame_name == next(iter(frames)), size, previous)
    masks = frames[frame_name].masks
    given = masks.names if masks is not None else {}
    try:
        last = read_masks(previous.folder / MASKS, size)
        return Statements(given, overrides, last, read_mask_names(previous.folder / MASK_NAMES))
    except (OSError, SimfoundryError, SpecError):  # there was no last run, or its files are damaged
        return Statements(given, overrides)


def stated_library(loaded: Loaded, folder: Path | None, cache: Cache | None) -> CadLibrary | None:
    """Return the CAD library of a capture, if it states one. ``folder`` replaces it, with meshes in meters.

    Raises:
        SimfoundryError: The library cannot be used.
    """
    assert isinstance(loaded.spec, CaptureSpec)
    if folder is not None:
        return open_library(folder, cache=cache)
    stated = loaded.spec.cad
    if stated is None:
        return None
    return open_library(loaded.path.parent / stated.folder, stated.scale, cache)


def labels_of(previous: PreviousOutput, names: Collection[str]) -> tuple[str, ...]:
    """Return the labels of the objects that the last run called ``names``.

    Raises:
        SimfoundryError: There is no such object.
    """
    numbers = {name: str(k) for name, k in previous.numbers.items()} | {SUPPORT_NAME: SUPPORT_NAME}
    for name in names:
        if name not in numbers:
            raise SimfoundryError(f"the last run has no object `{name}`; {nearest(name, numbers)}")
    return tuple(numbers[name] for name in names)


def examine(out: Path) -> list[StageStatus]:
    """Return which stages of the output folder ``out`` a new run would reuse, and which ones it would run again.

    Raises:
        SimfoundryError: ``out`` was not written by a capture, or the capture is unusable.
    """
    out = out.resolve()
    document, frame_name, cad = read_source(out / STAGES_FOLDER)
    loaded = open_capture(document)
    assert isinstance(loaded.spec, CaptureSpec)
    frame_name = checked_frame_name(loaded, frame_name)
    name = loaded.spec.name if len(loaded.spec.frames) == 1 else f"{loaded.spec.name}_{frame_name}"
    previous = previous_output(out, loaded.path, f"{name}.scene.yaml", force=False)
    complete = False
    with StageRunner(StageStore(out / STAGES_FOLDER), examine=True) as stages:
        try:
            setup = load_setup(loaded.path)
            source = load_stage(loaded, frame_name, stages, setup)
            known = replace(
                statements(loaded, frame_name, previous, source.value),
                setup=setup,
                cad=stated_library(loaded, cad, Cache.default()),
                views=partial(posed_views, loaded, frame_name, setup),
            )
            built = reconstruct(name, source, known, lambda stage, share: None, stages)
            complete = True
            built.removal()
            if all(state == "cached" for state in stages.states.values()):  # otherwise, meshes are missing
                inputs = settle_inputs(built)
                settled = stages.run("settle", inputs, never)
                if f"{name}.scene.yaml" not in (*previous.edited, *previous.kept):  # that is drawn in each run
                    shown = {"image": source.digest, **picture_inputs(built, inputs, settled.digest)}
                    stages.run("pictures", shown, never)
        except CaptureError:
            complete = ("name", "") in stages.states  # only the support's texture was stale
    return listed_states(stages, {str(k): name for name, k in previous.numbers.items()}, complete)
