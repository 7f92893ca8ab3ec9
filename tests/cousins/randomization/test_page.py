"""What docs/cousins.md and the example recipes vary is drawn, and always the same."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from simfoundry.cousins.run.candidates import CandidateSampler
from simfoundry.spec.load import load
from tests.conftest import REPOSITORY

PAGE = (REPOSITORY / "docs" / "cousins.md").read_text()
EXAMPLES = re.findall(r"^```yaml\n(vary:.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
HEAD = "simfoundry: cousins/1\nname: page\ntwin: {twin}\n"
GOLDEN = Path(__file__).parent / "golden.json"
RECIPES = ("cup_in_bowl_pictures", "cup_in_bowl_randomized")


@pytest.mark.parametrize("example", EXAMPLES)
def test_the_examples_of_the_page(example: str) -> None:
    twin = "specs/tasks/cup_in_bowl.task.yaml"
    path = REPOSITORY / "page.cousins.yaml"
    text = HEAD.format(twin=twin) + example
    assert load(path, text=text).all_findings() == []


def test_the_values_of_the_example_recipes(update_goldens: bool) -> None:
    """The values depend on hashes and on plain arithmetic, so they are the same on every machine."""
    found: dict[str, Any] = {}
    for name in RECIPES:
        path = REPOSITORY / "specs" / "cousins" / f"{name}.cousins.yaml"
        sampler = CandidateSampler.load(path, REPOSITORY / "build" / name, 7)
        for k in (1, 2):
            drawn = sampler.values.draw(k, {})
            found[f"{name} {k}"] = {"vary": drawn.values, "split": drawn.split, "pictures_only": drawn.pictures_only}
    text = json.dumps(found, indent=1) + "\n"
    if update_goldens:
        GOLDEN.write_text(text)
    assert json.loads(text) == json.loads(GOLDEN.read_text())
