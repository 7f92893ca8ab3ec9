"""Behaviors with an analytic solution, each consisting of a small mechanism, a measurement, and a tolerance.

A measurement is a generator that yields :class:`Trial` objects, receives the sampled states of each run, and returns
the measured value. A measurement that requires a search, such as the slip angle of a box, can yield several trials in
sequence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array
from simfoundry.geometry.shapes import Cylinder, Sphere
from simfoundry.scene.model import Drive, Scene
from simfoundry.verify import rigs
from simfoundry.verify.process import Run
from simfoundry.verify.readback import Moment

Moments = Sequence[Moment]


@dataclass(frozen=True)
class Trial:
    """A scene, and the duration and sampling of its simulation."""

    scene: Scene
    run: Run


Measurement = Generator[Trial, Moments, float]


@dataclass(frozen=True)
class Behavior:
    """A behavior, with its ``expected`` value and ``tolerance`` in ``unit``, and the reason for the tolerance."""

    name: str
    title: str
    unit: str
    expected: float
    tolerance: float
    reason: str
    measure: Callable[[], Measurement]


# Friction coefficients for which any other combination rule changes the slip angle by at least 2.5 degrees.
MU_BOX, MU_RAMP = 0.3, 0.8
_SLIP = math.degrees(math.atan(math.sqrt(MU_BOX * MU_RAMP)))
# Distance [m] that a box must move in one second to count as slipping, which happens 0.1 degrees above the slip angle.
_SLID_M = 0.01

_SWING = 0.1  # [rad], small enough for the series expansion of the period below to be accurate to 1e-6
_INERTIA, _TORQUE = rigs.pendulum_constants()
# Period of the pendulum [s], expanded in the amplitude, and decay rate of its damped swings [1/s].
_PERIOD = 2 * math.pi * math.sqrt(_INERTIA / _TORQUE) * (1 + _SWING**2 / 16 + 11 * _SWING**4 / 3072)
_DAMPING = 0.02  # N m s/rad; the amplitude halves in 5.6 s, which is more than four periods
_RATE = _DAMPING / (2 * _INERTIA)
_WEIGHT = rigs.GRAVITY  # weight of one kilogram [N]


def free_fall() -> Measurement:
    """Measure how far an asymmetric body falls in 3 s, as a fraction of g t^2 / 2."""
    stone = rigs.lopsided("stone", rigs.posed(0, 0, 60, 0.5, -0.3, 2.1))
    moments = yield Trial(rigs.scene_of("fall", stone), Run(3.0, 3.0))
    first, last = moments[0], moments[-1]
    fallen = first.pose("stone").p[2] - last.pose("stone").p[2]
    return float(fallen / (rigs.GRAVITY * last.time**2 / 2))


def slip_angle() -> Measurement:
    """Measure the slope angle at which a box begins to slide, using two rounds of ramps."""
    low, high, count = 15.0, 43.0, 14
    for _ in range(2):
        angles = np.linspace(low, high, count + 1).tolist()
        moments = yield Trial(rigs.ramps(angles, MU_BOX, MU_RAMP), Run(1.3, 0.1))
        slid = _slid(moments, len(angles))
        first = int(np.argmax(slid)) if slid.any() else len(angles)
        low, high = float(angles[max(0, first - 1)]), float(angles[min(first, len(angles) - 1)])
    return (low + high) / 2


def _slid(moments: Moments, count: int) -> NDArray[np.bool_]:
    """Return a mask of the boxes that slipped during the last second. Before that, the boxes have time to settle."""
    before = next(m for m in moments if m.time >= moments[-1].time - 1.0 - 1e-6)
    names = [f"box{k}" for k in range(count)]
    moved = [float(np.linalg.norm(moments[-1].pose(n).p - before.pose(n).p)) for n in names]
    return np.array(moved) > _SLID_M


def pendulum_period() -> Measurement:
    """Measure the period [s] of a pendulum over six swings."""
    moments = yield Trial(rigs.scene_of("pendulum", rigs.pendulum(_SWING)), Run(8.5, 0.004))
    crossings = _crossings(moments, "pendulum.joint")
    return float((crossings[-1] - crossings[0]) / (len(crossings) - 1) * 2)


def damped_decay() -> Measurement:
    """Measure the decay rate [1/s] of a damped pendulum between its first and last peaks."""
    moments = yield Trial(rigs.scene_of("decay", rigs.pendulum(_SWING, _DAMPING)), Run(8.5, 0.004))
    times, heights = _peaks(moments, "pendulum.joint")
    slope, _ = np.polyfit(times, np.log(heights), 1)
    return float(-slope)


def _series(moments: Moments, joint: str) -> tuple[Array, Array]:
    return np.array([m.time for m in moments]), np.array([m.joints[joint] for m in moments])


def _crossings(moments: Moments, joint: str) -> Array:
    """Return the times at which a joint passes zero, interpolated between samples."""
    t, q = _series(moments, joint)
    k = np.flatnonzero(q[:-1] * q[1:] < 0)
    if len(k) < 3:
        raise ValueError(f"{joint} does not swing: it passes zero {len(k)} times")
    return np.asarray(t[k] + (t[k + 1] - t[k]) * q[k] / (q[k] - q[k + 1]))


def _peaks(moments: Moments, joint: str) -> tuple[Array, Array]:
    """Return the times and heights of a joint's turning points after the start, each fitted to three samples."""
    t, q = _series(moments, joint)
    a = np.abs(q)
    k = np.flatnonzero((a[1:-1] > a[:-2]) & (a[1:-1] >= a[2:])) + 1
    if len(k) < 3:
        raise ValueError(f"{joint} does not swing: it turns {len(k)} times")
    bend = a[k - 1] - 2 * a[k] + a[k + 1]
    shift = 0.5 * (a[k - 1] - a[k + 1]) / bend
    return t[k] + shift * (t[1] - t[0]), a[k] - 0.25 * (a[k - 1] - a[k + 1]) * shift


def rebound() -> Measurement:
    """Measure the ratio of a ball's speeds after and before its first bounce.

    The speeds are computed from the ball's heights.
    """
    ball = rigs.solid("ball", Sphere(0.03), rigs.posed(0, 0, 0.53), restitution=0.9)
    floor = rigs.solid("floor", rigs.box(1, 1, 0.1), rigs.posed(0, 0, -0.05), restitution=0.4, fixed=True)
    moments = yield Trial(rigs.scene_of("bounce", ball, floor), Run(0.75, 0.002))
    heights = np.array([m.pose("ball").p[2] - 0.03 for m in moments])
    # The ball falls by 0.5 m, and the impact is over 50 ms later.
    after_impact = math.sqrt(2 * 0.5 / rigs.GRAVITY) + 0.05
    lowest = int(np.argmin(heights[: next(k for k, m in enumerate(moments) if m.time > after_impact)]))
    return float(math.sqrt(max(0.0, heights[lowest:].max()) / heights[0]))


def limit_holds() -> Measurement:
    """Measure the final distance [mm] between a falling 1 kg slider and its stop at 0.3 m."""
    moments = yield Trial(rigs.scene_of("stop", rigs.slider(damping=2.0, travel=0.3)), Run(2.0, 0.5))
    return (moments[-1].joints["slider.joint"] - 0.3) * 1000


def friction_holds() -> Measurement:
    """Measure how far [mm] a slider weighing 9.81 N sinks in one second against a Coulomb friction of 12 N."""
    moments = yield Trial(rigs.scene_of("hold", rigs.slider(friction=12.0)), Run(1.0, 1.0))
    return moments[-1].joints["slider.joint"] * 1000


def friction_slips() -> Measurement:
    """Measure the acceleration [m/s^2] of a slider that weighs 9.81 N and has a Coulomb friction of 6 N."""
    moments = yield Trial(rigs.scene_of("slip", rigs.slider(friction=6.0)), Run(1.0, 1.0))
    last = moments[-1]
    return 2 * last.joints["slider.joint"] / last.time**2


def damped_friction() -> Measurement:
    """Measure the terminal speed [m/s] of a slider that weighs 9.81 N.

    The slider has a damping of 4 N s/m and a Coulomb friction of 3 N.
    """
    moments = yield Trial(rigs.scene_of("both", rigs.slider(damping=4.0, friction=3.0, travel=9.0)), Run(2.5, 0.5))
    before, last = moments[-2], moments[-1]
    return (last.joints["slider.joint"] - before.joints["slider.joint"]) / (last.time - before.time)


_SPRING = Drive(stiffness=200.0, damping=20.0, target=0.05)


def drive_holds() -> Measurement:
    """Measure the position [mm] at which a motor holds a slider that weighs 9.81 N.

    The motor has a stiffness of 200 N/m and a target of 50 mm. The weight moves the slider 49 mm past the target.
    """
    moments = yield Trial(rigs.scene_of("motor", rigs.slider(travel=0.5, drive=_SPRING)), Run(2.5, 2.5))
    return moments[-1].joints["slider.joint"] * 1000


def follower_keeps() -> Measurement:
    """Measure the ratio of a follower's travel to the travel of its falling leader, which should be 2."""
    moments = yield Trial(rigs.scene_of("gear", rigs.geared(2.0)), Run(0.5, 0.1))
    last = moments[-1].joints
    if abs(last["gear.leader"]) < 0.01:
        raise ValueError(f"gear.leader does not fall: it is at {last['gear.leader']:.3g} m")
    return last["gear.follower"] / last["gear.leader"]


def passes_through() -> Measurement:
    """Measure how much farther a box falls if it passes through a shelf, compared with a free fall of 0.3 s."""
    shelf = rigs.solid("shelf", rigs.box(1, 1, 0.05), rigs.posed(0, 0, 0.475), fixed=True)
    boxes = [
        rigs.solid(n, rigs.box(0.06, 0.06, 0.06), rigs.posed(x, 0, 0.531)) for n, x in (("held", -0.3), ("ghost", 0.3))
    ]
    scene = replace(rigs.scene_of("pass", shelf, *boxes), no_contact=(("ghost", "shelf"),))
    moments = yield Trial(scene, Run(0.3, 0.3))
    first, last = moments[0], moments[-1]
    fallen = {n: first.pose(n).p[2] - last.pose(n).p[2] for n in ("held", "ghost")}
    return float((fallen["ghost"] - fallen["held"]) / (rigs.GRAVITY * last.time**2 / 2))


# Heights [m] of the object frames in :func:`settled_position` and :func:`settled_rotation` at rest on the floor.
_RESTING = {"crate": 0.03, "can": 0.05, "slab": 0.01, "wedge": 0.0}


def _dropped() -> Scene:
    floor = rigs.solid("floor", rigs.box(2, 2, 0.1), rigs.posed(0, 0, -0.05, yaw=0.2), 50.0, fixed=True)
    raised = {name: z + 0.005 for name, z in _RESTING.items()}
    return rigs.scene_of(
        "drop",
        floor,
        rigs.solid("crate", rigs.box(0.08, 0.07, 0.06), rigs.posed(0.0, 0.0, raised["crate"], yaw=0.6)),
        rigs.solid("can", Cylinder(0.035, 0.1), rigs.posed(0.3, 0.1, raised["can"], yaw=-0.4)),
        rigs.solid("slab", rigs.box(0.25, 0.15, 0.02), rigs.posed(-0.3, 0.2, raised["slab"], yaw=1.2), 0.6),
        rigs.wedge("wedge", rigs.posed(0.1, -0.3, raised["wedge"], yaw=0.9)),
    )


def settled_position() -> Measurement:
    """Measure the largest position error [mm] of four objects after a fall of 5 mm."""
    scene = _dropped()
    moments = yield Trial(scene, Run(2.0, 2.0))
    off = [moments[-1].pose(n).p - [*scene.object(n).X_WO.p[:2], z] for n, z in _RESTING.items()]
    return float(np.linalg.norm(off, axis=1).max()) * 1000


def settled_rotation() -> Measurement:
    """Measure the largest rotation [deg] of four objects after a fall of 5 mm."""
    scene = _dropped()
    moments = yield Trial(scene, Run(2.0, 2.0))
    return math.degrees(max(moments[-1].pose(n).angle_to(scene.object(n).X_WO) for n in _RESTING))


BEHAVIORS: tuple[Behavior, ...] = (
    Behavior("free_fall", "free fall / (g t²/2)", "", 1.0, 1e-3, "one step in 3 s is 0.07%", free_fall),
    Behavior("slip_angle", "box slips at", "deg", _SLIP, 1.0, "the required accuracy", slip_angle),
    Behavior("period", "pendulum period", "s", _PERIOD, 0.01 * _PERIOD, "1%, the required accuracy", pendulum_period),
    Behavior("decay", "damped swings decay at", "1/s", _RATE, 0.02 * _RATE, "2%, the required accuracy", damped_decay),
    Behavior("restitution", "ball rebounds at", "", 0.6, 0.03, "one step of the fall is 0.02", rebound),
    Behavior("limit", "joint limit exceeded by", "mm", 0.0, 5.0, "limits are springs in most engines", limit_holds),
    Behavior("friction_holds", "held joint sinks", "mm", 0.0, 1.0, "1 mm/s is not visible", friction_holds),
    Behavior("friction_slips", "slipping joint accelerates", "m/s²", _WEIGHT - 6.0, 0.05 * (_WEIGHT - 6.0),
              "5%: one step of 1 s, and soft friction", friction_slips),
    Behavior("damped_friction", "damped, slipping joint falls at", "m/s", (_WEIGHT - 3.0) / 4.0,
              0.02 * (_WEIGHT - 3.0) / 4.0, "2%, as for the decay", damped_friction),
    Behavior("drive", "motor holds at", "mm", 1000 * (0.05 + _WEIGHT / 200.0), 1.0, "1 mm", drive_holds),
    Behavior("mimic", "follower travel / leader travel", "", 2.0, 0.02, "1%: gears are stiff springs in some engines",
              follower_keeps),
    Behavior("no_contact", "fall through shelf / free fall", "", 1.0, 0.02, "the other box settles by 1 or 2 mm",
              passes_through),
    Behavior("settled_mm", "settled position off by", "mm", 0.0, 1.0, "keeps any two engines within 2 mm",
              settled_position),
    Behavior("settled_deg", "settled rotation off by", "deg", 0.0, 0.5, "keeps any two engines within 1 degree",
              settled_rotation),
)  # fmt: skip
