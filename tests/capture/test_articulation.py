"""Joints from two captures: type, axis, hinge and range against the truth, the asset, and what is refused."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import simfoundry as sf
from simfoundry.capture.articulation.ground import find_ground
from simfoundry.capture.articulation.run import Articulated, articulate
from simfoundry.capture.frames.load import load_frame, open_capture
from simfoundry.capture.segment.find_support import find_support
from simfoundry.capture.synthesize import synthesize
from simfoundry.errors import SimfoundryError
from simfoundry.scene.model import Camera, JointType
from tests.capture.furniture import Captured, captured
from tests.cli.command import run

# Half of the usual width, which a test renders and judges in a fifth of the time.
WIDTH = 320


def errors(found: Articulated, truth: Captured) -> tuple[float, float]:
    """Return the angle between the axes [deg] and the distance between the hinges [m], in the frame of the camera."""
    motion, X_WC, X_VC = found.estimate.motion, truth.X_WC[0], found.X_WC
    axis = X_WC.rotation.T @ truth.axis
    pivot = X_WC.inverse().apply(truth.pivot[None])[0]
    estimated = X_VC.rotation.T @ motion.axis
    off = X_VC.inverse().apply(motion.pivot[None])[0] - pivot
    angle = math.degrees(math.acos(min(1.0, float(estimated @ axis))))
    return angle, 0.0 if motion.kind is JointType.PRISMATIC else float(np.linalg.norm(np.cross(off, axis)))


@pytest.mark.slow  # 4 s
def test_a_drawer_becomes_an_asset(tmp_path: Path) -> None:
    truth = captured(tmp_path, "drawer", 5000, WIDTH)
    result = run("articulate", truth.shut, truth.opened, "-o", tmp_path / "chest.asset.yaml", "--json")
    assert result.code == 0, result.err
    said = json.loads(result.out)
    assert said["type"] == "prismatic" and said["range"][1] == pytest.approx(truth.furniture.opened, abs=0.005)
    np.testing.assert_allclose(said["axis"], [1, 0, 0], atol=0.05)
    scene = tmp_path / "chest.scene.yaml"
    scene.write_text(
        "simfoundry: scene/1\nname: chest\nobjects:\n"
        "  chest: {asset: chest.asset.yaml, fixed: true, joints: {joint: 0.05}, pose: {}}\n"
    )
    document = sf.load(scene)
    assert document.check() == []
    world = document.open()
    before = world.state().joints["chest.joint"]
    for _ in range(100):
        world.step()
    assert before == pytest.approx(0.05) and abs(world.state().joints["chest.joint"] - 0.05) < 0.01  # it does not jam
    (tmp_path / "chest.asset.yaml").write_text("mine\n")
    refused = run("articulate", truth.shut, truth.opened, "-o", tmp_path / "chest.asset.yaml")
    assert refused.code == 2 and (tmp_path / "chest.asset.yaml").read_text() == "mine\n"


@pytest.mark.slow  # 4 s: it looks for a joint twice
def test_a_door_is_found_from_a_camera_that_moved(tmp_path: Path) -> None:
    truth = captured(tmp_path, "door", 5001, WIDTH, moves=True)
    found = articulate(truth.shut, [truth.opened], tmp_path / "door.asset.yaml")
    angle, off = errors(found, truth)
    assert found.estimate.motion.kind is JointType.REVOLUTE and found.estimate.is_snapped
    assert angle < 2 and off < 0.02
    assert found.estimate.motion.q == pytest.approx(truth.furniture.opened, abs=0.05)
    again = articulate(truth.shut, [truth.opened], tmp_path / "again" / "door.asset.yaml")
    assert again.path.read_bytes() == found.path.read_bytes()


@pytest.mark.slow  # 5 s: in one, little of the front is in the image, in the other one nothing
@pytest.mark.parametrize("seed", [0, 71076])
def test_a_drawer_that_leaves_the_image_is_doubtful(seed: int, tmp_path: Path) -> None:
    truth = captured(tmp_path, "drawer", seed, WIDTH)
    result = run("articulate", truth.shut, truth.opened, "-o", tmp_path / "chest.asset.yaml", "--json")
    assert result.code == 1 and result.json["type"] == "prismatic"
    assert result.json["doubt"].startswith("the part reaches the border of the second image")
    assert 0 < result.json["range"][1] < truth.furniture.opened + 0.01, "it may have moved farther, but not less"
    assert (tmp_path / "chest.png").is_file()


@pytest.mark.slow  # 3 s
def test_a_drawer_is_no_flap_if_little_of_its_front_is_in_the_image(tmp_path: Path) -> None:
    truth = captured(tmp_path, "drawer", 100, WIDTH)
    found = articulate(truth.shut, [truth.opened], tmp_path / "chest.asset.yaml")
    assert found.estimate.is_cut and found.estimate.motion.kind is JointType.PRISMATIC
    assert errors(found, truth)[0] < 2 and found.estimate.motion.q == pytest.approx(truth.furniture.opened, abs=0.01)


@pytest.mark.slow  # 6 s: in half of the width, the slide explains less
def test_a_door_that_is_seen_edge_on_and_leaves_the_image_is_no_slide(tmp_path: Path) -> None:
    truth = captured(tmp_path, "door", 60009)
    found = articulate(truth.shut, [truth.opened], tmp_path / "door.asset.yaml")
    assert found.estimate.is_cut and found.estimate.explained < 0.7 and found.estimate.reached > 0.95
    assert found.estimate.motion.kind is JointType.REVOLUTE and found.doubt == ""
    angle, off = errors(found, truth)
    assert angle < 2 and off < 0.02


@pytest.mark.slow  # 6 s
@pytest.mark.parametrize(("kind", "seed"), [("drawer", 5000), ("lid", 5003)])
def test_captures_in_the_wrong_order_are_doubtful(kind: str, seed: int, tmp_path: Path) -> None:
    truth = captured(tmp_path, kind, seed, WIDTH)
    right = run("articulate", truth.shut, truth.opened, "-o", tmp_path / "a.asset.yaml")
    wrong = run("articulate", truth.opened, truth.shut, "-o", tmp_path / "b.asset.yaml")
    assert right.code == 0 and wrong.code == 1
    assert "the part stands out most in the first capture" in wrong.out


@pytest.mark.slow  # 2 s
def test_the_part_of_a_slide_faces_along_it(tmp_path: Path) -> None:
    truth = captured(
        tmp_path, "drawer", 84004, 640, moves=True
    )  # the cabinet's side also stays on surface when it slides
    found = run("articulate", truth.shut, truth.opened, "-o", tmp_path / "a.asset.yaml")
    assert found.code == 0, found.out


@pytest.mark.slow  # 1 s
def test_a_second_drawer_that_moved_is_a_doubt(tmp_path: Path) -> None:
    truth = captured(tmp_path, "drawer", 5000, WIDTH)
    asset, scene = tmp_path / "furniture.asset.yaml", tmp_path / "drawer_1.scene.yaml"
    other = next(name for name in truth.furniture.body if name.startswith("front_"))
    size, at = truth.furniture.body[other]
    moved = replace(truth.furniture, body={**truth.furniture.body, other: (size, at + [0.06, 0, 0])})
    asset.write_text(moved.text())
    f, c = 600 * WIDTH / 640, ((WIDTH - 1) / 2, (WIDTH * 3 // 4 - 1) / 2)
    camera = Camera("front", WIDTH, WIDTH * 3 // 4, f, f, *c, truth.X_WC[0])
    both = synthesize(sf.load(scene).lower(), camera, tmp_path / "both", 7).parent
    found = run("articulate", truth.shut, both, "-o", tmp_path / "a.asset.yaml")
    assert found.code == 1 and "of what changed is not due to this part" in found.out


@pytest.mark.slow  # 2 s
def test_a_change_that_no_joint_explains_is_refused(tmp_path: Path) -> None:
    truth = captured(tmp_path, "drawer", 5000, WIDTH)
    scene = truth.shut.parent / "drawer_0.scene.yaml"
    box = "  mug: {fixed: true, shape: {box: [0.08, 0.08, 0.12]}, mass: 1, pose: {xyz: [%s, 0.06]}}\n"
    f, c = 600 * WIDTH / 640, ((WIDTH - 1) / 2, (WIDTH * 3 // 4 - 1) / 2)
    camera = Camera("front", WIDTH, WIDTH * 3 // 4, f, f, *c, truth.X_WC[0])
    away = truth.X_WC[0].rotation[:2, 2] * -1 / np.linalg.norm(truth.X_WC[0].rotation[:2, 2])
    folders = []
    for k, aside in enumerate((0.3, 0.4)):
        x, y = 0.18 * away + aside * np.array([-away[1], away[0]])
        path = scene.with_name(f"moved_{k}.scene.yaml")
        path.write_text(scene.read_text() + box % f"{x:.3f}, {y:.3f}")
        folders.append(synthesize(sf.load(path).lower(), camera, tmp_path / f"moved_{k}", k).parent)
    refused = run("articulate", *folders, "-o", tmp_path / "a.asset.yaml")
    assert refused.code == 2 and not (tmp_path / "a.asset.yaml").exists()
    refused.one_line("no joint explains what changed between the captures", "leave everything else where it is")


@pytest.mark.slow  # 1 s
def test_the_front_of_a_cabinet_is_not_the_ground(tmp_path: Path) -> None:
    truth = captured(tmp_path, "flap", 5002, WIDTH)
    frame = load_frame(open_capture(truth.shut))
    up = truth.X_WC[0].rotation.T @ [0, 0, 1]
    assert find_support(frame).X_WC.rotation.T[:, 2] @ up < 0.95, "the front fills the image"
    assert find_ground(frame).X_WC.rotation.T[:, 2] @ up > 0.999


def test_what_does_not_belong_together_is_refused(tmp_path: Path) -> None:
    truth = captured(tmp_path, "lid", 3, WIDTH, moves=True)
    out = tmp_path / "a.asset.yaml"
    with pytest.raises(SimfoundryError, match="no part of the object moved"):
        articulate(truth.shut, [truth.shut], out)
    stated = truth.opened / "capture.yaml"
    stated.write_text("".join(line for line in stated.open() if not line.startswith("    pose:")))
    with pytest.raises(SimfoundryError, match="one capture states the `pose`"):
        articulate(truth.shut, [truth.opened], out)
    first = truth.shut / "capture.yaml"
    first.write_text("".join(line for line in first.open() if not line.startswith("    pose:")))
    with pytest.raises(SimfoundryError, match="leave the camera where it is"):
        articulate(truth.shut, [truth.opened], out)
    alone = run("articulate", truth.shut, "-o", out)
    assert alone.code == 2 and "add a capture of the same object opened" in alone.err
    missing = run("articulate", tmp_path / "nowhere", truth.opened, "-o", out)
    assert missing.code == 2 and "does not exist" in missing.err
    assert not out.exists()


def _pixels(truth: Captured, points: list[np.ndarray]) -> list[str]:
    """Return points of the world as pixels of the first capture, a little inside of the part's surface."""
    f, c = 600 * WIDTH / 640, ((WIDTH - 1) / 2, (WIDTH * 3 // 4 - 1) / 2)
    local = [truth.X_WC[0].inverse().apply(point[None])[0] for point in points]
    return [f"{round(f * x / z + c[0])},{round(f * y / z + c[1])}" for x, y, z in local]


@pytest.mark.slow  # 6 s: it looks for joints three times
def test_a_stated_hinge_and_several_states(tmp_path: Path) -> None:
    truth = captured(tmp_path, "lid", 5003, WIDTH)
    width = truth.furniture.part["lid"][0][1]
    ends = [truth.pivot + share * width * truth.axis for share in (-0.45, 0.45)]
    out = tmp_path / "box.asset.yaml"
    stated = run("articulate", truth.shut, truth.opened, "-o", out, "--hinge", *_pixels(truth, ends), "--json")
    assert stated.code in (0, 1), stated.err
    said = json.loads(stated.out)
    assert said["type"] == "revolute" and not said["snapped"]
    # The pixels are on top of the lid, and the hinge is below.
    assert math.radians(said["range"][1]) == pytest.approx(truth.furniture.opened, abs=0.25)
    wrong = run("articulate", truth.shut, truth.opened, "-o", out, "--force", "--hinge", *_pixels(truth, [ends[0]] * 2))
    assert wrong.code == 2 and "same place" in wrong.err
    # The farthest of several states is the end of the range, whatever their order.
    half = captured(tmp_path / "half", "lid", 5003, WIDTH, opened=0.6 * truth.furniture.opened)
    for order in ([half.opened, truth.opened], [truth.opened, half.opened]):
        many = run("articulate", truth.shut, *order, "-o", tmp_path / "many.asset.yaml", "--force", "--json")
        reached = math.radians(json.loads(many.out)["range"][1])
        assert reached == pytest.approx(truth.furniture.opened, abs=0.06)


def test_a_box_without_motion_and_pixels_outside(tmp_path: Path) -> None:
    truth = captured(tmp_path, "drawer", 5000, WIDTH)
    out = tmp_path / "x.asset.yaml"
    for option, reason in (
        (["--box", "0,0,20,20"], "nothing moved inside the stated box"),
        (["--box", "9,9,5,5"], "must be left,top,right,bottom"),
        (["--box", "1,2,3"], "takes left,top,right,bottom"),
        (["--hinge", "5,5", "9999,5"], "is not in the image"),
        (["--hinge", "a,b", "1,2"], "not a list of whole numbers"),
    ):
        refused = run("articulate", truth.shut, truth.opened, "-o", out, *option)
        assert refused.code == 2 and reason in refused.err, refused.err
        assert not out.exists()
