"""Comparison of an engine's read-back with the scene, in which all differences must be covered by a reported loss.

Values are compared using the tolerance in the target's profile, relative to the value or to a minimum magnitude below
which errors do not matter.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np

from simfoundry.backends.convex_hulls import REPLACED, with_hulls
from simfoundry.backends.features import Fidelity
from simfoundry.backends.losses import Loss
from simfoundry.backends.pybullet.surfaces import SKIN, inset_hull
from simfoundry.geometry.shapes import Mesh
from simfoundry.scene.model import Scene
from simfoundry.verify import readback as rb
from simfoundry.verify.engines import TOLERANCE, VerifyEngine
from simfoundry.verify.expected import RobotReadback, expected_readback, expected_robots, static_links, without_robots
from simfoundry.verify.readback import WorldReadback, pose_of

# Magnitudes in SI units below which errors are absolute; smaller values do not matter in a tabletop scene.
FLOORS = dict.fromkeys(
    ("position", "rotation", "gravity", "axis", "limits", "law", "drive", "effort", "max_effort", "max_velocity"), 1.0
) | {
    **{"mass": 1e-3, "com": 0.01, "inertia": 1e-9, "bounds": 0.1, "friction": 0.1, "restitution": 0.1},
    **{"torsional_friction": 1e-3, "rolling_friction": 1e-3, "damping": 1e-3, "joint friction": 1e-3},
    **{"armature": 1e-4, "joint position": 1.0, "max_effort": 1.0, "max_velocity": 1.0, "gravity_compensation": 1.0},
}

# Maximum deviation of an approximated collision shape from the shape in the scene [m], which allows for Bullet's margin
# at both ends and at a corner.
SKIN_M = 2.5e-3

# Quantities that must be present even if the entire object is approximated.
_WHOLE = ("link", "joint", "robot", "held", "collider")

# Quantities of a static link that an engine may omit.
_WELDED = ("mass", "com", "inertia")


_SHAPES = ("box", "sphere", "cylinder", "capsule", "convex_mesh")
# The features that describe collider shapes and joint types; each collider and each joint has exactly one of them.
_JOINTS = ("fixed_joint", "revolute", "continuous", "prismatic", "ball", "free")

# The collider quantities to compare, each with its read-back field and its features.
_SURFACE = {
    "bounds": ("bounds", _SHAPES),
    "friction": ("friction", ("friction",)),
    "restitution": ("restitution", ("restitution",)),
    "torsional_friction": ("spinning", ("torsional_friction",)),
    "rolling_friction": ("rolling", ("rolling_friction",)),
}

# The joint quantities to compare, each with its read-back field and its features.
_JOINT = {
    "axis": ("axis", ()),
    "limits": ("limits", ("joint_limits",)),
    "damping": ("damping", ("joint_damping",)),
    "joint friction": ("friction", ("joint_friction",)),
    "armature": ("armature", ("armature",)),
    "law": ("law", ("mimic",)),
    "drive": ("drive", ("drive",)),
    "effort": ("effort", ("drive",)),
    "max_effort": ("max_effort", ("joint_effort",)),
    "max_velocity": ("max_velocity", ("joint_velocity",)),
}

# The profile features whose names differ from the compared quantities.
_FEATURES = {
    **{"joint friction": "joint_friction", "bounds": "convex_mesh"},
    **{"max_effort": "joint_effort", "max_velocity": "joint_velocity"},
}

# The feature and element of every loss that could explain a difference; see :class:`Loss`.
Keys = frozenset[tuple[str, str]]


@dataclass(frozen=True)
class Difference:
    """A quantity of the element ``name`` that differs in an engine.

    ``covered`` is the loss or gap that explains the difference.
    """

    name: str
    quantity: str
    expected: Any
    got: Any
    error: float
    covered: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return the difference as plain data for JSON, omitting the error if it is NaN."""
        return asdict(self) | {"error": self.error if math.isfinite(self.error) else None}


@dataclass(frozen=True)
class ReadbackComparison:
    """The result of a comparison.

    Attributes:
        compared: The number of quantities that were compared.
        mismatches: The differences without an explanation.
        covered: The differences that are explained by a loss or a gap.
        stale: The losses that are reported although the engine preserves the quantity.
    """

    compared: int
    mismatches: tuple[Difference, ...]
    covered: tuple[Difference, ...]
    stale: tuple[str, ...] = field(default=())


def compare(scene: Scene, facts: WorldReadback, engine: VerifyEngine, losses: Iterable[Loss]) -> ReadbackComparison:
    """Compare an engine's read-back with the scene. ``losses`` are the losses of the target whose build was read."""
    # Converting a robot does not explain differences in the compared quantities. Nor do colliders that are simpler than
    # the visuals, because the comparison uses the scene's colliders.
    lost = [
        loss
        for loss in losses
        if loss.feature != "collision_shape" and (loss.fidelity is Fidelity.DROPPED or loss.feature != "robots")
    ]
    # The backend of another package writes every primitive as it is.
    scene = with_hulls(scene, REPLACED.get(engine.target.backend, ()))
    ours, robots = without_robots(facts, {robot.name for robot in scene.robots})
    checker = _Checker(expected_readback(scene, engine.target.backend), ours, static_links(scene), engine)
    checker.run()
    for name, robot in expected_robots(scene, engine.target.backend).items():
        checker.robot(name, robot, robots.get(name))
    found = []
    for difference, keys in checker.found:
        loss = next((lo for lo in lost if _covers(lo, keys, difference, checker.expected, scene)), None)
        reason = loss.reason if loss is not None else _gap_reason(engine, difference)
        found.append(replace(difference, covered=reason))
    used = frozenset[tuple[str, str]]().union(*(keys for _, keys in checker.found))
    # A loss is stale if its element was compared and the loss did not cause a difference.
    seen = checker.checked - checker.untold - used
    restored = engine.target.profile.restored
    stale = [lo.path for lo in lost if lo.element and _key(lo) in seen and lo.feature not in restored]
    mismatches, covered = (tuple(d for d in found if bool(d.covered) == known) for known in (False, True))
    return ReadbackComparison(checker.compared, mismatches, covered, tuple(stale))


def _gap_reason(engine: VerifyEngine, difference: Difference) -> str:
    """Return the reason for a gap that explains the difference, or an empty string if no gap explains it.

    A gap explains a missing quantity and, if it states a size, an error up to that size.
    """
    gap = engine.target.profile.gaps.get(_FEATURES.get(difference.quantity, difference.quantity))
    if gap is None:
        return ""
    if gap.size is not None and difference.got is not None:
        off = float(np.abs(np.asarray(difference.expected) - np.asarray(difference.got)).max())
        return f"{gap.reason} (up to {gap.size:g})" if off <= gap.size else ""
    return gap.reason if not difference.got else ""


class _Checker:
    """A comparison of two read-backs, which collects the differences and the keys of losses that could explain them."""

    def __init__(self, expected: WorldReadback, got: WorldReadback, static: set[str], engine: VerifyEngine) -> None:
        self.expected, self.got, self.static, self.engine = expected, got, static, engine
        self.compared = 0
        self.checked: set[tuple[str, str]] = set()
        self.untold: set[tuple[str, str]] = set()
        self.found: list[tuple[Difference, Keys]] = []

    def run(self) -> None:
        """Compare all names, and then all quantities."""
        expected, got = self.expected, self.got
        self._names("link", expected.links, got.links)
        self._names("joint", expected.joints, got.joints)
        for name in (name for name in expected.links if name in got.links):
            self._link(name, expected.links[name], got.links[name])
        for name in (name for name in expected.joints if name in got.joints):
            self._joint(name, expected.joints[name], got.joints[name])
        self._numbers("world", "gravity", expected.gravity, got.gravity, _keys(["gravity"], ""))
        if got.pairs is not None:
            self._pairs(expected.pairs or {}, got.pairs)
        if got.silent is not None:
            self._silent(set(expected.silent or ()), set(got.silent))

    def robot(self, name: str, expected: RobotReadback | None, got: RobotReadback | None) -> None:
        """Compare a robot. If ``expected`` is None, only its presence is checked."""
        keys = _keys(["robots"], name)
        self.compared += 1
        if got is None:
            self._add(name, "robot", name, None, math.inf, keys)
            return
        if expected is None:
            return
        if expected.pose is not None and got.pose is not None:
            self._pose(name, expected.pose, got.pose)
        self._numbers(name, "mass", expected.mass, got.mass, keys)
        self._names("joint", *({f"{name}.{n}": j for n, j in facts.joints.items()} for facts in (expected, got)))
        for joint, there in expected.joints.items():
            if (here := got.joints.get(joint)) is not None:
                self._numbers(f"{name}.{joint}", "limits", there.limits, here.limits, keys)
                self._numbers(f"{name}.{joint}", "joint position", there.position, here.position, keys)
        if expected.actuators is not None and got.actuators is not None:
            self._words(name, "actuators", " ".join(expected.actuators), " ".join(got.actuators), keys)

    def _names(self, kind: str, expected: Mapping[str, object], got: Mapping[str, object]) -> None:
        self.compared += len(expected)
        for name in sorted(set(expected) ^ set(got)):
            there, here = (name, None) if name in expected else (None, name)
            self._add(name, kind, there, here, math.inf, _keys(("robots", *_JOINTS), *_owners(name)))

    def _link(self, name: str, expected: rb.LinkReadback, got: rb.LinkReadback) -> None:
        if expected.pose is not None and got.pose is not None:
            self._pose(name, expected.pose, got.pose)
        for quantity in _WELDED:
            wanted, held = getattr(expected, quantity), getattr(got, quantity)
            if held is None and name in self.static:
                continue
            keys = _keys(["mass" if quantity == "mass" else "inertia"], *_owners(name))
            self._numbers(name, quantity, wanted, held, keys, required=True)
        keys = _keys(["gravity_compensation"], *_owners(name))
        self._numbers(name, "gravity_compensation", expected.gravity_compensation, got.gravity_compensation, keys)
        self._words(name, "held", expected.held, got.held, _keys(("fixed", *_JOINTS), *_owners(name)))
        if got.colliders is not None:
            self._colliders(name, expected.colliders or (), got.colliders)

    def _pose(self, name: str, expected: rb.Numbers, got: rb.Numbers) -> None:
        keys, angle = _keys(["pose"], *_owners(name)), pose_of(expected).angle_to(pose_of(got))
        self._numbers(name, "position", expected[:3], got[:3], keys)
        self._count(name, "rotation", expected[3:], got[3:], angle, keys)

    def _colliders(
        self, link: str, expected: Sequence[rb.ColliderReadback], got: Sequence[rb.ColliderReadback]
    ) -> None:
        self.compared += 1
        if len(expected) != len(got):
            self._add(link, "colliders", len(expected), len(got), math.inf, _keys(_SHAPES, *_owners(link)))
            return
        by_name = {c.name: c for c in got}
        named = all(c.name is not None for c in got)
        for there, unnamed in zip(expected, got, strict=True):
            here = by_name.get(there.name) if named else unnamed
            name = f"{link}.{there.name}"
            owners = (*_owners(link), name)
            if here is None:
                self._add(name, "collider", there.name, None, math.inf, _keys(_SHAPES, *owners))
                continue
            self.compared += here.kind is not None
            if here.kind not in (None, there.kind):
                self._add(name, "shape", there.kind, here.kind, math.inf, _keys(_SHAPES, *owners))
            for quantity, (field_name, features) in _SURFACE.items():
                wanted, held = getattr(there, field_name), getattr(here, field_name)
                self._numbers(name, quantity, wanted, held, _keys(features, *owners))

    def _joint(self, name: str, expected: rb.JointReadback, got: rb.JointReadback) -> None:
        if got.type is not None:
            self.compared += 1
            if expected.type != ("revolute" if got.type == "continuous" else got.type):
                self._add(name, "type", expected.type, got.type, math.inf, _keys(_JOINTS, name))
                return
        for quantity, (field_name, features) in _JOINT.items():
            wanted, held = getattr(expected, field_name), getattr(got, field_name)
            self._numbers(name, quantity, wanted, held, _keys((*features, *_JOINTS), name))
        self._words(name, "follows", expected.follows, got.follows, _keys(("mimic", *_JOINTS), name))
        keys = _keys(("joint_position", *_JOINTS), name)
        if isinstance(expected.position, tuple) and isinstance(got.position, tuple):
            angle = pose_of((0, 0, 0, *expected.position)).angle_to(pose_of((0, 0, 0, *got.position)))
            self._count(name, "joint position", expected.position, got.position, angle, keys)
        else:
            self._numbers(name, "joint position", expected.position, got.position, keys)

    def _silent(self, expected: set[str], got: set[str]) -> None:
        """Compare the pairs of links that could touch but whose collisions are disabled."""
        colliding = {name for name, link in self.expected.links.items() if link.colliders}
        for pair in sorted(expected | got):
            ends = set(pair.split("|"))
            if ends <= colliding and not ends <= self.static:
                keys = _keys(["no_contact"], "no_contact", *(end.partition(".")[0] for end in ends))
                there, here = ("pass" if pair in each else "touch" for each in (expected, got))
                self._words(pair.replace("|", " and "), "contact", there, here, keys)

    def _words(self, name: str, quantity: str, expected: str | None, got: str | None, keys: Keys) -> None:
        """Compare strings, skipping values that an engine does not report."""
        if got is None or expected is None:
            self.untold |= keys
            return
        self._count(name, quantity, expected, got, 0.0 if expected == got else math.inf, keys)

    def _pairs(self, expected: Mapping[str, float], got: Mapping[str, float]) -> None:
        """Compare the friction coefficients of pairs of colliders.

        A pair has no entry if it uses the engine's default rule or if both colliders have the same coefficient.
        """
        surfaces = {
            f"{link}.{c.name}": c.friction for link, facts in self.expected.links.items() for c in facts.colliders or ()
        }
        for pair in sorted(set(expected) | set(got)):
            a, b = pair.split("|")
            wanted = expected.get(pair)
            if wanted is None and a in surfaces and b in surfaces:
                wanted = math.sqrt((surfaces[a] or 0.0) * (surfaces[b] or 0.0))
            name = pair.replace("|", " and ")
            self._numbers(name, "friction", wanted, got.get(pair), _keys(["friction"], ""), required=True)

    def _numbers(
        self, name: str, quantity: str, expected: object, got: object, keys: Keys, required: bool = False
    ) -> None:
        """Compare scalars or vectors, skipping values that an engine does not report unless they are required."""
        if got is None or expected is None:
            self.untold |= keys
            if required and (got is None) != (expected is None):
                self.compared += 1
                self._add(name, quantity, expected, got, math.inf, keys)
            return
        there, here, error = np.asarray(expected, dtype=np.float64), np.asarray(got, dtype=np.float64), math.inf
        if there.shape == here.shape:
            error = float(np.linalg.norm(here - there)) / max(float(np.linalg.norm(there)), FLOORS[quantity])
        self._count(name, quantity, expected, got, error, keys)

    def _count(self, name: str, quantity: str, expected: object, got: object, error: float, keys: Keys) -> None:
        self.compared += 1
        self.checked |= keys
        if not error <= self.engine.tolerance(quantity):  # NaN also counts as a difference
            self._add(name, quantity, expected, got, error, keys)

    def _add(self, name: str, quantity: str, expected: object, got: object, error: float, keys: Keys) -> None:
        self.checked |= keys
        self.found.append((Difference(name, quantity, expected, got, error), keys))


def _keys(features: Iterable[str], *elements: str) -> Keys:
    return frozenset(product(features, elements))


def _key(loss: Loss) -> tuple[str, str]:
    return loss.feature, loss.element


def _owners(link: str) -> tuple[str, str]:
    """Return the object name and the link name. A loss may refer to a link by either name."""
    return link.partition(".")[0], link


def _covers(loss: Loss, keys: Keys, difference: Difference, expected: WorldReadback, scene: Scene) -> bool:
    """Return True if a loss explains a difference. An approximation explains errors up to its stated size."""
    if loss.fidelity is Fidelity.DROPPED:
        return _key(loss) in keys or (not loss.element and any(loss.feature == feature for feature, _ in keys))
    if difference.quantity in _WHOLE or _key(loss) not in keys:
        return False
    if difference.quantity == "bounds":
        off = np.abs(np.asarray(difference.expected) - np.asarray(difference.got))
        return bool(off.max() <= SKIN_M or off.max() <= _tip(scene, difference.name) + SKIN_M)
    if difference.quantity in ("friction", "restitution"):
        return _one_for_all(difference, expected)
    return True


def _tip(scene: Scene, name: str) -> float:
    """Return the distance [m] that the tips of a convex mesh move if all faces are moved inward by Bullet's margin.

    Sharper tips move farther.
    """
    link, _, collider = name.rpartition(".")
    for item in scene.objects:
        for each in item.links:
            for part in each.colliders:
                if (item.qualified(each.name), part.name) == (link, collider) and isinstance(part.geometry, Mesh):
                    smaller = inset_hull(part.geometry, SKIN)
                    if smaller is not None:
                        bounds = [rb.mesh_bounds(m.vertices, part.X_LG) for m in (part.geometry, smaller)]
                        return float(np.abs(np.subtract(bounds[0], bounds[1])).max())
    return 0.0


def _one_for_all(difference: Difference, expected: WorldReadback) -> bool:
    """Return True if a coefficient that applies to a whole link is within the range of the link's coefficients."""
    link = difference.name.rpartition(".")[0]
    colliders = expected.links[link].colliders or () if link in expected.links else ()
    values = [v for c in colliders if (v := getattr(c, difference.quantity)) is not None]
    return bool(values) and min(values) - TOLERANCE <= float(difference.got) <= max(values) + TOLERANCE
