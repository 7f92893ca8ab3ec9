"""Reconstruct a settled scene from a capture, and write it to a folder with a report and images."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.cache import Cache
from simfoundry.capture.accuracy.scene_accuracy import SceneAccuracy, difference_image, scene_accuracy, truth_camera
from simfoundry.capture.findings import MOVED, CaptureFinding, ordered_findings
from simfoundry.capture.frame import CaptureError
from simfoundry.capture.frames.fusion import posed_views
from simfoundry.capture.frames.load import checked_frame_name, open_capture
from simfoundry.capture.inputs import labels_of, load_stage, stated_library, statements
from simfoundry.capture.outputs.edited_files import write_masks, write_merged
from simfoundry.capture.outputs.output_folder import REPORT, STAGES_FOLDER, previous_output, stage_store, staged_output
from simfoundry.capture.outputs.pictures import FAST, RenderedScene, comparison_picture
from simfoundry.capture.pipeline import reconstruct
from simfoundry.capture.reconstruct import Progress, Reconstruction
from simfoundry.capture.recordings.unpack import is_recording, unpack_recording
from simfoundry.capture.settling.settle_stage import resting_scene
from simfoundry.capture.stages.runner import StageRunner, StageState
from simfoundry.capture.stages.status import write_source
from simfoundry.capture.tasks import TaskRequest, write_tasks
from simfoundry.models.setup import ModelSetup, load_setup
from simfoundry.render.raycast import raycast
from simfoundry.runtime.files import file_digests, write_file, write_files
from simfoundry.runtime.process_pair import ProcessPair
from simfoundry.scene.lower import lower, lower_file
from simfoundry.scene.model import Camera, Scene
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.files import Loaded
from simfoundry.spec.load import load_scene
from simfoundry.spec.models.capture import CaptureSpec
from simfoundry.worlds.settle import SettleResult, settle

# Makes an HTML page of a report and its pictures, by file name.
ReportPage = Callable[[Mapping[str, Any], Mapping[str, bytes]], str]

# The page that people look at, with what `report.json` contains.
PAGE = "report.html"


@dataclass(frozen=True, eq=False)
class CaptureRun:
    """The result of a capture.

    It consists of the scene document and a report that describes how well the scene fits and settles. ``findings``
    lists what is doubtful about the scene, including what the caller accepts. ``states`` tells which stages ran, by
    stage and object, in the order of the stages. ``accuracy`` compares the scene with the ground truth, if one was
    given.
    """

    document: Loaded
    scene_file: Path
    reconstruction: Reconstruction
    settled: SettleResult
    report: dict[str, Any]
    findings: tuple[CaptureFinding, ...]
    states: dict[tuple[str, str], StageState]
    accuracy: SceneAccuracy | None = None


@dataclass(frozen=True)
class CaptureOptions:
    """Options of a capture.

    Attributes:
        frame: Name of the frame to reconstruct, or None for the first.
        force: Whether to replace an output folder that contains other files or a person's edits.
        accepted: Codes of findings that do not keep the scene from passing.
        redo_from: The first stage that runs even if its inputs have not changed, or None.
        only: Names of the objects, in the last run, to which ``redo_from`` is restricted.
        truth: A scene with the ground truth, with which the result is compared.
        page: Makes an HTML page of the report and its pictures, by file name.
        setup: The models to ask; by default, those that are configured for the capture.
        tasks: A request for tasks in the scene.
        cad: A folder of CAD models, instead of the one that the capture states.
        processes: The processes that share long work, or None for this one.
    """

    frame: str | None = None
    force: bool = False
    accepted: Collection[str] = ()
    redo_from: str | None = None
    only: Collection[str] = ()
    truth: Path | None = None
    page: ReportPage | None = None
    setup: ModelSetup | None = None
    tasks: TaskRequest | None = None
    cad: Path | None = None
    processes: ProcessPair | None = None

    @property
    def first_redone(self) -> str | None:
        """The first stage that runs again although its inputs have not changed, or None."""
        return self.redo_from or ("shape" if self.only else None)


def run_capture(
    path: Path,
    out: Path,
    progress: Progress = lambda stage, share: None,
    cache: Cache | None = None,
    options: CaptureOptions = CaptureOptions(),
) -> CaptureRun:
    """Reconstruct one frame of a capture, and write the result to the folder ``out``.

    ``path`` is the capture document, a folder that contains ``capture.yaml``, or a recording, which is unpacked into
    the folder ``OUT_capture`` beside ``out``, where it may then be edited. ``out`` is replaced atomically at the end,
    so a failed run leaves it unchanged. Identical inputs produce identical bytes. Stages whose inputs have not changed
    since the last run to ``out`` are not run again. Where a model fails, there is a finding, and the method without a
    model is used.

    Raises:
        SpecError: The capture or the ground truth is unusable. The error contains all findings.
        SimfoundryError: The ground truth has no camera that relates it to the frame.
        OutputError: ``out`` contains files that were not written by a capture or were edited afterward, and ``force``
            is not set.
    """
    loaded = _opened(path, out, options.force, progress)
    assert isinstance(loaded.spec, CaptureSpec)
    frame_name = checked_frame_name(loaded, options.frame)
    name = loaded.spec.name if len(loaded.spec.frames) == 1 else f"{loaded.spec.name}_{frame_name}"
    scene_name = f"{name}.scene.yaml"
    previous = previous_output(out.resolve(), loaded.path, scene_name, options.force)
    labels = labels_of(previous, options.only)
    models = options.setup or load_setup(loaded.path)
    library = stated_library(loaded, options.cad, cache)
    real = None if options.truth is None else _GroundTruth.load(options.truth, frame_name, cache)
    try:
        with (
            stage_store(previous.folder) as store,
            StageRunner(store, options.first_redone, labels, processes=options.processes) as stages,
        ):
            write_source(store.folder, loaded.path, frame_name, options.cad)
            source = load_stage(loaded, frame_name, stages, models)
            views = partial(posed_views, loaded, frame_name, models)
            known = statements(loaded, frame_name, previous, source.value)
            known = replace(known, setup=models, cad=library, views=views)
            built = reconstruct(name, source, known, lambda stage, share: progress(stage, 0.6 * share), stages)
            with staged_output(previous) as staging:
                resting = resting_scene(built, source.value, staging / scene_name, cache, progress, stages)
                built, rendered, settled = resting.reconstruction, resting.rendered, resting.settled
                merged = write_merged(previous, staging / scene_name)
                if merged.is_edited and not merged.is_broken:
                    rendered, settled = _edited_rest(staging / scene_name, cache, progress)
                progress("pictures", 0.95)
                color, shown = source.value.color, {"image": source.digest, **resting.shown}
                draw = partial(comparison_picture, color, built.segmentation.labels, rendered)
                drawn = draw() if merged.is_edited else stages.run("pictures", shown, draw).value
                write_file(staging / "compare.png", drawn)
                accuracy = None if real is None else real.judge(rendered, color, staging)
                edited = write_masks(staging, previous, known, built.segmentation.labels, built.names)
                written = write_tasks(options.tasks, staging / scene_name, color, previous, progress)
                findings = ordered_findings((*built.findings, *_restless(settled), *merged.findings, *written.findings))
                report = {
                    **_report(built, settled, findings, options.accepted),
                    "source": f"{loaded.spec.name}/{frame_name}",
                    "edited": [*edited, *[scene_name] * merged.is_edited, *written.edited],
                    **written.to_json(),
                    **({} if accuracy is None else {"accuracy": accuracy.to_json()}),
                }
                write_files(staging, built.candidates)
                report = _write_report(report, options.page, staging)
                store.prune()
    except CaptureError as error:
        raise SpecError([loaded.finding(error.code, ("frames", frame_name), error.message, error.hint)]) from None
    return CaptureRun(loaded, out / scene_name, built, settled, report, findings, stages.ordered_states(), accuracy)


def _opened(path: Path, out: Path, force: bool, progress: Progress) -> Loaded:
    """Return the capture document at ``path``. A recording is unpacked beside ``out`` first."""
    if is_recording(path):
        path = unpack_recording(path, out.with_name(f"{out.name}_capture"), force, progress)
    return open_capture(path)


@dataclass(frozen=True, eq=False)
class _GroundTruth:
    """A scene with the ground truth, and the camera in it that took the image."""

    scene: Scene
    camera: Camera

    @classmethod
    def load(cls, path: Path, frame_name: str, cache: Cache | None) -> _GroundTruth:
        scene = lower_file(path, cache)
        return cls(scene, truth_camera(scene, frame_name))

    def judge(self, rendered: RenderedScene, color: NDArray[np.uint8], folder: Path) -> SceneAccuracy:
        """Compare a reconstruction with the truth, and write a picture of both with the image and their difference."""
        from simfoundry.render.montage import save_png, side_by_side

        difference = difference_image(rendered.ray.color, color)
        panels = [("capture", color), ("reconstruction", rendered.ray.color), ("difference", difference)]
        panels.append(("ground truth", raycast(self.scene, self.camera).color))
        save_png(folder / "accuracy.png", side_by_side(panels, columns=2), FAST)
        return scene_accuracy(self.scene, self.camera, rendered.scene, rendered.ray, color)


def _write_report(report: dict[str, Any], page: ReportPage | None, folder: Path) -> dict[str, Any]:
    """Write the page and the report of the output in a folder, and return the report with the digests of its files."""
    if page is not None:
        pictures = {p.name: p.read_bytes() for p in sorted(folder.glob("*.png"))}
        write_file(folder / PAGE, page(report, pictures).encode())
    report = {**report, "files": _digests(folder)}
    write_file(folder / REPORT, (json.dumps(report, indent=2) + "\n").encode())
    return report


def _edited_rest(document: Path, cache: Cache | None, progress: Progress) -> tuple[RenderedScene, SettleResult]:
    """Settle a scene that a person edited, to find out what does not rest where it is."""
    from simfoundry.worlds.mujoco_world import MujocoWorld

    scene = lower(load_scene(document), cache)
    with MujocoWorld(scene) as world:
        settled = settle(world, progress=lambda stage, share: progress(stage, 0.9 + 0.05 * share))
    return RenderedScene(lambda: scene, settled.state), settled


def _restless(settled: SettleResult) -> list[CaptureFinding]:
    """Return a finding for each object that settled elsewhere than it was seen."""
    hint = "compare the object with compare.png, and correct its shape or pose"
    return [
        CaptureFinding(MOVED, "; ".join(o.problems), hint, objects=(o.name,)) for o in settled.objects if o.problems
    ]


def _digests(folder: Path) -> dict[str, str]:
    """Return the digests of the output, without the results of stages, which may change without being edits."""
    digests = file_digests(folder)
    return {path: digest for path, digest in digests.items() if not path.startswith(f"{STAGES_FOLDER}/")}


def _report(
    built: Reconstruction,
    settled: SettleResult,
    findings: tuple[CaptureFinding, ...],
    accepted: Collection[str],
) -> dict[str, Any]:
    settle_of = {o["name"]: o for o in settled.to_json()["objects"]}
    objects = {}
    for name, shape in built.shapes.items():
        if name not in settle_of and not built.spec.objects[name].fixed:  # a person removed it from the scene
            continue
        pixels = int(np.count_nonzero(built.segmentation.labels == built.names[name]))
        fit, confidence = round(shape.fit_m, 6), round(shape.confidence, 6)
        result = settle_of.get(name, {})  # empty for an object that is held in place
        rest = {k: round(v, 6) if isinstance(v, float) else v for k, v in result.items() if k != "name"}
        objects[name] = {
            "segment": built.names[name],
            "pixels": pixels,
            "fit": fit,
            "confidence": confidence,
            "settle": rest,
        }
        if name in built.compared:
            origin = built.spec.objects[name].origin
            is_model = origin is not None and any(use.task == "mesh" for use in origin.models)
            objects[name]["candidates"] = {"used": "model" if is_model else "fitted", **built.compared[name]}
    return {
        "passed": all(f.code in accepted for f in findings),
        "support": {"residual": round(built.support.residual, 6), "corners": len(built.support.outline)},
        "objects": objects,
        "removal": [list(layer) for layer in built.removal()],
        "findings": [f.to_json(accepted) for f in findings],
    }
