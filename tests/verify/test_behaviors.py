"""The measurements themselves, on motion that is known exactly; and the verdicts."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from simfoundry.targets.find import find_target, target_names
from simfoundry.verify import rigs
from simfoundry.verify.behaviors import BEHAVIORS, Behavior, Trial
from simfoundry.verify.engines import all_engines, find_engine, find_installed, interpreters
from simfoundry.verify.readback import Moment, pose_numbers
from simfoundry.verify.run import ProofStatus, judge_result, measure_behaviors
from tests.scenes import pose

BY_NAME = {b.name: b for b in BEHAVIORS}


def answer(behavior: Behavior, moments: Sequence[Moment]) -> float:
    """The value that a measurement of one trial takes from moments."""
    measurement = behavior.measure()
    assert isinstance(next(measurement), Trial)
    with pytest.raises(StopIteration) as done:
        measurement.send(moments)
    return float(done.value.value)


def swings(rate: float, period: float) -> list[Moment]:
    t = np.arange(0, 8.5, 0.004)
    q = 0.1 * np.exp(-rate * t) * np.cos(2 * math.pi * t / period)
    return [Moment(float(a), {}, {"pendulum.joint": float(b)}) for a, b in zip(t, q, strict=True)]


def test_period_and_decay_are_measured_exactly() -> None:
    assert answer(BY_NAME["period"], swings(0.0, 1.2345)) == pytest.approx(1.2345, rel=1e-5)
    assert answer(BY_NAME["decay"], swings(0.2, 1.25)) == pytest.approx(0.2, rel=2e-3)


def test_what_does_not_swing_is_said() -> None:
    measurement = BY_NAME["period"].measure()
    next(measurement)
    with pytest.raises(ValueError, match=r"pendulum\.joint does not swing: it passes zero 0 times"):
        measurement.send([Moment(k / 10, {}, {"pendulum.joint": 0.1}) for k in range(80)])


def test_rebound_is_measured_from_heights() -> None:
    impact, speed = math.sqrt(2 * 0.5 / 9.81), math.sqrt(2 * 9.81 * 0.5)
    moments = []
    for t in np.arange(0, 0.76, 0.002):
        after = t - impact
        z = 0.5 - 9.81 * t * t / 2 if after < 0 else 0.7 * speed * after - 9.81 * after * after / 2
        moments.append(Moment(float(t), {"ball": pose_numbers(pose(0, 0, 0.03 + max(0.0, z)))}, {}))
    assert answer(BY_NAME["restitution"], moments) == pytest.approx(0.7, abs=2e-3)


@pytest.mark.parametrize("angle", [16.3, 26.1, 38.66, 60.0])
def test_the_slip_angle_is_found_on_ideal_ramps(angle: float) -> None:
    measurement = BY_NAME["slip_angle"].measure()
    trial = next(measurement)
    while True:
        ramps = [o for o in trial.scene.objects if o.name.startswith("ramp")]
        steep = [math.degrees(o.X_WO.angle_to(pose(0, 0, 0))) for o in ramps]
        still = {f"box{k}": pose_numbers(pose(0, 0, 0)) for k in range(len(steep))}
        slid = {f"box{k}": pose_numbers(pose(0.1 * (s > angle), 0, 0)) for k, s in enumerate(steep)}
        try:
            trial = measurement.send([Moment(0.0, still, {}), Moment(0.3, still, {}), Moment(1.3, slid, {})])
        except StopIteration as done:
            assert float(done.value) == pytest.approx(min(angle, 43.0), abs=0.1)
            return


def test_ramps_rise_as_steeply_as_they_say_and_the_box_lies_on_them() -> None:
    scene = rigs.ramps([20.0, 35.0], 0.3, 0.8)
    for k, degrees in enumerate((20.0, 35.0)):
        X_WR, X_WB = scene.object(f"ramp{k}").X_WO, scene.object(f"box{k}").X_WO
        assert math.degrees(math.acos(X_WR.rotation[2, 2])) == pytest.approx(degrees)
        p_RB = (X_WR.inverse() @ X_WB).p
        assert p_RB[2] - 0.03 - 0.02 == pytest.approx(2e-4)
        assert X_WB.p[2] > X_WR.p[2]  # it starts high, to slide far


def test_verdicts_know_what_an_engine_cannot_do() -> None:
    slip = BY_NAME["slip_angle"]
    assert judge_result(slip, find_engine("mujoco"), 26.9).verdict is ProofStatus.OK
    assert judge_result(slip, find_engine("mujoco"), 28.8).verdict is ProofStatus.MISMATCH
    known = judge_result(slip, find_engine("sapien"), 28.8)
    assert (known.verdict, known.reason) == (ProofStatus.KNOWN, "SAPIEN averages the two friction coefficients")
    assert judge_result(slip, find_engine("sapien"), 31.0).verdict is ProofStatus.MISMATCH
    assert judge_result(slip, find_engine("sapien"), 26.1).verdict is ProofStatus.OK
    assert judge_result(slip, find_engine("sapien"), float("nan")).verdict is ProofStatus.MISMATCH
    assert judge_result(slip, find_engine("sapien"), "it died").verdict is ProofStatus.FAILED


def test_what_is_known_is_of_engines_and_behaviors_that_exist_and_is_not_the_answer() -> None:
    steps = {engine.target.name for engine in all_engines() if engine.spec.steps}
    profiles = {name: find_target(name).profile for name in target_names()}
    bands = [(engine, name, band) for engine, each in profiles.items() for name, band in each.behaviors.items()]
    assert len(bands) > 10
    for family, behavior, known in bands:
        assert family in steps
        answer_is = BY_NAME[behavior]
        assert known.low < known.high
        # A band that lay within the tolerance would never be needed.
        assert (
            known.low < answer_is.expected - answer_is.tolerance
            or known.high > answer_is.expected + answer_is.tolerance
        )


@pytest.mark.slow  # 2 s: two engines
def test_mujoco_and_pybullet_behave() -> None:
    engines = {name: find_engine(name) for name in ("mujoco", "pybullet")}
    found = [f for f in find_installed(engines, interpreters([], (), {})).values() if f]
    done: list[str] = []
    results = measure_behaviors(BEHAVIORS, found, lambda engine, units: done.append(engine), workers=2)
    wrong = [m for m in results if m.verdict not in (ProofStatus.OK, ProofStatus.KNOWN)]
    assert wrong == []
    assert len(results) == len(BEHAVIORS) * len(found) == len(done)
    assert {m.behavior for m in results if m.engine == "mujoco" and m.verdict is ProofStatus.OK} == set(BY_NAME)
