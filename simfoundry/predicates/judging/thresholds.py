"""Thresholds that several predicates share; those of one predicate stand in its file."""

from __future__ import annotations

TOUCH = 0.001
"""Surfaces no farther apart than this [m] touch; as :data:`simfoundry.worlds.base.CONTACT_GAP`. Of 515 pairs of which
one supported the other in MuJoCo and PyBullet none was apart at all (``python -m tests.corpora.placements``)."""

SETTLED = 0.01
"""Greatest speed [m/s] of what is at rest: the jitter of contacts in the simulators stays below it."""

SUPPORT_DEG = 45.0
"""Greatest angle [deg] between straight up and the push of what supports an object (Isaac Lab-Arena's rule); what
pushes it more to the side stands or leans beside it."""

ENCLOSED = 0.5
"""Least share of an object's volume in the cavity that it is inside of: the majority."""

FACING_DOWN_DEG = 110.0
"""Greatest angle [deg] between up and the opening of a cavity that holds something: beyond, the content slides out."""

PRESS = 0.005
"""Travel [m] by which a finger is moved towards the other to see if it presses on the object; half of it must show."""
