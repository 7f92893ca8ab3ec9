"""Refine a motion, so that it explains two views best."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from simfoundry.capture.articulation.evidence import MotionEvidence
from simfoundry.capture.articulation.motions import Motion
from simfoundry.geometry.frames import Array, cross
from simfoundry.scene.model import JointType

# Number of evaluations. A simplex search stops early where few points decide.
EVALUATIONS = 160

# Edges of the initial simplex: amount of motion [m, rad], pivot [m], tilt of the axis [rad], and thickness [m].
SLIDE_STEP, TURN_STEP, PIVOT_STEP, TILT_STEP, BACK_STEP = 0.02, 0.08, 0.015, 0.06, 0.005

# Smallest thickness of a part whose back is seen [m], such as a sheet of metal.
THINNEST = 0.001

# Cost of a hinge that is away from the edge, because the views hardly tell its place across a panel [1/m].
DRIFT = 5.0

# Distance by which a front may reach farther than its outline shows, because points near a hinge hardly move [m], and
# the share of the cost that remains there, for doors that are seen so obliquely that only the cost tells their hinge.
UNSEEN, REMAINING = 0.03, 0.2

# Smallest amount of motion [m, rad].
LEAST = 1e-3

# What refinement may change: the amount of a motion, the place and the direction of its axis, and the thickness of a
# part whose back is seen.
EVERYTHING = frozenset(("q", "pivot", "axis"))
SNAPPED = frozenset(("q", "pivot", "back"))


def refined_motion(motion: Motion, evidence: MotionEvidence, free: frozenset[str] = EVERYTHING) -> Motion:
    """Return the motion near a candidate that scores best, among those that differ in what is ``free``."""
    from scipy.optimize import minimize

    side = cross(motion.axis, np.eye(3)[int(np.argmin(np.abs(motion.axis)))])
    side /= np.linalg.norm(side)
    other = cross(motion.axis, side)
    is_turn = motion.kind is JointType.REVOLUTE
    may_shift, may_tilt = is_turn and "pivot" in free, "axis" in free
    may_thicken = motion.back > 0 and "back" in free
    steps = [TURN_STEP if is_turn else SLIDE_STEP]
    steps += [PIVOT_STEP] * 2 * may_shift + [TILT_STEP] * 2 * may_tilt + [BACK_STEP] * may_thicken

    def at(x: Array) -> Motion:
        shift = x[1:3] if may_shift else np.zeros(2)
        tilt = x[-2:] if may_tilt else np.zeros(2)
        back = max(THINNEST, float(motion.back + x[-1])) if may_thicken else motion.back
        axis = motion.axis + tilt[0] * side + tilt[1] * other
        pivot = motion.pivot + shift[0] * side + shift[1] * other
        q = max(LEAST, float(motion.q + x[0]))
        return replace(motion, axis=axis / np.linalg.norm(axis), pivot=pivot, q=q, back=back)

    def cost(x: Array) -> float:
        return -rank_of(at(x), evidence)

    simplex = np.vstack([np.zeros(len(steps)), np.diag(steps)])
    options = {"initial_simplex": simplex, "maxfev": EVALUATIONS, "xatol": 1e-4, "fatol": 1e-4}
    return at(minimize(cost, np.zeros(len(steps)), method="Nelder-Mead", options=options).x)


def rank_of(motion: Motion, evidence: MotionEvidence) -> float:
    """Return the score of a motion, less the cost of a hinge that is away from the edge of its part."""
    if motion.edge is None:
        return evidence.score(motion)
    away = motion.pivot - motion.edge
    if motion.outward is not None:
        farther = min(UNSEEN, max(0.0, float(away @ motion.outward)))
        away = away - (1 - REMAINING) * farther * motion.outward
    return evidence.score(motion) - DRIFT * float(np.linalg.norm(cross(away, motion.axis)))
