"""The seven measures of images, on images whose difference is known."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from simfoundry.capture.accuracy.image_metrics import image_agreement, lab
from simfoundry.capture.accuracy.scene_accuracy import truth_camera
from simfoundry.errors import SimfoundryError
from simfoundry.reports.capture import accuracy_text, capture_page
from tests.capture.test_truth import CAMERA, scene
from tests.cli.command import run


def noise(seed: int, shape: tuple[int, int] = (60, 80)) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(30, 226, (*shape, 3)).astype(np.uint8)


def test_equal_images_agree() -> None:
    same = image_agreement(noise(0), noise(0))
    assert (same.mae, same.rmse, same.delta_e, same.edge_mae) == (0, 0, 0, 0) and same.psnr == math.inf
    assert same.ssim == pytest.approx(1) and same.ncc == pytest.approx(1) and same.to_json()["psnr"] is None


def test_a_constant_offset_has_known_errors() -> None:
    image = noise(1)
    off = image_agreement((image + 20).astype(np.uint8), image)
    assert off.mae == off.rmse == pytest.approx(20 / 255)
    assert off.psnr == pytest.approx(-20 * math.log10(20 / 255))
    assert off.ncc == pytest.approx(1) and off.edge_mae == pytest.approx(0, abs=1e-12), "brightness is no misalignment"
    assert 0.9 < off.ssim < 1 and off.delta_e > 5


def test_unrelated_inverted_and_plain_images() -> None:
    a, b = noise(2), noise(3)
    unrelated, inverted = image_agreement(a, b), image_agreement((255 - a).astype(np.uint8), a)
    assert abs(unrelated.ncc) < 0.03 and abs(unrelated.ssim) < 0.1 and inverted.ncc == pytest.approx(-1)
    assert inverted.edge_mae == pytest.approx(0, abs=1e-12)
    assert math.isnan(image_agreement(np.full_like(a, 9), a).ncc)


def test_edges_of_a_step() -> None:
    step = np.zeros((20, 30, 3), np.uint8)
    step[:, 15:] = 255
    flat = image_agreement(np.zeros_like(step), step)
    # The Sobel operator answers 4 of at most 4 sqrt(2) in the two columns beside the step.
    assert flat.edge_mae == pytest.approx(2 / 30 / math.sqrt(2))


def test_colors_of_cielab() -> None:
    """Reference values of the sRGB primaries, D65."""
    known = {
        (1, 1, 1): (100, 0, 0),
        (0, 0, 0): (0, 0, 0),
        (1, 0, 0): (53.24, 80.09, 67.20),
        (0, 0, 1): (32.30, 79.19, -107.86),
    }
    for rgb, expected in known.items():
        assert lab(np.array(rgb, dtype=float)) == pytest.approx(expected, abs=0.05)


def test_only_pixels_of_the_mask_count() -> None:
    a, mask = noise(4), np.zeros((60, 80), dtype=bool)
    b = a.copy()
    b[:, 40:] = 0
    mask[:, :20] = True
    assert image_agreement(b, a, mask).mae == 0 and image_agreement(b, a).mae > 0.1
    with pytest.raises(ValueError, match="images"):
        image_agreement(a[:50], a)
    with pytest.raises(ValueError, match="images"):
        image_agreement(a, a, np.zeros_like(mask))


def test_the_camera_of_the_truth() -> None:
    assert truth_camera(scene(), "other").name == "view"
    two = replace(scene(), cameras=(CAMERA, replace(CAMERA, name="top")))
    assert truth_camera(two, "top").name == "top"
    with pytest.raises(SimfoundryError, match=r"has no camera `side`.*`view`, `top`"):
        truth_camera(two, "side")


def test_a_capture_is_compared_with_its_truth(folder: Path) -> None:
    """The command, its JSON, and the page say the same."""
    out = folder / "out"
    done = run("capture", folder / "capture", "-o", out, "--against", folder / "two.scene.yaml", "--json")
    assert done.code == 0, done.err
    accuracy = done.json["accuracy"]
    assert accuracy["summary"]["found"] == accuracy["summary"]["true"] == 2 and accuracy["summary"]["extra"] == []
    assert accuracy["summary"]["chamfer"]["mean"] < 0.005 and accuracy["summary"]["f1"]["mean"] > 0.95
    inside, whole = accuracy["scene_image"], accuracy["image"]
    assert inside["psnr"] > whole["psnr"] > 10 and inside["ncc"] > 0.8 and inside["delta_e"] < whole["delta_e"]
    assert accuracy == json.loads((out / "report.json").read_text())["accuracy"]
    page = (out / "report.html").read_text()
    text = run("capture", folder / "capture", "-o", out, "--against", folder / "two.scene.yaml").out
    assert accuracy_text(accuracy) in text and "2 of 2 objects" in page and "accuracy.png" in page
    mean = f"{accuracy['summary']['f1']['mean']:.2f} ± {accuracy['summary']['f1']['std']:.2f}"
    assert mean in page and mean in text
    assert run("capture", folder / "capture", "-o", out).code == 0 and not (out / "accuracy.png").exists()


def test_a_page_without_an_accuracy_escapes_names() -> None:
    finding = {"code": "SF601", "message": "<b>", "hint": "", "place": "", "accepted": True}
    held = {"pixels": 9, "fit": 0.001, "confidence": 0.5, "settle": {}}
    page = capture_page({"source": "a/b", "passed": True, "findings": [finding], "objects": {"cup": held}}, {})
    assert "&lt;b&gt; (accepted)" in page and "passed: 1 objects, 0 open findings, 1 accepted" in page
    assert "<td>held</td>" in page
