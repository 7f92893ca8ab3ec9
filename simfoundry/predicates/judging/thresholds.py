"""Every number that decides a predicate, with its unit; docs/predicates.md prints them from here."""

from __future__ import annotations

TOUCH = 0.001
"""Surfaces no farther apart than this [m] touch; as :data:`simfoundry.worlds.base.CONTACT_GAP`. Of 515 pairs of which
one carried the other in MuJoCo and PyBullet none was apart at all (``python -m tests.corpora.placements``)."""

SUPPORT_DEG = 45.0
"""What a thing rests on pushes it within this of straight up [deg] (Isaac Lab-Arena's rule); what pushes it more to the
side stands or leans beside it."""

SETTLED = 0.01
"""What moves no faster than this [m/s] is at rest."""

ENCLOSED = 0.5
"""The share of its volume that is in the cavity of what a thing is inside of."""

FACING_DOWN_DEG = 110.0
"""A cavity whose way out is turned from up by more than this [deg] holds nothing: it is spilt."""

NEAR_SHARE = 1 / 6
"""Things stand side by side within this share of the sum of their mean extents (OmniGibson's rule)."""

OPEN_SHARE = 0.10
"""A joint is open beyond this share of its range, counted from its closed end (OmniGibson's rule)."""

RISE = 0.02
"""What is lifted is higher than the scene describes it by at least this [m]."""

PRESS = 0.005
"""How far a finger is moved towards the other to see whether it presses into the thing [m]; half of that must show."""

UPRIGHT_DEG = 10.0
"""What leans by no more than this [deg] is upright."""

AT = 0.02
"""What is no farther than this [m] from a point is at it."""
