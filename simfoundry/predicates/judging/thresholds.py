"""Thresholds shared by several predicates.

A threshold used by only one predicate is in the module of that predicate.
"""

from __future__ import annotations

# Maximum gap [m] between touching surfaces, equal to :data:`simfoundry.worlds.base.CONTACT_GAP`. Among 515 supporting
# pairs in MuJoCo and PyBullet, none had a gap (``python -m tests.corpora.placements``).
TOUCH = 0.001

# Maximum speed [m/s] of an object at rest; contact jitter in the simulators stays below it.
SETTLED = 0.01

# Margins at which a score is one half, by the unit of the margin. Tasks on a table move objects by a few decimeters and
# turn them by up to 90 deg, so scores between -1 and 1 remain distinguishable over the whole motion.
SCORE_SCALES = {"m": 0.1, "deg": 30.0, "m or rad": 0.1}

# Excess speed [m/s] at which the score of an object at rest is minus one half. Arms move objects at up to 0.4 m/s,
# which therefore costs as much as a distance of 4 cm, so that the distance decides on most of the way.
SCORE_SPEED = 1.0

# Distance [m] beyond which an object supports another one only if no closer object does. For example, a plank over
# three blocks rests on only two of them if the third is too low. Resting objects penetrate each other slightly in
# simulators, and placement leaves a gap of 0.1 mm.
CLOSE = 0.0002

# Maximum angle [deg] between straight up and the push of a supporting object (as in Isaac Lab-Arena). An object that
# pushes more sideways stands or leans beside the other object.
SUPPORT_DEG = 45.0

# Fraction of the friction angle by which a push is closer to vertical than the surface normal. Geometry alone only
# shows that the push lies within the friction cone, so the middle of the upper half of the cone represents it. For 21
# of 24 boards that lean at 46 to 64 deg, this agrees with the contact forces (``python -m tests.corpora.placements``).
FRICTION_SHARE = 0.5

# Minimum fraction of an object's volume that must be in a cavity for the object to be inside it: one half.
ENCLOSED = 0.5

# Maximum angle [deg] between the vertical and the opening direction of a containing cavity; beyond it, the contents
# slide out.
OPENING_DEG = 110.0

# Distance [m] by which a finger is moved toward the other one to test if it presses on the object; the gap must
# decrease by at least half of this distance.
PRESS = 0.005
