"""How success depends on the values that cousins vary: correlations, intervals, choices, and the command."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.statistics.sensitivity import ranks, read_varied, sensitivities
from tests.cli.command import run


def manifest(folder: Path, count: int = 60) -> Path:
    rng = np.random.default_rng(0)
    cousins = [
        {"index": k + 1, "vary": {"object.cup.mass": float(rng.uniform()), "light.key.intensity": float(rng.uniform()),
         "camera.eye.pose": {"x": float(rng.uniform()), "turn_deg": 1.0}, "object.desk.color": ["oak", "white"][k % 2]}}
        for k in range(count)
    ]  # fmt: skip
    path = folder / "manifest.json"
    path.write_text(json.dumps({"simfoundry": "cousins-run/1", "recipe": "cups", "seed": 3, "cousins": cousins}))
    return path


def results(folder: Path, table: Path, policy: str = "expert", recipe: str = "cups") -> Path:
    """Light cups are carried, heavy ones dropped; on the white desk one of three rollouts fails in addition."""
    rollouts: list[dict[str, Any]] = []
    for cousin in json.loads(table.read_text())["cousins"]:
        values, origin = cousin["vary"], {"recipe": recipe, "seed": 3, "index": cousin["index"], "axes": ["vary"]}
        for k in range(3):
            slips = k == 0 and values["object.desk.color"] == "white"
            done = {"success": values["object.cup.mass"] < 0.6 and not slips, "cousin": origin}
            rollouts.append({"task": "t", "policy": policy, "engine": "mujoco", "part": "whole", **done})
    (folder / "results.json").write_text(json.dumps({"scores": [], "rollouts": rollouts}))
    return folder / "results.json"


def test_what_matters_is_found(tmp_path: Path) -> None:
    table = manifest(tmp_path)
    (found,) = sensitivities(read_varied(table), json.loads(results(tmp_path, table).read_text())["rollouts"])
    assert found.cousins == 60 and found.rollouts == 180
    mass, *others = found.numbers
    assert mass.name == "object.cup.mass" and mass.correlation is not None and mass.correlation < -0.6
    assert mass.interval is not None and mass.interval[1] < -0.4 and mass.p is not None and mass.p < 0.01
    by_name = {number.name: number for number in others}
    assert by_name["camera.eye.pose.turn_deg"].correlation is None  # the same in each cousin
    light = by_name["light.key.intensity"]
    assert light.interval is not None and light.interval[0] < 0 < light.interval[1] and (light.p or 0) > 0.05
    rates = {choice.value: choice.rate for choice in found.choices}
    assert rates["oak"].share > rates["white"].share and rates["oak"].of == rates["white"].of == 90


def test_equal_values_share_a_rank() -> None:
    assert list(ranks(np.array([3.0, 1.0, 3.0, 2.0]))) == [3.5, 1.0, 3.5, 2.0]


def test_the_command(tmp_path: Path) -> None:
    table = manifest(tmp_path)
    scores = results(tmp_path, table)
    done = run("correlate", tmp_path, scores, "--by", "vary", "--page", tmp_path / "page.html")
    assert done.code == 0 and "object.cup.mass" in done.out
    assert "expert in mujoco: 180 rollouts of 60 cousins" in done.out
    page = (tmp_path / "page.html").read_text()
    assert "<code>object.cup.mass</code>" in page and "undefined: all values or all rates are equal" in page
    again = run("correlate", tmp_path, scores, "--by", "vary", "--json")
    assert again.json["recipe"] == "cups" and again.json["tables"][0]["numbers"][0]["name"] == "object.cup.mass"
    assert run("correlate", tmp_path, scores, "--by", "vary", "--json").out == again.out
    assert "--page requires --by vary" in run("correlate", scores, scores, "--page", tmp_path / "b.html").err


WRONG = '{"simfoundry": "cousins-run/1", "recipe": "a", "seed": 0, "cousins": [{"index": 1, "vary": {"a": [1]}}]}'


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"simfoundry": "cousins-run/1"}', WRONG, "[" * 9000])
def test_other_files_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(SimfoundryError, match="is not a manifest of cousins; pass the output folder"):
        read_varied(tmp_path)


def test_cousins_of_another_recipe(tmp_path: Path) -> None:
    table = manifest(tmp_path)
    rollouts = json.loads(results(tmp_path, table, recipe="plates").read_text())["rollouts"]
    with pytest.raises(SimfoundryError, match="no rollout is of a cousin of recipe `cups` with seed 3"):
        sensitivities(read_varied(table), rollouts)
