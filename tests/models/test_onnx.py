"""The adapters of ONNX models, with networks of the same inputs and outputs that the tests write themselves."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from simfoundry.models.contract import ModelError
from simfoundry.models.onnx.adapters import NETWORKS, open_network
from simfoundry.models.open import open_model
from simfoundry.models.provenance import licences
from simfoundry.models.setup import ModelSetup
from simfoundry.models.tasks.masks import SegmentationPrompt
from simfoundry.spec.models.model_sources import ModelSource
from tests.models import onnx_files

pytest.importorskip("onnxruntime")

IMAGE = np.full((60, 80, 3), 30, np.uint8)
IMAGE[20:40, 30:60] = 220
MASK = np.zeros((60, 80), bool)
MASK[10:25, 50:70] = True


def setup(task: str, adapter: str, weights: Path) -> ModelSetup:
    """Return a configuration with one ONNX model."""
    source = ModelSource(weights=weights.name, adapter=adapter)
    return ModelSetup(weights.parent, {task: (source, "test")})


def test_lama_paints_the_mask_and_keeps_the_rest(tmp_path: Path) -> None:
    weights = onnx_files.lama(tmp_path / "lama.onnx")
    made = open_model(setup("inpaint", "lama", weights), "inpaint").inpaint(IMAGE, MASK)
    assert (made.image[~MASK] == IMAGE[~MASK]).all() and (made.image[MASK] == 128).all()
    assert made.made_by.name == "lama" and made.made_by.version == "inpainting_lama_2025jan"
    assert made.made_by.weights_sha256 == hashlib.sha256(weights.read_bytes()).hexdigest()


@pytest.mark.parametrize("labels", [(1, 1, 6, 1), (1, 1, 6)])
def test_efficientsam_takes_boxes_and_points(tmp_path: Path, labels: tuple[int, ...]) -> None:
    weights = onnx_files.efficientsam(tmp_path / "sam.onnx", labels)
    model = open_model(setup("segment", "efficientsam-ti", weights), "segment")
    bright = IMAGE[..., 0] > 128
    dark_first = model.segment(IMAGE, SegmentationPrompt(points=((5, 5, 1),)))
    assert (dark_first.masks[0] == ~bright).mean() > 0.98 and dark_first.scores[0] == pytest.approx(0.95)
    # A point beside the object rules the best candidate out.
    second = model.segment(IMAGE, SegmentationPrompt(points=((45, 30, 1), (5, 5, 0))))
    assert (second.masks[0] == bright).mean() > 0.98 and second.scores[0] == pytest.approx(0.9)
    assert second.boxes[0] == pytest.approx([30, 20, 60, 40], abs=1)
    if len(labels) == 3:
        return  # the other file has another shape of the labels only
    two = model.segment(IMAGE, SegmentationPrompt(boxes=((28, 18, 62, 42), (0, 0, 10, 10))))
    assert two.prompts.tolist() == [0, 1]
    with pytest.raises(ModelError, match="by boxes or points"):
        model.segment(IMAGE, SegmentationPrompt(phrases=("mug",)))


def test_da3_is_scaled_by_the_focal_length_of_the_processed_image(tmp_path: Path) -> None:
    weights = onnx_files.da3(tmp_path / "da3.onnx")
    model = open_model(setup("depth", "da3metric-large", weights), "depth")
    image = np.zeros((480, 640, 3), np.uint8)
    K = np.array([[600.0, 0, 319.5], [0, 610.0, 239.5], [0, 0, 1]])
    found = model.estimate_depth(image, K)
    # 640 x 480 becomes 504 x 378: 1.5 * (600 * 504 / 640 + 610 * 378 / 480) / 2 / 300
    np.testing.assert_allclose(found.depth, 1.5 * 605 * 0.7875 / 300, rtol=1e-5)
    with pytest.raises(ModelError, match="needs the intrinsic matrix"):
        model.estimate_depth(image)


@pytest.mark.parametrize("name", NETWORKS)
def test_missing_weights_are_said_with_name_size_licence_and_place(name: str, tmp_path: Path) -> None:
    network, entry = NETWORKS[name], licences()[name]
    with pytest.raises(ModelError) as error:
        open_network(network.task, name, tmp_path / "w.onnx")
    text = str(error.value)
    assert all(word in text for word in (name, f"{network.megabytes:g} MB", entry.weights, entry.source, network.file))
    assert "\n" not in text


def test_other_files_are_refused_in_one_sentence(tmp_path: Path) -> None:
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"not a network")
    with pytest.raises(ModelError, match=r"broken\.onnx cannot be loaded .*download inpainting_lama") as error:
        open_model(setup("inpaint", "lama", broken), "inpaint").inpaint(IMAGE, MASK)
    assert "\n" not in str(error.value)
    other = onnx_files.da3(tmp_path / "da3.onnx")
    with pytest.raises(ModelError, match="is not lama: it has no input `mask`, but image"):
        open_model(setup("inpaint", "lama", other), "inpaint").inpaint(IMAGE, MASK)
    with pytest.raises(ModelError, match="set `adapter` to one of these: `lama`"):
        open_model(setup("inpaint", "magic", other), "inpaint")
    with pytest.raises(ModelError, match="lies outside of the project"):
        ModelSetup(tmp_path, {"inpaint": (ModelSource(weights="../x.onnx", adapter="lama"), "t")}).client("inpaint")
    millimeters = onnx_files.da3(tmp_path / "mm.onnx", raw=1500.0)
    K = np.array([[600.0, 0, 319.5], [0, 600.0, 239.5], [0, 0, 1]])
    with pytest.raises(ModelError, match="is it in millimeters"):
        open_model(setup("depth", "da3metric-large", millimeters), "depth").estimate_depth(
            np.zeros((480, 640, 3), np.uint8), K
        )
