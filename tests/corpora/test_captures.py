"""The proof on real tables can fail, and one capture passes it."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

from simfoundry.geometry.frames import Pose, quat_from_rpy
from simfoundry.scene.lower import pose as lowered_pose
from simfoundry.scene.model import Scene
from simfoundry.spec.load import load_capture
from simfoundry.spec.models.capture import CaptureSpec
from simfoundry.targets.build import TARGETS, build
from tests.corpora.captures import main, totals
from tests.corpora.realtables import consumers, worlds
from tests.corpora.realtables.commands import different_files, environment, run
from tests.corpora.realtables.documents import SETS, RealCapture, real_captures, write_document
from tests.corpora.realtables.proof import COLUMNS, lines_of_objects, prove
from tests.corpora.realtables.table import Cell, Measures, Row, text_table
from tests.scenes import box, pose, scene_of, solid, textured_object

FAST = "posecnn_demo_000003"


def small_scene(height: float = 0.025) -> Scene:
    table = solid("table", box(1, 1, 0.04), pose(0, 0, -0.02, yaw=0.2), fixed=True)
    return scene_of(table, solid("block", box(0.08, 0.06, 0.05), pose(0.1, 0.2, height, yaw=0.7)), textured_object())


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scene, Path]:
    pytest.importorskip("pybullet", reason="PyBullet is not installed")
    scene = small_scene()
    folder = tmp_path_factory.mktemp("built")
    build(scene, TARGETS, folder)
    return scene, folder


@pytest.mark.slow
def test_one_capture_meets_every_bar(shared_data: Path, tmp_path: Path) -> None:
    pytest.importorskip("pybullet", reason="PyBullet is not installed")
    capture = next(c for c in real_captures(shared_data) if c.name == FAST)
    row = prove(capture, tmp_path)
    assert row.failures == []
    assert set(row.cells) == set(COLUMNS) - {"IoU"}
    assert row.measures.objects_found == 3
    assert (tmp_path / "run2" / "build" / "usd" / "scene.usda").is_file()


def test_all_captures_are_found(shared_data: Path) -> None:
    captures = real_captures(shared_data)
    assert len({c.name for c in captures}) == len(captures) == sum(SETS.values()) == 24
    assert all((c.folder / c.entry[key]).is_file() for c in captures for key in ("rgb", "depth"))


def test_a_depth_camera_of_its_own_keeps_its_pose_and_units(tmp_path: Path) -> None:
    X_color_depth = Pose.of([0.015, -0.02, 0.003], quat_from_rpy(0.2, -0.4, 0.7))
    K, K_depth = [[700, 0, 478.5], [0, 698.6, 274.4], [0, 0, 1]], [[425.8, 0, 427.2], [0, 425.7, 237.7], [0, 0, 1]]
    entry = {"rgb": "c.png", "depth": "d.png", "K": K, "depth_K": K_depth, "depth_scale_to_m": 0.001}
    entry |= {"depth_invalid": [0, 65535], "T_color_depth": X_color_depth.matrix.tolist()}
    for picture in ("c.png", "d.png"):
        (tmp_path / picture).write_bytes(b"picture")
    folder = write_document(RealCapture("one", "set", tmp_path, entry), tmp_path / "capture")
    spec = load_capture(folder / "capture.yaml").spec
    assert isinstance(spec, CaptureSpec)
    shot = spec.frames["view"]
    assert shot.depth is not None
    assert (shot.depth.scale, shot.depth.invalid, shot.camera.fy) == (0.001, (0, 65535), 698.6)
    assert shot.depth.camera is not None and shot.depth.pose is not None
    assert (shot.depth.camera.fx, shot.depth.camera.cy) == (425.8, 237.7)
    np.testing.assert_allclose(lowered_pose(shot.depth.pose).matrix, X_color_depth.matrix, atol=1e-12)
    assert (folder / "d.png").read_bytes() == b"picture"


def test_memory_is_that_of_the_command_and_not_of_the_proof(tmp_path: Path) -> None:
    ours = np.ones(40_000_000)  # 320 MB that a child would inherit the peak of
    env = environment(tmp_path, 1)
    small = run((sys.executable, "-c", "print('here')"), tmp_path, env)
    large = run((sys.executable, "-c", "x = b'1' * 200_000_000"), tmp_path, env)
    assert ours.sum() == 40_000_000
    assert (small.code, small.output, small.errors) == (0, "here\n", "")
    assert small.megabytes < 60
    assert 200_000_000 / 2**20 < large.megabytes < 270


def test_a_command_that_fails_or_hangs_says_so(tmp_path: Path) -> None:
    env = environment(tmp_path, 1)
    failed = run((sys.executable, "-c", "import sys; print('no disk', file=sys.stderr); sys.exit(3)"), tmp_path, env)
    assert failed.last_words() == "exit code 3: no disk"
    hung = run((sys.executable, "-c", "import time; time.sleep(60)"), tmp_path, env, timeout=0.5)
    assert (hung.code, hung.errors) == (-9, "stopped after 0 s")


def test_differences_between_folders_are_found(tmp_path: Path) -> None:
    for folder, text in (("a", "same"), ("b", "same"), ("c", "else")):
        (tmp_path / folder / "deep").mkdir(parents=True)
        (tmp_path / folder / "deep" / "file").write_text(text)
    (tmp_path / "b" / "more").touch()
    assert different_files(tmp_path / "a", tmp_path / "b") == ["more"]
    assert different_files(tmp_path / "c", tmp_path / "a") == ["deep/file"]
    assert different_files(tmp_path / "a", tmp_path / "a") == []


def test_lines_of_objects_are_counted() -> None:
    text = "name: x\nobjects:\n  a:\n    mass: 1\n    pose: {xyz: [0,\n      0, 0]}\n  b: {mass: 2}\ncameras: {}\n"
    assert lines_of_objects(text) == {"a": 4, "b": 1}


def test_consumers_have_nothing_to_say_about_a_good_build(built: tuple[Scene, Path], tmp_path: Path) -> None:
    assert consumers.complaints(built[1], environment(tmp_path / "cache", 1), elsewhere(tmp_path)) == []
    assert consumers.validation_errors(built[1] / "usd" / "scene.usda") == []


def test_consumers_complain_about_a_lost_mesh(built: tuple[Scene, Path], tmp_path: Path) -> None:
    scene, _ = built
    build(scene, TARGETS, tmp_path / "build")
    for target in ("mjcf", "urdf", "pybullet", "usd"):
        for asset in (tmp_path / "build" / target / "assets").iterdir():
            asset.unlink()
    found = consumers.complaints(tmp_path / "build", environment(tmp_path / "cache", 1), elsewhere(tmp_path))
    assert {line.split(":")[0].removesuffix("/load.py") for line in found} >= {"mjcf", "urdf", "pybullet"}
    assert worlds.stale_files(scene, tmp_path / "build")


def elsewhere(tmp_path: Path) -> Path:
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    return folder


def test_worlds_read_back_as_the_scene(built: tuple[Scene, Path]) -> None:
    scene, folder = built
    assert worlds.stale_files(scene, folder) == []
    assert all(error <= 1e-6 for error, _ in worlds.read_back_errors(scene, folder).values())


@pytest.mark.parametrize("quantity", ["mass", "com", "inertia", "position", "rotation"])
def test_a_stage_that_differs_from_the_scene_is_seen(built: tuple[Scene, Path], quantity: str) -> None:
    scene, folder = built
    item = scene.object("block")
    link = item.root
    changed = {
        "mass": dataclasses.replace(link, mass=link.mass * (1 + 1e-4)),
        "com": dataclasses.replace(link, com=link.com + np.array([0, 1e-5, 0])),
        "inertia": dataclasses.replace(link, inertia=link.inertia * (1 + 1e-4)),
    }
    moved = {
        "position": Pose.of(item.X_WO.p + np.array([0, 0, 1e-5]), item.X_WO.q),
        "rotation": item.X_WO @ Pose.of(q=quat_from_rpy(0, 1e-4, 0)),
    }
    other = dataclasses.replace(item, links=(changed.get(quantity, link),), X_WO=moved.get(quantity, item.X_WO))
    objects = tuple(other if o.name == "block" else o for o in scene.objects)
    error, where = worlds.read_back_errors(dataclasses.replace(scene, objects=objects), folder)["USD"]
    assert error > 1e-6
    assert where == f"{quantity} of block"


@pytest.mark.parametrize("engine", worlds.ENGINES)
def test_a_falling_object_is_restless(engine: str) -> None:
    pytest.importorskip("pybullet", reason="PyBullet is not installed")
    resting = small_scene()
    resting = dataclasses.replace(resting, objects=resting.objects[:2])
    assert worlds.rest(resting, engine, 0.01, 5.0).restless == ()
    raised = dataclasses.replace(small_scene(height=0.1), objects=small_scene(height=0.1).objects[:2])
    assert worlds.rest(raised, engine, 0.01, 5.0).restless[0].startswith("block moved 7.")


def test_pictures_that_are_not_there_are_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["captures", "--data", str(tmp_path)])
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == 2
    assert f"there is no posecnn_demo, mosd_dev, graspnet6dof, m3t_desk in {tmp_path}" in capsys.readouterr().err


def rows(counts: list[tuple[int, int]], seconds: float = 10.0, iou: float = 0.9) -> list[Row]:
    cells = {column: Cell("", True) for column in COLUMNS if column not in ("objects", "IoU", "cpu", "settled")}
    return [
        Row(f"mosd_dev_{k}", cells, Measures(seconds, 500.0, true, found, (iou,)))
        for k, (true, found) in enumerate(counts)
    ]


def failing(table: list[Row]) -> list[str]:
    return [bar.bar for bar in totals(table) if not bar.passed]


def test_totals_hold_the_bars() -> None:
    good = [(3, 3)] * 7 + [(3, 4)] * 4 + [(3, 6)]
    assert failing(rows(good)) == []
    assert failing(rows([*good[1:], (3, 2)])) == ["mosd_dev: number of objects exact"]
    assert failing(rows([*good[:-2], (3, 6), (3, 6)])) == ["mosd_dev: number of objects within 1"]
    assert failing(rows(good, iou=0.79)) == ["mosd_dev: mean IoU at least 0.80"]
    assert failing(rows(good, seconds=31.0)) == ["median time at most 30 s"]
    slow = dataclasses.replace(rows(good)[0], measures=Measures(91.0, 2100.0, 3, 3, (0.9,)))
    assert failing([slow, *rows(good)[1:]]) == ["no time above 90 s", "no memory above 2000 MB"]


def test_a_capture_that_failed_fails_what_it_could_not_show() -> None:
    broken = Row("mosd_dev_x", {"exit": Cell("2", False, "exit code 2: no support")}, Measures(2.0, 300.0))
    table = [*rows([(3, 3)] * 11), broken]
    assert {"check", "twice", "MuJoCo 2 s"} <= set(failing(table))
    assert broken.failures == ["mosd_dev_x, exit: exit code 2: no support"]
    assert Row("x", {"settled": Cell("1 of 2", None, "cup tilted"), "MB": Cell("3", True)}).notes == [
        "x, settled: cup tilted"
    ]
    assert text_table(table, COLUMNS).splitlines()[-1].split()[:4] == ["mosd_dev_x", "2", "FAIL", "-"]
