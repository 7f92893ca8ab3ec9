"""Scenes that a vision-language model reads; the model is pydantic-ai's own stand-in for tests."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("pydantic_ai", reason="the extra `vlm` is not installed")
from pydantic_ai.models.test import TestModel

from simfoundry.models.contract import ModelError
from simfoundry.models.open import open_model
from simfoundry.models.setup import load_setup
from simfoundry.models.vlm import Vlm
from simfoundry.models.vlm_scenes import VlmScenes
from tests.models.test_tasks import FRAMES


def _reader(box: list[float]) -> VlmScenes:
    seen = {"phrase": "blue mug", "category": "mug", "material": "ceramic", "box": box, "mass": 0.3}
    answer = {"objects": [seen], "support": "desk"}
    return VlmScenes(Vlm(TestModel(custom_output_args=answer), mode="tool"))


def test_a_scene_is_read_in_types_and_boxes_are_checked() -> None:
    found = _reader([24, 16, 40, 32]).read_scene(FRAMES[0])
    (mug,) = found.reading.objects
    assert (mug.phrase, mug.mass, mug.is_articulated, found.reading.support) == ("blue mug", 0.3, False, "desk")
    assert found.made_by.name == "test" and found.made_by.licence == "terms of the provider"
    with pytest.raises(ModelError, match=r"from test has a box of `blue mug`.*thousandths of the image"):
        _reader([333, 375, 666, 625]).read_scene(FRAMES[0])
    with pytest.raises(ModelError, match="did not return a valid response"):
        _reader([0, 0, 1]).read_scene(FRAMES[0])


def test_a_provider_is_configured_for_scenes_only(tmp_path: Path) -> None:
    (tmp_path / "simfoundry.yaml").write_text("models: {tasks: {read_scene: {vlm: test}, depth: {vlm: test}}}")
    setup = load_setup(tmp_path, {})
    assert isinstance(open_model(setup, "read_scene"), VlmScenes)
    with pytest.raises(ModelError, match="for read_scene and articulate only, not for `depth`"):
        open_model(setup, "depth")
