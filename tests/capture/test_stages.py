"""Stages are files that later runs reuse: whatever changes, only what depends on it runs again."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from simfoundry.capture.frame import Segmentation
from simfoundry.capture.inputs import examine
from simfoundry.capture.reconstruct import nearby_labels
from simfoundry.capture.shapes.fit import FittedShape
from simfoundry.capture.stages.codec import decode, digest_of, encode
from simfoundry.capture.stages.runner import StageRunner, StaleStageError
from simfoundry.capture.stages.stage import STAGES, stage_index
from simfoundry.capture.stages.store import StageStore, stage_folder
from simfoundry.errors import OutputError, SimfoundryError
from simfoundry.geometry.frames import Pose
from simfoundry.geometry.shapes import Box, revolved
from simfoundry.runtime.files import locked_folder
from tests.capture.runs import again, output, ran

SUPPORT, SEGMENT, SHAPE = (stage_folder(Path(), STAGES[stage_index(name)]) for name in ("support", "segment", "shape"))


def number(name: str, folder: Path) -> str:
    """The number of an object, by the word of its color."""
    scene = (folder / "out" / "capture.scene.yaml").read_text()
    _, _, rest = scene.partition(f"{name}_box:")
    return rest.partition("segment: ")[2].split("}")[0].split()[0].strip(",}")


# -- runs ---------------------------------------------------------------------------------------------------------


def test_a_run_without_changes_runs_nothing_and_writes_the_same(folder: Path) -> None:
    before = output(folder)
    run = again(folder)
    always = {stage.name for stage in STAGES if not stage.is_optional} - {"pose"}
    assert ran(run) == set() and {stage for stage, _ in run.states} == always
    assert output(folder) == before
    assert {status.state for status in examine(folder / "out")} == {"cached"}


def test_a_changed_mask_touches_only_its_object(folder: Path) -> None:
    file = folder / "capture" / "instances.png"
    masks = np.array(Image.open(file))
    red = int(number("red", folder))
    labels = np.array(Image.open(folder / "out" / "segments.png"))
    rows, columns = np.nonzero(labels == red)
    masks[labels == red] = np.where(rows < np.quantile(rows, 0.2), 0, masks[labels == red])
    Image.fromarray(masks).save(file)
    states = {(s.stage, s.object): s.state for s in examine(folder / "out")}
    assert states["support", ""] == "cached" and states["segment", ""] == "stale" and states["name", ""] == "stale"
    assert states["shape", "green_box"] == "cached" and states["shape", "red_box"] == "stale"
    run = again(folder)
    changed = {
        ("remove", ""),
        ("shape", str(red)),
        ("texture", str(red)),
        ("texture", "table"),
        ("name", ""),
        ("doubts", ""),
        ("settle", ""),
        ("pictures", ""),
    }
    assert ran(run) == {("frames", ""), ("segment", ""), *changed}
    assert len(columns) and len(run.reconstruction.shapes) == 2


@pytest.mark.slow  # 2 s: several runs
def test_objects_keep_their_results_when_numbers_change(folder: Path) -> None:
    file = folder / "capture" / "instances.png"
    masks, labels = np.array(Image.open(file)), np.array(Image.open(folder / "out" / "segments.png"))
    masks[labels == 1] = 0
    Image.fromarray(masks).save(file)
    run = again(folder)
    assert len(run.reconstruction.shapes) == 1
    assert not {key for key in ran(run) if key[0] == "shape"}, "object 2 is now 1, and nothing else about it changed"
    assert len(list((folder / "out" / "stages" / SHAPE).iterdir())) == 1


@pytest.mark.slow  # 2 s: several runs
def test_stages_are_run_again_on_request(folder: Path) -> None:
    before = output(folder)
    red = number("red", folder)
    assert ran(again(folder, redo_from="texture", only=("red_box",))) == {("texture", red)}
    later = {"name", "texture", "faults", "doubts", "settle", "pictures"}
    assert {stage for stage, _ in ran(again(folder, redo_from="name"))} == later
    assert ran(again(folder, only=("red_box",))) == {("shape", red), ("texture", red)}
    assert output(folder) == before
    with pytest.raises(SimfoundryError, match="no object `red_bax`; did you mean `red_box`"):
        again(folder, only=("red_bax",))
    with pytest.raises(SimfoundryError, match="no stage `shapes`; did you mean `shape`"):
        again(folder, redo_from="shapes")
    assert output(folder) == before


@pytest.mark.slow  # 2 s: several runs
def test_damaged_and_edited_results_are_not_used(folder: Path) -> None:
    before = output(folder)
    stages = folder / "out" / "stages"
    (stages / SEGMENT / "labels.png").write_bytes(b"edited")
    (stages / SUPPORT / "stage.json").write_text("{}")
    for file in (stages / SHAPE).glob("*/value.json"):
        file.unlink()
    states = {(s.stage, s.object): s.state for s in examine(folder / "out")}
    assert {stage for (stage, _), state in states.items() if state == "cached"} == {"frames"}
    run = again(folder)
    assert {stage for stage, _ in ran(run)} == {"support", "segment", "shape"}, "equal results keep later ones valid"
    assert output(folder) == before


def test_two_runs_at_once_are_refused(folder: Path) -> None:
    with locked_folder(folder / "out" / "stages", "x"), pytest.raises(OutputError, match="in use by another run"):
        again(folder)


def test_the_state_of_another_folder_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(SimfoundryError, match="is not the output of a capture"):
        examine(tmp_path)


# -- parts --------------------------------------------------------------------------------------------------------


def test_results_are_read_as_they_were_written() -> None:
    rng = np.random.default_rng(0)
    labels = rng.integers(0, 9, (40, 50)).astype(np.int32)
    mesh = revolved([(0.0, 0.1), (0.04, 0.1), (0.03, 0.0), (0.0, 0.0)])
    shape = FittedShape(mesh, Pose.of([0.1, 0.2, 0.3], [0.5, 0.1, -0.7, 0.2]), 0.1 + 0.2, 0.9, True, rng.random((3, 2)))
    value = [Segmentation(labels, {3: 0, 5: 3}, {"cup": 3}, ("no cup",)), shape, Box(np.array([0.1, 0.2, 0.3])), b"\0x"]
    read = decode(encode(value))
    assert digest_of(read) == digest_of(value) and encode(read) == encode(value)
    assert read[0].labels.dtype == np.int32 and np.array_equal(read[0].labels, labels)
    assert read[0].supports == {3: 0, 5: 3} and read[1].fit_m == 0.1 + 0.2 and read[1].hollow is True
    assert np.array_equal(read[1].geometry.vertices, mesh.vertices) and np.array_equal(read[1].X_WO.q, shape.X_WO.q)
    with pytest.raises(TypeError, match="Path is not a result of a stage"):
        encode(Path())


def test_digests_tell_arrays_apart() -> None:
    arrays = [np.zeros((2, 3)), np.zeros((3, 2)), np.zeros((2, 3), np.float32), np.ones((2, 3)), np.ones((3, 2)).T[:1]]
    values = [*arrays, b"", None, (), "", 1, 1.0, True, "1", ((1,), 1), (1, (1,)), {1: 1}, Box(np.ones(3)), (b"", b"")]
    assert len({digest_of(value) for value in values}) == len(values)
    assert digest_of([np.float64(0.1), np.bool_(True), {"a": [2]}]) == digest_of((0.1, True, {"a": (2,)}))
    assert digest_of(np.arange(6.0).reshape(2, 3).T) == digest_of(np.array([[0.0, 3.0], [1.0, 4.0], [2.0, 5.0]]))
    with pytest.raises(TypeError, match="Path is not a result of a stage"):
        digest_of([Path()])


def test_a_runner_that_examines_computes_nothing(tmp_path: Path) -> None:
    def fail() -> int:
        raise AssertionError

    assert StageRunner(StageStore(tmp_path)).run("support", {"a": "1"}, lambda: 7).value == 7
    examining = StageRunner(StageStore(tmp_path), examine=True)
    assert examining.run("support", {"a": "1"}, fail).value == 7
    with pytest.raises(StaleStageError):
        examining.run("support", {"a": "2"}, fail)
    assert json.loads((tmp_path / SUPPORT / "stage.json").read_text())["inputs"] == {"a": "1"}


def test_what_is_far_from_an_object_does_not_matter_to_it() -> None:
    labels = np.zeros((200, 300), np.int32)
    labels[90:110, 100:120], labels[90:110, 122:127], labels[90:110, 250:270] = 4, 7, 9
    near = nearby_labels(labels, 4)
    assert set(np.unique(near)) == {0, 1, 2} and (near == 1).sum() == 400 and not near[:, 250:].any()
    assert np.array_equal(near == 2, labels == 7)
    assert not nearby_labels(labels, 1).any()


def test_a_stage_depends_on_what_its_code_imports() -> None:
    names = {stage.name: {file.name for file in stage.files} for stage in STAGES}
    assert {"load.py", "image_files.py", "sensors.py", "fusion.py"} <= names["frames"]
    assert {"stated.py", "register_mesh.py", "solid_casts.py"} <= names["pose"]
    assert {"decompose.py", "merge_weights.npz"} <= names["segment"] and "fit.py" not in names["segment"]
    assert "decompose.py" not in names["texture"]
