"""Changes between two views that the motion of one part does not account for, such as those of a second part."""

from __future__ import annotations

import numpy as np

from simfoundry.capture.articulation.evidence import REACH, MotionEvidence, pixels_of, surface
from simfoundry.capture.articulation.motions import THICKNESS, Motion, Patch, height_above, within_outline
from simfoundry.capture.articulation.views import Mask
from simfoundry.scene.model import JointType

# Distance from a part within which gone points are its own [m]: its rim, where normals and its mask are uncertain.
RIM = 0.02

# One in so many points of the part's mask is compared with gone points; neighbors are closer than a millimeter or two.
STRIDE = 3


def unclaimed_share(motion: Motion, front: Patch, part: Mask, evidence: MotionEvidence) -> float:
    """Return the share of new or of gone surface, whichever is larger, that is not due to the motion of a part.

    New surface is due to it where the motion brings surface, or if it was behind the front of a part that slides. Gone
    surface is due to it where the part was.

    Args:
        motion: The motion.
        front: The front of the part in the first view.
        part: The pixels of the first view that show the part, shape (h, w).
        evidence: The two views.
    """
    from scipy.spatial import cKDTree

    new = evidence.new.points
    moved = motion.moved(evidence.moved.points - motion.back * evidence.moved.normals)
    is_due = np.isfinite(cKDTree(moved).query(new, distance_upper_bound=REACH)[0])
    if motion.kind is JointType.PRISMATIC:
        before = motion.sources(new)
        is_due |= within_outline(front, before) & (height_above(front, before) < THICKNESS)
    first, whole = evidence.first, surface(evidence.first, evidence.second)
    own = whole.points[part.reshape(-1)[pixels_of(first)]][::STRIDE]
    gone = whole.points[whole.is_gone]
    if not len(own) or not len(gone) or not len(new):
        return 0.0
    is_own = np.isfinite(cKDTree(own).query(gone, distance_upper_bound=RIM)[0])
    return float(max((~is_due).mean(), (~is_own).mean()))
