"""Scenes within scenes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from simfoundry.scene.lower import lower
from simfoundry.scene.model import Scene
from simfoundry.spec.load import load
from tests.spec.compose.documents import loaded, messages, spec_of, written

STATION = """\
simfoundry: scene/1
name: station
viewpoint: cam
allow: {SF404: {cup: "round"}}
parameters: {size: 0.03}
materials: {wood: {density: 700}}
frames: {corner: {xyz: [0.2, 0.2, 0]}, top: {on: desk}}
objects:
  desk: {fixed: true, shape: {box: [1, 1, 0.04]}, material: wood, pose: {xyz: [0.5, 0, -0.02]}}
  plate: {shape: {cylinder: {radius: 0.1, height: 0.02}}, mass: 0.2, place: {on: desk, xy: [0.5, 0.1], yaw_deg: 10}}
  cup: {shape: {sphere: $size}, mass: 0.2, place: {on: desk, left_of: plate}}
  pin: {fixed: true, shape: {sphere: 0.01}, mass: 0.1, pose: {frame: corner, xyz: [0, 0, 1]}}
  tag: {fixed: true, shape: {sphere: 0.01}, mass: 0.1, pose: {frame: top}}
cameras: {cam: {size: [640, 480], fx: 500, fy: 500, pose: {xyz: [0, 0, 1], look_at: [0.5, 0, 0]}}}
lights: {lamp: {type: point, xyz: [0, 0, 2]}}
relations: [OnTop(cup, desk), OnTop(plate, desk)]
no_contact: [[pin, tag]]
"""
TWO = """\
include:
  left: {scene: cells/station.scene.yaml, pose: {xyz: [0, 1, 0]}}
  right: {scene: cells/station.scene.yaml, pose: {xyz: [1, -1, 0.5], yaw_deg: 90}, parameters: {size: 0.04}}
"""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    written(tmp_path, STATION, "cells/station.scene.yaml")
    return tmp_path


def lowered(project: Path, body: str) -> Scene:
    return lower(loaded(project, body))


OBJECTS = "objects: {left_cup: {mass: 0.7}, right_plate: null, right_cup: {place: {left_of: right_tag}}}\n"


def test_names_references_and_lists_are_taken_over(project: Path) -> None:
    spec = spec_of(project, TWO.replace("size: 0.04", "size: 0.03") + OBJECTS)
    left = [f"left_{name}" for name in ("desk", "plate", "cup", "pin", "tag")]
    assert [*spec.objects] == [*left, *(f"right_{name}" for name in ("desk", "cup", "pin", "tag"))]
    cup = spec.objects["left_cup"]
    assert (
        cup.mass == 0.7 and cup.place is not None and (cup.place.on, cup.place.left_of) == ("left_desk", "left_plate")
    )
    assert (cup.place.frame, cup.place.seen_from) == ("left", "left_cam")
    assert spec.objects["left_desk"].material == "left_wood" and spec.frames["left_top"].on == "left_desk"
    assert spec.allow["SF404"] == {f"{side}_{n}": "round" for side in ("left", "right") for n in ("cup",)}


def test_an_included_scene_is_the_scene_moved(project: Path) -> None:
    own = lower(load(project / "cells" / "station.scene.yaml"))
    both = lowered(project, TWO)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for item in own.objects:
        left, right = both.by_name[f"left_{item.name}"], both.by_name[f"right_{item.name}"]
        assert left.X_WO.p == pytest.approx(item.X_WO.p + [0, 1, 0], abs=1e-6)
        assert left.X_WO.rotation == pytest.approx(item.X_WO.rotation, abs=1e-9)
        if item.name != "cup":  # which is larger on the right
            assert right.X_WO.p == pytest.approx(turn @ item.X_WO.p + [1, -1, 0.5], abs=1e-6)
            assert right.X_WO.rotation == pytest.approx(turn @ item.X_WO.rotation, abs=1e-9)
    cameras, lights = ({c.name: c.X_WC for c in both.cameras}, {c.name: c.X_WL for c in both.lights})
    assert cameras["right_cam"].p == pytest.approx([1, -1, 1.5])
    assert cameras["right_cam"].rotation == pytest.approx(turn @ own.cameras[0].X_WC.rotation, abs=1e-9)
    assert lights["right_lamp"].p == pytest.approx([1, -1, 2.5])
    assert [str(r) for r in both.relations][:2] == ["OnTop(left_cup, left_desk)", "OnTop(left_plate, left_desk)"]
    assert both.no_contact == (("left_pin", "left_tag"), ("right_pin", "right_tag"))


def test_scenes_are_included_in_included_scenes(project: Path) -> None:
    written(project, TWO, "cell.scene.yaml")
    spec = spec_of(project, "include: {a: {scene: cell.scene.yaml, pose: {xyz: [9, 0, 0]}}}\n")
    assert spec.objects["a_left_pin"].pose.frame == "a_left_corner"
    assert spec.frames["a_left_corner"].frame == "a_left" and spec.frames["a_left"].frame == "a"
    scene = lower(load(project / "a.scene.yaml"))
    assert scene.by_name["a_left_desk"].X_WO.p == pytest.approx([9.5, 1, -0.02])


def test_an_overlay_replaces_the_lists_of_what_its_base_includes(project: Path) -> None:
    written(project, TWO, "base.scene.yaml")
    head = "simfoundry: scene/1\nextends: base.scene.yaml\nname: b\n"
    assert spec_of(project, head + "relations: [OnTop(left_cup, left_desk)]\n").relations == (
        "OnTop(left_cup, left_desk)",
    )
    assert len(spec_of(project, head).relations) == 4


def test_files_are_found_from_the_including_scene(project: Path) -> None:
    (project / "cells" / "cube.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    station = STATION.replace("shape: {sphere: $size}", "asset: cube.obj, scale: $size")
    written(project, station, "cells/station.scene.yaml")
    found = loaded(project, TWO)
    assert found.spec is not None and found.spec.objects["left_cup"].asset == "cells/cube.obj"  # type: ignore[attr-defined]
    assert project / "cells" / "station.scene.yaml" in found.files()
    assert len(lower(found).objects) == 10


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("include: {a: {scene: gone.scene.yaml}}\n", "3:22 SF203 file `gone.scene.yaml` does not exist"),
        ("include: {a: {scene: ../x.scene.yaml}}\n", "3:22 SF204 `../x.scene.yaml` is outside the project"),
        (
            "include: {a: {scene: a.scene.yaml}}\n",
            "3:22 SF207 `a.scene.yaml` includes `a.scene.yaml`",
        ),
        ("include: {a: {scene: t.task.yaml}}\n", "3:22 SF006 `t.task.yaml` is not a `scene/1` document"),
        (
            "include: {a: {scene: cells/station.scene.yaml, parameters: {siz: 1}}}\n",
            "SF201 no parameter is called `siz`",
        ),
        (
            "include: {a: {scene: cells/station.scene.yaml, pose: {rpy_deg: [0, 9, 0]}}}\n",
            "SF107 an included scene",
        ),
        (TWO + "objects: {left_mug: null}\n", "SF103 `left_mug` has no value"),
        (TWO + "objects: {left_cup: {mas: 1}}\n", "6:22 SF101 unknown key `mas`"),
    ],
)
def test_what_cannot_be_included_is_said(project: Path, body: str, said: str) -> None:
    written(project, "simfoundry: task/1\nname: t\nscene: a.scene.yaml\n", "t.task.yaml")
    assert any(said in message for message in messages(project, body)), messages(project, body)


def test_findings_of_an_included_scene_name_its_file(project: Path) -> None:
    written(project, STATION.replace("on: desk, left_of", "on: dek, left_of"), "cells/station.scene.yaml")
    findings = loaded(project, TWO).errors
    assert [(Path(d.file).name, d.line, d.code) for d in findings] == [("station.scene.yaml", 11, "SF201")]
