"""Bring a reconstruction to rest, or reuse how an equal one came to rest before."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path

from simfoundry.assets.cache import Cache
from simfoundry.capture.findings import CaptureFinding
from simfoundry.capture.frame import Frame
from simfoundry.capture.model_stages.joints import ARTICULATED
from simfoundry.capture.outputs.pictures import RenderedScene, first_view
from simfoundry.capture.reconstruct import Progress, Reconstruction
from simfoundry.capture.settling.standing import StandingScene, settle_objects
from simfoundry.capture.shapes.fit import FittedShape
from simfoundry.capture.stages.codec import digest_of
from simfoundry.capture.stages.runner import StageRunner
from simfoundry.runtime.files import write_file, write_files
from simfoundry.scene.lower import lower
from simfoundry.scene.model import Scene
from simfoundry.scene.state import SceneState
from simfoundry.spec.load import load_scene
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.yaml.write import to_yaml
from simfoundry.worlds.settle import SettleResult

# What is kept of a scene at rest: its document, the files and the solids that settling replaced, the findings that it
# added, and the result of the simulation.
_Kept = tuple[bytes, Mapping[str, bytes], Mapping[str, FittedShape], tuple[CaptureFinding, ...], SettleResult]


@dataclass(frozen=True, eq=False)
class RestingScene:
    """A reconstruction at rest, with its scene, the result of settling it, and the digests that its picture needs."""

    reconstruction: Reconstruction
    rendered: RenderedScene
    settled: SettleResult
    shown: Mapping[str, str]


def resting_scene(
    built: Reconstruction,
    frame: Frame,
    scene_file: Path,
    cache: Cache | None,
    progress: Progress,
    stages: StageRunner,
) -> RestingScene:
    """Return a reconstruction at rest, and write it with its meshes to ``scene_file``.

    Raises:
        CaptureError: The objects cannot be brought to rest.
    """
    drawn: list[RenderedScene] = []

    def draw(scene: Scene, state: SceneState) -> None:
        look, processes = partial(first_view, scene, state), stages.processes
        drawing = stages.begin(look if processes is None else partial(processes.run, look, beside=True))
        drawn[:] = [RenderedScene(lambda: scene, state, drawing)]

    def compute() -> _Kept:
        standing = settle_objects(built, frame, scene_file, cache, progress, draw, stages.processes)
        return _kept(built, standing, scene_file)

    inputs = settle_inputs(built)
    result = stages.run("settle", inputs, compute)
    text, files, shapes, findings, settled = result.value
    if not drawn:
        write_files(scene_file.parent, {**_used(built.files, text), **files})
        write_file(scene_file, text)
    loaded = load_scene(scene_file)
    assert isinstance(loaded.spec, SceneSpec)
    rested = replace(
        built,
        spec=loaded.spec,
        files={**_used(built.files, text), **files},
        shapes={**built.shapes, **shapes},
        findings=(*built.findings, *findings),
    )
    rendered = drawn[0] if drawn else RenderedScene(lambda: lower(loaded, cache), settled.state)
    return RestingScene(rested, rendered, settled, picture_inputs(built, inputs, result.digest))


def settle_inputs(built: Reconstruction) -> dict[str, str]:
    """Return the digests of everything that decides how a reconstruction comes to rest."""
    return {
        "spec": digest_of(to_yaml(built.spec).encode()),
        "files": digest_of(dict(sorted(built.files.items()))),
        "shapes": digest_of(dict(sorted(built.shapes.items()))),
        "engine": version("mujoco"),
    }


def picture_inputs(built: Reconstruction, inputs: Mapping[str, str], settled: str) -> dict[str, str]:
    """Return the digests of everything that a picture of a scene at rest shows, besides the image.

    ``inputs`` are those of the stage that brought the scene to rest, and ``settled`` is the digest of its result.
    """
    return {"files": inputs["files"], "labels": digest_of(built.segmentation.labels), "settled": settled}


def _kept(built: Reconstruction, standing: StandingScene, scene_file: Path) -> _Kept:
    after = standing.reconstruction
    files = {path: data for path, data in after.files.items() if built.files.get(path) != data}
    shapes = {name: shape for name, shape in after.shapes.items() if built.shapes.get(name) is not shape}
    findings = after.findings[len(built.findings) :]
    return scene_file.read_bytes(), files, shapes, findings, standing.settled


def _used(files: Mapping[str, bytes], text: bytes) -> dict[str, bytes]:
    """Return the files whose object is still in the scene with this text."""

    def is_used(path: str) -> bool:
        folder = f"{path.rpartition('/')[0]}/"
        jointed = folder.startswith(f"{ARTICULATED}/") and "/".join(folder.split("/")[:2]).encode() in text
        return jointed or Path(path).stem.encode() in text

    return {path: data for path, data in files.items() if is_used(path)}
