"""Stages of a reconstruction ask the models that are configured, use their answers, and go on without them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from tests.capture.runs import again, ran
from tests.models.stand_ins import StandIns, configured

NAMES = {1: "tin of tea", 2: "jar of jam"}


@pytest.fixture
def annotated(folder: Path) -> StandIns:
    """Stand-ins that know the annotation of the capture, which the capture itself no longer has."""
    file = folder / "capture" / "capture.yaml"
    labels = np.array(Image.open(folder / "out" / "segments.png"))
    data = yaml.safe_load(file.read_text())
    for frame in data["frames"].values():
        del frame["masks"]
    file.write_text(yaml.safe_dump(data))
    return StandIns(labels.astype(np.int32), NAMES)


@pytest.mark.slow  # 4 s: several runs
def test_models_complete_read_segment_and_inpaint(folder: Path, annotated: StandIns) -> None:
    with configured(annotated, folder) as setup:
        run = again(folder, setup=setup)
    assert {"complete_depth", "read_scene", "segment", "inpaint"} <= set(annotated.asked)
    assert {("depth", ""), ("read", ""), ("masks", ""), ("inpaint", "")} <= ran(run)
    assert set(run.reconstruction.names) == {"tin_of_tea", "jar_of_jam"}
    for k, name in NAMES.items():
        number = run.reconstruction.names[name.replace(" ", "_")]
        assert np.array_equal(run.reconstruction.segmentation.labels == number, annotated.labels == k)
    used = run.reconstruction.spec.objects["tin_of_tea"].origin
    assert used is not None
    assert [(use.task, use.name) for use in used.models] == [
        ("complete_depth", "stand-in"),
        ("segment", "stand-in"),
        ("read_scene", "stand-in"),
    ]
    asked = len(annotated.asked)
    assert not ran(again(folder, setup=setup)), "answers are kept: the servers are gone"
    assert len(annotated.asked) == asked
