"""Thresholds shared by several predicates; those of a single predicate are in its module."""

from __future__ import annotations

TOUCH = 0.001
"""Largest gap [m] between touching surfaces; equal to :data:`simfoundry.worlds.base.CONTACT_GAP`. Of 515 supporting
pairs in MuJoCo and PyBullet, none had a gap (``python -m tests.corpora.placements``)."""

SETTLED = 0.01
"""Largest speed [m/s] of an object at rest: contact jitter in the simulators stays below it."""

CLOSE = 0.0002
"""Distance [m] beyond which an object supports another only if no closer one does: a plank over three blocks, one of
them too low, rests on two. Resting objects penetrate slightly in simulators, and placement leaves a gap of 0.1 mm."""

SUPPORT_DEG = 45.0
"""Largest angle [deg] between straight up and the push of a supporting object (Isaac Lab-Arena's rule); an object that
pushes more sideways stands or leans beside it."""

FRICTION_SHARE = 0.5
"""Share of the friction angle by which a push is closer to vertical than the surface normal. Geometry only determines
that the push lies within the friction cone, so the middle of the upper half of the cone represents it. For 21 of 24
boards that lean at 46 to 64 deg, this agrees with the contact forces (``python -m tests.corpora.placements``)."""

ENCLOSED = 0.5
"""Least share of an object's volume that must be in a cavity for the object to be inside: the majority."""

FACING_DOWN_DEG = 110.0
"""Largest angle [deg] between up and the opening of a containing cavity: beyond it, the contents slide out."""

PRESS = 0.005
"""Distance [m] by which a finger is moved toward the other to test if it presses on the object; the gap must decrease
by half of it."""
