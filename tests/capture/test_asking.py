"""One mechanism asks models for stages; objects are removed from front to back; parts are whole triangles."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from simfoundry.capture.frame import Frame, Segmentation, SupportSurface
from simfoundry.capture.frames.load import load_frame, open_capture
from simfoundry.capture.model_stages.ask import MODEL_STAGES, Makers, StageModels
from simfoundry.capture.model_stages.joints import LEAST_FACES, subdivided
from simfoundry.capture.removal import cleared_images, removal_order
from simfoundry.capture.stages.codec import decode, encode
from simfoundry.capture.stages.runner import StageRunner
from simfoundry.capture.stages.stage import STAGES
from simfoundry.capture.stages.store import StageStore
from simfoundry.geometry.frames import Pose
from simfoundry.geometry.shapes import Box, Mesh, tessellate
from simfoundry.models.contract import ModelError
from simfoundry.models.provenance import ModelIdentity
from simfoundry.models.setup import ModelSetup
from simfoundry.models.tasks.registry import TASKS
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.models.model_sources import ModelSource
from tests.capture import captures
from tests.models.stand_ins import StandIns, configured

MAKER = ModelIdentity(name="maker", version="2", licence="MIT", commercial=True)
SOURCE = ModelSource(url="http://127.0.0.1:9")


def answering(value: int) -> Callable[[ModelSetup], tuple[int, Makers]]:
    return lambda setup: (value, {"mesh": MAKER})


def failing(error: Exception) -> Callable[[ModelSetup], tuple[int, Makers]]:
    def fail(_: ModelSetup) -> tuple[int, Makers]:
        raise error

    return fail


def models(folder: Path, **sources: ModelSource) -> StageModels:
    setup = ModelSetup(folder, {task: (source, "a test") for task, source in sources.items()})
    return StageModels(setup, StageRunner(StageStore(folder)))


def test_every_stage_that_asks_is_a_stage_and_every_task_is_one() -> None:
    optional = {stage.name for stage in STAGES if stage.is_optional}
    assert optional == {*MODEL_STAGES, "register"}, "the last one runs with a CAD library"
    assert {task for stage in MODEL_STAGES.values() for task in stage.tasks} <= set(TASKS)


def test_an_answer_is_kept_with_its_model(tmp_path: Path) -> None:
    first = models(tmp_path, mesh=SOURCE).ask("mesh", {"a": "1"}, answering(7), "3")
    assert first is not None and first.value == 7
    again = models(tmp_path, mesh=SOURCE).ask("mesh", {"a": "1"}, failing(AssertionError()), "3")
    assert again is not None and again.value == 7 and again.models == first.models
    assert [(use.task, use.name, use.commercial) for use in again.models] == [("mesh", "maker", "allowed")]
    elsewhere = models(tmp_path, mesh=SOURCE.model_copy(update={"timeout_s": 3.0}))
    changed = elsewhere.ask("mesh", {"a": "1"}, answering(8), "3")
    assert changed is not None and changed.value == 8, "another source is another question"


def test_a_model_that_fails_twice_in_a_row_is_not_asked_again(tmp_path: Path) -> None:
    asked = models(tmp_path, mesh=SOURCE, read_scene=ModelSource(offline=True))
    assert asked.ask("read", {}, failing(AssertionError())) is None, "offline means that no model is asked"
    assert asked.ask("mesh", {}, failing(ModelError("no\nanswer")), "1") is None
    assert asked.ask("mesh", {}, answering(1), "2") is not None
    for label, error in (("3", ValueError("not a mesh")), ("4", np.linalg.LinAlgError("singular"))):
        assert asked.ask("mesh", {}, failing(error), label) is None
    assert asked.ask("mesh", {}, failing(AssertionError()), "5") is None, "it is not asked"
    (finding,) = asked.findings({"1": "cup", "3": "jar", "5": "can"})
    assert (finding.code, finding.message, finding.objects) == ("SF640", "no answer", ("can", "cup", "jar"))
    assert finding.hint.startswith("the solids that were fitted to the depth are used")
    with pytest.raises(AssertionError):  # an error of ours is not one of a model
        models(tmp_path, mesh=SOURCE).ask("mesh", {"b": "2"}, failing(AssertionError()), "6")


def table_with_two() -> tuple[Frame, SupportSurface, Segmentation]:
    """A wall 1 m in front of the camera with a block before it, half of which another block hides."""
    depth, labels = np.full((60, 80), 1.0), np.zeros((60, 80), np.int32)
    color = np.full((60, 80, 3), 200, np.uint8)
    for k, window, z in ((1, np.s_[15:45, 30:60], 0.8), (2, np.s_[20:40, 15:42], 0.6)):
        depth[window], labels[window], color[window] = z, k, 60 * k
    K = np.array([[80.0, 0, 39.5], [0, 80.0, 29.5], [0, 0, 1]])
    X_WC = Pose.of([0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 0.0])  # looks down
    outline = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    return Frame(color, depth, K), SupportSurface(X_WC, outline, 0.0, labels == 0), Segmentation(labels, {1: 0, 2: 0})


def test_objects_in_front_are_removed_first() -> None:
    frame, support, segmentation = table_with_two()
    assert removal_order(frame, segmentation) == ((2,), (1,))
    stacked = Segmentation(segmentation.labels, {1: 2, 2: 0})
    assert removal_order(frame, stacked) == ((2,), (1,)), "they hide and carry each other: the nearest goes first"
    first, last = cleared_images(frame, support, segmentation, {})
    assert first.removed == (2,) and last.removed == (1, 2)
    assert np.allclose(last.depth, 1.0) and not last.shown.any(), "what is left is the plane of the support"
    assert (np.abs(last.color.astype(int) - 200) < 12).all()
    assert (first.depth == 0.8).sum() == (segmentation.labels == 1).sum(), "without a solid, nothing is continued"


def test_a_finer_surface_is_the_same_surface() -> None:
    box = tessellate(Box(np.array([0.1, 0.2, 0.3])))
    fine = subdivided(Mesh(box.vertices, box.faces, box.vertices[:, :2], b"x"))
    assert len(fine.faces) >= LEAST_FACES and fine.uv is not None
    assert np.allclose(fine.uv, fine.vertices[:, :2]), "texture coordinates are interpolated"

    def volume(mesh: Mesh) -> float:
        a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
        return float((a * np.cross(b, c)).sum() / 6)

    assert np.isclose(volume(fine), 0.006) and np.isclose(volume(box), 0.006)


def test_depth_from_a_model_states_the_model(tmp_path: Path) -> None:
    folder = captures.write(tmp_path / "a")
    captures.edit(folder, "depth:\n      image: depth.png\n      scale: 0.001", "pose: {}")
    stand_ins = StandIns(np.zeros((captures.HEIGHT, captures.WIDTH), np.int32), {}, measured=captures.plane())
    with configured(stand_ins, tmp_path, "depth") as setup:
        frame = load_frame(open_capture(folder), setup=setup)
        assert np.allclose(frame.depth, captures.plane()) and [use["task"] for use in frame.models] == ["depth"]
        assert frame.models[0]["name"] == "stand-in" and decode(encode(frame)).models == frame.models
    stand_ins.measured = 1000 * captures.plane()  # in millimeters
    with configured(stand_ins, tmp_path, "depth") as setup, pytest.raises(SpecError, match="millimeters"):
        load_frame(open_capture(folder), setup=setup)
