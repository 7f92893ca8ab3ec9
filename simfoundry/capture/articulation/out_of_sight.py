"""Drawers whose front has mostly left the second image, so that only the tray tells that they are open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from simfoundry.capture.articulation.evidence import MotionEvidence
from simfoundry.capture.articulation.motions import (
    QUANTILES,
    SLIDES,
    THICKNESS,
    Motion,
    Patch,
    height_above,
    within_outline,
)
from simfoundry.capture.articulation.refine import refined_motion
from simfoundry.scene.model import JointType

# Surfaces of a tray are along the slide or across it: bounds of the cosines between their normals and the slide, and
# the share of new surface that must keep them. Noise of normals is 10 degrees.
ALONG, ACROSS, TRAY_SHARE = 0.3, 0.95, 0.85

# Largest shares of surface that speak against a slide whose front is mostly out of sight, and the smallest share that
# must speak for it.
AGAINST, IN_FAVOR = 0.03, 0.05


def slide_out_of_sight(evidence: MotionEvidence, fronts: Sequence[Patch]) -> tuple[Motion, float] | None:
    """Return the slide of a drawer whose front has mostly left the second image, and the share of new surface that it
    explains, or None if there is no such slide.

    If nothing of the front is in the image, the surface must be that of a tray behind it. The drawer is then open at
    least as far as its tray stands out, and so far that its front is not where there is free space.
    """
    found = []
    for front in fronts:
        cosines = np.abs(evidence.new.normals @ front.normal)
        if ((cosines < ALONG) | (cosines > ACROSS)).mean() > TRAY_SHARE:
            slides = [Motion(JointType.PRISMATIC, front.normal, front.center, q) for q in SLIDES]
            found.append((refined_motion(max(slides, key=evidence.score), evidence, frozenset("q")), front))
    if not found:
        return None
    slide, _ = max(found, key=lambda each: evidence.score(each[0]))
    judged = evidence.judge(slide)
    if max(judged.impossible, judged.contradicted) < AGAINST and judged.explained > IN_FAVOR:
        return slide, judged.explained
    for slide, front in found:
        height = height_above(front, evidence.new.points)
        share = float((within_outline(front, evidence.new.points) & (height > -THICKNESS)).mean())
        least = float(np.quantile(height, QUANTILES[1]))
        for q in (least, *(q for q in SLIDES if q > least)) if share > TRAY_SHARE else ():
            judged = evidence.judge(replace(slide, q=q))
            if max(judged.impossible, judged.contradicted) < AGAINST:
                return replace(slide, q=q), share
    return None
