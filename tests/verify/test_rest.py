"""Where engines leave a scene: an engine that disagrees is named, and by how much."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path

import pytest

from simfoundry.geometry.frames import Pose
from simfoundry.geometry.shapes import Sphere
from simfoundry.scene.model import Scene
from simfoundry.scene.state import SceneState
from simfoundry.verify.readback import Moment, pose_numbers
from simfoundry.verify.run import ProofStatus, SceneBuilds, built, judge_rest, settle_subjects
from tests.scenes import box, full_scene, pose, scene_of, solid


def moment_of(scene: Scene, move: Callable[[str, Pose], Pose] = lambda name, X: X, **joints: float) -> Moment:
    """A scene as it stands, its objects moved and its joints set."""
    state = SceneState.initial(scene)
    poses = {name: pose_numbers(move(name, X)) for name, X in state.poses.items()}
    return Moment(2.0, poses, {**state.joints, **{k.replace("__", "."): v for k, v in joints.items()}})


@pytest.fixture
def scene() -> Scene:
    return full_scene()


def verdicts(scene: Scene, odd: Moment) -> dict[str, tuple[str, str, float, float]]:
    subject = SceneBuilds("full", scene, {}, {})
    ends = {"a": moment_of(scene), "b": moment_of(scene), "odd": odd}
    return {r.engine: (r.verdict.value, r.worst, r.mm, r.deg) for r in judge_rest(subject, ends)}


def test_the_odd_one_out_is_named(scene: Scene) -> None:
    def shift(name: str, X: Pose) -> Pose:
        return Pose.of(X.p + [0.0012, 0, 0], X.q) if name == "crate" else X

    found = verdicts(scene, moment_of(scene, shift))
    assert (found["a"][0], found["b"][0]) == ("ok", "ok")
    assert found["odd"][:2] == ("mismatch", "crate")
    assert found["odd"][2] == pytest.approx(1.2)


def test_a_turn_counts_except_of_a_ball(scene: Scene) -> None:
    def turn(what: str) -> Callable[[str, Pose], Pose]:
        return lambda name, X: X @ pose(0, 0, 0, yaw=0.02) if name == what else X

    assert verdicts(scene, moment_of(scene, turn("wedge")))["odd"][:2] == ("mismatch", "wedge")
    assert verdicts(scene, moment_of(scene, turn("wedge")))["odd"][3] == pytest.approx(math.degrees(0.02))
    assert verdicts(scene, moment_of(scene, turn("ball")))["odd"][0] == "ok"
    assert verdicts(scene, moment_of(scene, turn("table")))["odd"][0] == "ok"  # it is fixed: no engine moves it


def test_joints_count(scene: Scene) -> None:
    found = verdicts(scene, moment_of(scene, cabinet__slide=0.073))["odd"]
    assert found[:2] == ("mismatch", "cabinet.slide")
    assert found[2] == pytest.approx(3.0)
    found = verdicts(scene, moment_of(scene, cabinet__hinge=0.65))["odd"]
    assert found[:2] == ("mismatch", "cabinet.hinge")
    assert found[3] == pytest.approx(math.degrees(0.05))


def test_an_engine_that_failed_does_not_count(scene: Scene) -> None:
    subject = SceneBuilds("full", scene, {}, {})
    results = judge_rest(subject, {"a": moment_of(scene), "b": "crashed: SIGSEGV", "c": moment_of(scene)})
    assert [r.verdict for r in results] == [ProofStatus.OK, ProofStatus.FAILED, ProofStatus.OK]
    assert results[1].error == "crashed: SIGSEGV"
    assert all(r.verdict is ProofStatus.FAILED for r in judge_rest(subject, {"a": "no", "b": "no"}))


def test_real_engines_agree_on_a_small_scene(tmp_path: Path) -> None:
    pytest.importorskip("pybullet", reason="PyBullet is not installed")
    from simfoundry.verify.engines import find_engine, find_installed, interpreters

    table = solid("table", box(1, 1, 0.04), pose(0, 0, -0.02), fixed=True)
    ball = dataclasses.replace(solid("ball", Sphere(0.03), pose(0.3, 0, 0.03)))
    scene = scene_of(table, solid("crate", box(0.1, 0.08, 0.06), pose(0, 0, 0.031, yaw=0.4)), ball)
    both = {name: find_engine(name) for name in ("mujoco", "pybullet")}
    found = find_installed(both, interpreters([], (), {}))
    engines = [f for f in found.values() if f is not None]
    subjects = [built("rest", scene, both.values(), tmp_path / "0"),
                built("still", scene_of(table), both.values(), tmp_path / "1")]  # fmt: skip
    results = settle_subjects(subjects, engines, lambda engine, units: None)
    assert [(r.subject, r.engine, r.verdict) for r in results] == [
        ("rest", "mujoco", ProofStatus.OK),
        ("rest", "pybullet", ProofStatus.OK),
    ]  # nothing can move in the other
    assert settle_subjects(subjects, engines[:1], lambda engine, units: None) == []
