"""Changes in the words of the reuse."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.spec.change.compare import compare, side
from simfoundry.spec.change.flatten import flatten
from simfoundry.spec.load import load
from tests.spec.compose.documents import DESK, written

SCENE = f"""\
simfoundry: scene/1
name: a
parameters: {{gap: 0.12}}
include: {{side: {{scene: side.scene.yaml, pose: {{xyz: [0, 1, 0]}}}}}}
templates: {{dish: {{shape: {{sphere: 0.03}}, mass: 0.2}}}}
objects:
{DESK}  cup: {{like: dish, place: {{on: desk, xy: [0, 0]}}, repeat: {{count: [4, 3], step: [$gap, 0.12]}}}}
  mug: {{like: dish, place: {{on: cup}}, repeat: cup}}
  bowl: {{like: dish, place: {{on: desk, xy: [-0.5, 0]}}}}
"""


def lines(folder: Path, old: str, new: str) -> list[str]:
    written(folder, f"simfoundry: scene/1\nname: side\nobjects:\n{DESK}", "side.scene.yaml")
    before, after = (written(folder, text, f"{name}.scene.yaml") for name, text in (("old", old), ("new", new)))
    return compare("a", side(before, "old"), side(after, "new")).lines()


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("count: [4, 3]", "count: [4, 4]", ["cup: 4 × 3 → 4 × 4, 4 more"]),
        ("count: [4, 3]", "count: [2, 3]", ["cup: 4 × 3 → 2 × 3, 6 fewer"]),
        (", 0.12]", ", 0.2]", ["cup: step [0.12, 0.12] → [0.12, 0.2] m"]),
        ("gap: 0.12", "gap: 0.2", ["parameters gap 0.12 → 0.20", "cup: step [0.12, 0.12] → [0.2, 0.12] m"]),
        ("mass: 0.2", "mass: 0.3", ["template dish: mass 0.2 → 0.3 kg (of cup, mug, bowl)"]),
        ("[0, 1, 0]", "[0, 2, 0]", ["include side moved 1.000 m (+y 1.000)"]),
        ("on: cup}, ", "on: cup}, color: [1, 0, 0], ", ["mug (12 copies): color now #ff0000"]),
        ("mug: {", "jug: {", ["mug (12 copies) renamed to jug"]),
        ("  bowl", "  cup_1_2: {friction: 0.9}\n  bowl", ["cup_1_2: friction now 0.9"]),
        (
            "xy: [-0.5, 0]}",
            "xy: [-0.5, 0], frame: side}",
            ["bowl is now on desk at (-0.5, 0) m, in the frame side (was on desk at (-0.5, 0) m)"],
        ),
        ("xy: [0, 0]}", "xy: [0, 0], offset: [0.1, 0]}", ["cup (12 copies) moved 10.0 cm (+x 10.0)"]),
        ("  bowl", "  cup_1_2: null\n  bowl", ["cup_1_2 removed", "mug_1_2 removed"]),
    ],
)
def test_a_change_is_described_as_it_was_written(tmp_path: Path, old: str, new: str, expected: list[str]) -> None:
    assert SCENE.replace(old, new) != SCENE
    assert lines(tmp_path, SCENE, SCENE.replace(old, new))[:-1] == expected


def test_writing_everything_out_changes_nothing(tmp_path: Path) -> None:
    assert lines(tmp_path, SCENE, SCENE) == ["no difference"]
    spec = load(tmp_path / "old.scene.yaml").spec
    assert spec is not None
    assert lines(tmp_path, SCENE, flatten(spec)) == ["equivalent, written differently"]
