"""The demo, which reconstructs a capture, compiles and simulates the scene, and compares it with the ground truth."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from simfoundry.assets.cache import Cache
from simfoundry.capture.accuracy.scene_accuracy import SceneAccuracy
from simfoundry.capture.frames.load import checked_frame_name, open_capture
from simfoundry.capture.reconstruct import Progress
from simfoundry.capture.run import CaptureOptions, CaptureRun, ReportPage, run_capture
from simfoundry.errors import MissingEngineError
from simfoundry.runtime.files import shipped
from simfoundry.scene.lower import lower_file
from simfoundry.spec.files import Loaded
from simfoundry.spec.models.capture import CaptureSpec
from simfoundry.targets.build import TARGETS, build
from simfoundry.worlds import open_world, world_names
from simfoundry.worlds.rest import ObjectMotion, simulate


@dataclass(frozen=True, eq=False)
class Demo:
    """The results of a demo.

    ``worlds`` maps each target to its entry file. ``motions`` maps each engine to the object motions, or to the reason
    why the engine did not run. ``comparison`` compares the reconstruction with the ground truth.
    """

    run: CaptureRun
    worlds: dict[str, Path]
    motions: dict[str, list[ObjectMotion] | str]
    comparison: SceneAccuracy | None
    picture: Path

    def to_json(self) -> dict[str, Any]:
        """Return the results as plain data for JSON."""
        return {
            "scene": str(self.run.scene_file),
            "picture": str(self.picture),
            "report": self.run.report,
            "worlds": {k: str(v) for k, v in self.worlds.items()},
            "motions": {k: v if isinstance(v, str) else [asdict(m) for m in v] for k, v in self.motions.items()},
            "truth": [] if self.comparison is None else [o.to_json() for o in self.comparison.objects],
        }


def own_capture() -> Path:
    """Return the folder of the capture that is shipped with the project."""
    return shipped("specs/captures/desk")


def run_demo(
    capture: Path, out: Path, frame: str | None, progress: Progress, force: bool, page: ReportPage | None = None
) -> Demo:
    """Run the demo, and write its results to ``out/scene`` and ``out/worlds``.

    ``page`` makes an HTML page of the report, as in :func:`run_capture`.

    Raises:
        SpecError: The capture is unusable.
    """
    cache = Cache.default()
    loaded = open_capture(capture)
    truth = _truth(loaded, checked_frame_name(loaded, frame))

    def watch(stage: str, share: float) -> None:
        progress(stage, 0.7 * share)

    run = run_capture(capture, out / "scene", watch, cache, CaptureOptions(frame, force, truth=truth, page=page))
    scene = lower_file(run.scene_file, cache)
    progress("compile", 0.75)
    artifacts = build(scene, TARGETS, out / "worlds", force)
    motions: dict[str, list[ObjectMotion] | str] = {}
    for k, engine in enumerate(world_names()):
        progress(f"run in {engine}", 0.8 + 0.1 * k)
        try:
            with open_world(scene, engine) as world:
                motions[engine] = simulate(world)
        except MissingEngineError as error:
            motions[engine] = f"did not run: {error}"
    worlds = {a.target: out / "worlds" / a.target / a.entry for a in artifacts}
    return Demo(run, worlds, motions, run.accuracy, out / "scene" / "compare.png")


def _truth(loaded: Loaded, frame: str) -> Path | None:
    """Return the ground truth of a capture, or None if there is none or if it does not contain the frame's camera."""
    assert isinstance(loaded.spec, CaptureSpec)
    if loaded.spec.truth is None:
        return None
    path = loaded.file(loaded.spec.truth)
    return path if any(c.name == frame for c in lower_file(path, Cache.default()).cameras) else None
