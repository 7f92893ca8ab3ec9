"""Values that are valid but not meant: those in another unit are found, and those that people write are not."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.spec.check.plausible import in_radians
from simfoundry.spec.load import load

SCENE = """\
simfoundry: scene/1
name: a
{more}
objects:
  desk: {{fixed: true, shape: {{box: [1, 1, 0.1]}}, pose: {{xyz: [0, 0, 0], {pose}}}}}
"""
ASSET = """\
simfoundry: asset/1
name: a
links:
  a: {{mass: 1, parts: {{p: {{shape: {{sphere: 0.1}}}}}}}}
  b: {{mass: 1, parts: {{p: {{shape: {{sphere: 0.1}}}}}}}}
joints: {{j: {{type: {type}, parent: a, child: b, {limits}}}}}
"""


@pytest.mark.parametrize(
    "text",
    ["1.57", "-1.57", "3.14", "3.142", "6.28", "0.785", "-0.785", "2.356", "1.5708", "3.14159265", "0.5236", ".7854"],
)
def test_fractions_of_pi_look_like_radians(text: str) -> None:
    assert in_radians(text)


@pytest.mark.parametrize(
    "text",
    ["90", "1.5", "1", "0", "0.0", "0.00", "0.52", "0.79", "45.0", "180", "1.58", "157.08", "-+1.57", "1.57e0", "x"],
)
def test_other_angles_do_not(text: str) -> None:
    assert not in_radians(text)


def codes(tmp_path: Path, text: str, name: str = "a.scene.yaml") -> list[str]:
    (tmp_path / "simfoundry.yaml").touch()
    (tmp_path / name).write_text(text)
    loaded = load(tmp_path / name)
    return [d.code for d in loaded.findings]


@pytest.mark.parametrize(
    ("written", "code"),
    [
        ("description: 017", "SF103"),  # a number where text is expected
        ("description: 12:30", "SF441"),
        ("description: 1_000", "SF441"),
        ("description: 2024-05-01", "SF441"),
        ("description: Yes", "SF441"),
        ("description: 0b11", "SF441"),
        ("gravity: [0, 0, -9_81]", "SF103"),
        ("gravity: [0, 0, -010]", "SF441"),
        ("gravity: [0, 0, -09]", "SF441"),
        ("gravity: [0, 0, -1e1]", "SF441"),
        ("gravity: [0, 0, -1.0e1]", "SF441"),
        ("gravity: [1e-3, 0, -9.81]", "SF441"),
        ("gravity: [0x1, 0, -9.81]", ""),
        ("gravity: [0o1, 0, -9.81]", "SF441"),
        ("gravity: [1.0e-3, 0, -9.81]", ""),
        ("gravity: [+.5, 0, -9.81]", "SF441"),
        ("gravity: [0.50, -0.0, -9.]", ""),
        ("gravity: [0, 0, 0]", ""),
        ("gravity: [0, 0, -1.62]", ""),
        ("gravity: [1, 1, -9.7]", ""),
        ("gravity: [0, 0, 1]", "SF431"),
        ("gravity: [-9.81, 0, 0]", "SF431"),
        ("gravity: [0, 0, -981]", "SF431"),
        ('description: "on"', ""),
        ("description: on top of the desk", ""),
        ("description: |\n  017", ""),
        ("description: " + "1:" * 5000 + "1", ""),  # YAML 1.1 would compute with numbers of thousands of digits
    ],
)
def test_values_that_others_read_differently(written: str, code: str, tmp_path: Path) -> None:
    assert codes(tmp_path, SCENE.format(more=written, pose="yaw_deg: 90")) == ([code] if code else [])


@pytest.mark.parametrize(
    ("pose", "code"),
    [
        ("yaw_deg: 1.5708", "SF434"),
        ("rpy_deg: [0, 90, -3.1416]", "SF434"),
        ("yaw_deg: 1.5", ""),
        ("yaw_deg: 157.08", ""),
        ("quat_wxyz: [0.7071, 0, 0, 0.7071]", ""),
    ],
)
def test_angles_in_radians(pose: str, code: str, tmp_path: Path) -> None:
    assert codes(tmp_path, SCENE.format(more="", pose=pose)) == ([code] if code else [])


@pytest.mark.parametrize(
    ("kind", "limits", "code"),
    [
        ("revolute", "limits_deg: [-3.14, 3.14]", "SF435"),
        ("revolute", "limits_deg: [0, 1.5708]", "SF435"),
        ("revolute", "limits_deg: [-2.8973, 2.8973]", "SF435"),
        ("revolute", "limits_deg: [0, 1.5]", ""),
        ("revolute", "limits_deg: [-5, 5]", ""),
        ("revolute", "limits_deg: [-0.286479, 0.286479]", ""),
        ("revolute", "limits_deg: [0, 90]", ""),
        ("prismatic", "limits: [0, 150]", "SF435"),
        ("prismatic", "limits: [0, 2.5]", ""),
        ("prismatic", "limits: [-1000, 1000]", ""),  # importers write this for a joint without limits
    ],
)
def test_limits_in_another_unit(kind: str, limits: str, code: str, tmp_path: Path) -> None:
    assert codes(tmp_path, ASSET.format(type=kind, limits=limits), "a.asset.yaml") == ([code] if code else [])


def test_a_value_of_the_base_is_reported_where_it_is_written(tmp_path: Path) -> None:
    codes(tmp_path, SCENE.format(more="", pose="yaw_deg: 1.5708"), "base.scene.yaml")
    (tmp_path / "a.scene.yaml").write_text("simfoundry: scene/1\nname: b\nextends: base.scene.yaml\n")
    (found,) = load(tmp_path / "a.scene.yaml").findings
    assert (found.code, Path(found.file).name, found.line) == ("SF434", "base.scene.yaml", 5)
