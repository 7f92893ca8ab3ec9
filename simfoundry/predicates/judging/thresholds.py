"""Thresholds that several predicates share; those of one predicate stand in its file."""

from __future__ import annotations

TOUCH = 0.001
"""Surfaces no farther apart than this [m] touch; as :data:`simfoundry.worlds.base.CONTACT_GAP`. Of 515 pairs of which
one supported the other in MuJoCo and PyBullet none was apart at all (``python -m tests.corpora.placements``)."""

SETTLED = 0.01
"""Greatest speed [m/s] of what is at rest: the jitter of contacts in the simulators stays below it."""

CLOSE = 0.0002
"""Distance [m] from which an object supports another only if no closer one does: a plank over three
blocks of which one is too low rests on two. Simulators let what rests sink in, and places leave 0.1 mm."""

SUPPORT_DEG = 45.0
"""Greatest angle [deg] between straight up and the push of what supports an object (Isaac Lab-Arena's rule); what
pushes it more to the side stands or leans beside it."""

FRICTION_SHARE = 0.5
"""Share of the friction angle by which a push is nearer to up than the surface: all that geometry knows of a push is
that it lies within the friction cone, so that the middle of the upper half of the cone stands for it. Of 24 boards that
lean at 46 to 64 deg, the contact forces agree with that in 21 (``python -m tests.corpora.placements``)."""

ENCLOSED = 0.5
"""Least share of an object's volume in the cavity that it is inside of: the majority."""

FACING_DOWN_DEG = 110.0
"""Greatest angle [deg] between up and the opening of a cavity that holds something: beyond, the content slides out."""

PRESS = 0.005
"""Travel [m] by which a finger is moved towards the other to see if it presses on the object; half of it must show."""
