"""Describe the changes to one member of a document, field by field."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from simfoundry.spec.change.diff import values
from simfoundry.spec.change.diff.changes import EXPRESSION_LISTS, PAIR_LISTS, SECTIONS, Path_, expression, same
from simfoundry.spec.change.merge.conflict import ABSENT, Absent
from simfoundry.spec.models.base import Model

# Fields that a body inherits from its material unless the body sets them itself.
INHERITED = ("density", "friction", "restitution", "color")

# Keys of a place that must be equal for a change of position to be described as motion.
_CARRIER = ("on", "inside", "left_of", "right_of", "in_front_of", "behind", "gap")

# Keys of a place that contain a position.
_XY = {"xy", "local_xy"}


class Verbs(list[str]):
    """Phrases that follow a member's name. ``moved`` is True if one of the phrases describes motion."""

    moved = False

    def add_motion(self, old: Mapping[str, Any], new: Mapping[str, Any]) -> None:
        """Add phrases that describe the motion between two poses."""
        found = values.motion(old, new)
        self.extend(values.motion_words(found))
        self.moved = found.moved or found.turned


@dataclass
class Describing:
    """The state for describing the changes from document ``a`` to document ``b``, both of which use the new names.

    Methods that take an old and a new value accept :data:`ABSENT` for a value that one document does not contain.
    """

    a: Mapping[str, Any]
    b: Mapping[str, Any]
    model: type[Model] | None
    joint_units: Mapping[tuple[str, str], str]
    verbose: bool

    def member(self, path: Path_, old: Any, new: Any) -> tuple[Verbs, list[str]]:
        """Return the verb phrases and facts that describe the changes to the member at ``path``."""
        verbs, facts = Verbs(), list[str]()
        if not isinstance(old, dict) or not isinstance(new, dict):
            return verbs, [] if same(old, new) else [values.pair(path[-1], old, new)]
        done = self._where(path, old, new, verbs, facts)
        for key, before, after in _different(old, new):
            if key == "closed" and path[0] == "joints":
                verbs.append(_closing(old.get(key), new.get(key)))
            elif key == "fixed":
                verbs.append("is fixed now" if new.get(key) else "is no longer fixed")
            elif key not in done:
                facts += self.field((*path, key), before, after)
        if path[0] == "materials" and facts:
            facts[-1] += self._users(path[1])
        return verbs, facts

    def field(self, path: Path_, old: Any, new: Any) -> list[str]:
        """Describe the change to the field at ``path``."""
        key = path[-1]
        before, after = ({} if side is ABSENT else side for side in (old, new))
        if key == "goal" or key in (*EXPRESSION_LISTS, *PAIR_LISTS):
            return list(_expressions(key, old, new, self.verbose))
        if key == "shape" and isinstance(old, dict) and isinstance(new, dict):
            if "compound" in old and "compound" in new:
                return list(self._mapping((*path, "compound"), old["compound"], new["compound"]))
            part = f"{_label(path[:-1])} " if "compound" in path else ""
            return [part + _shape(old, new)]
        if path == ("origin", "cousin") and {"recipe", "index", "seed"} <= dict(after).keys():
            return [f"origin: cousin {new['index']} of recipe {new['recipe']}, seed {new['seed']}"]
        whole = isinstance(before, dict) and isinstance(after, dict)
        if key in ("pose", "place") and whole and path[-2:-1] != ("start",):
            if key == "pose":
                return self._pose(path, before, after)
            return [f"{_label(path)} {values.pair('', _place(before), _place(after))}"]
        if whole and not _quantity(old, new):
            return list(self._mapping(path, before, after))
        return [self._leaf(path, old, new)]

    def summary(self, section: str, item: Any) -> str:
        """Summarize a new member in a few words."""
        if not isinstance(item, dict):
            return values.value("", item)
        words = [values.shape(item["shape"])] if "shape" in item else []
        words += [values.shortened(str(item[key])) for key in ("asset", "model", "type") if key in item]
        if isinstance(item.get("place"), dict):
            words.append(values.place(item["place"]))
        elif isinstance(item.get("pose"), dict) and section in ("objects", "robots", "cameras"):
            words.append(f"at {values.value('', item['pose'].get('xyz', (0.0, 0.0, 0.0)))} m")
        if section == "materials":
            words += [f"{key} {self._with_unit((section, '*', key), item[key])}" for key in item if key != "color"]
        if section == "subtasks" and "goal" in item:
            words.append(expression(item["goal"]))
        if not words and len(item) <= values.FEW and not any(isinstance(v, dict) for v in item.values()):
            words.append(values.value("", item))
        return ", ".join(words)

    # -- position ---------------------------------------------------------------------------------------------------

    def _where(self, path: Path_, old: dict[str, Any], new: dict[str, Any], verbs: Verbs, facts: list[str]) -> Path_:
        """Describe a change in position, and return the keys that the description covers."""
        if "place" in old or "place" in new:
            self._placed(old, new, verbs)
        elif path[0] == "joints" and len(path) == 2:  # a joint does not move; only its frame changes
            return ()
        elif not same(old.get("pose"), new.get("pose")):
            before, after = (side.get("pose") or {} for side in (old, new))
            verbs.add_motion(before, after)
            targets = [pose.get("look_at") for pose in (before, after)]
            if not same(*targets) and any(isinstance(target, str) for target in targets):
                verbs.append(_looking(*targets))
            if self.verbose and not verbs.moved:
                facts.append("same pose, written differently")
        return ("pose", "place")

    def _placed(self, old: dict[str, Any], new: dict[str, Any], verbs: Verbs) -> None:
        before, after = old.get("place"), new.get("place")
        if same(before, after) and same(old.get("pose"), new.get("pose")):
            return
        if isinstance(before, dict) and isinstance(after, dict):
            alike = all(same(before.get(key), after.get(key)) for key in _CARRIER)
            if alike and before.keys() & _XY == after.keys() & _XY:
                return verbs.add_motion(_flat(before), _flat(after))
        verbs.append(f"is now {_where(new)} (was {_where(old)})")
        verbs.add_motion({**_angles(old), "xyz": (0, 0, 0)}, {**_angles(new), "xyz": (0, 0, 0)})
        verbs.moved = True

    def _pose(self, path: Path_, old: dict[str, Any], new: dict[str, Any]) -> list[str]:
        """Describe the change to the pose of a part, a joint or a background."""
        if found := values.motion_words(values.motion(old, new)):
            return [f"{_label(path)} {', '.join(found)}"]
        return [f"{_label(path)}: same pose, written differently"] if self.verbose else []

    # -- values -----------------------------------------------------------------------------------------------------

    def _mapping(self, path: Path_, old: dict[str, Any], new: dict[str, Any]) -> Iterator[str]:
        for key, before, after in _different(old, new):
            here = (*path, key)
            one_sided = before is ABSENT or after is ABSENT
            if path[-1] in SECTIONS and one_sided and not self._has_default(here):
                about = self.summary(path[-1], after) if before is ABSENT else ""
                yield f"{_label(here)} {'added' if before is ABSENT else 'removed'}" + (f": {about}" if about else "")
            else:
                yield from self.field(here, before, after)

    def _has_default(self, path: Path_) -> bool:
        """Return True if ``path`` is the position of an object's joint, which defaults to 0."""
        return path[0] == "objects" and path[-2] == "joints"

    def _leaf(self, path: Path_, old: Any, new: Any) -> str:
        key, unit, label = path[-1], self._unit(path), _label(path)
        if self._has_default(path):
            old, new = (0.0 if side is ABSENT else side for side in (old, new))
        both = old is not ABSENT and new is not ABSENT
        if self._has_default(path) or (both and not isinstance(old, dict) and not isinstance(new, dict)):
            return f"{label} {values.pair(key, old, new, unit)}"
        left, right = self._side(path, old, self.a, "" if both else unit), self._side(path, new, self.b, unit)
        if old is ABSENT and not left:
            return f"{label} now {right}"
        return f"{label} {left} removed" if new is ABSENT and not right else f"{label} {left} → {right}"

    def _side(self, path: Path_, item: Any, document: Mapping[str, Any], unit: str) -> str:
        """Format a value with its unit.

        If the document does not set the value, the source of the value is appended.
        """
        key = path[-1]
        if item is not ABSENT:
            return values.with_unit(values.value(key, item), unit)
        inherited = _material(path, document) if key in INHERITED else None
        if inherited is not None:
            name, material = inherited
            found = material.get(key, values.default(self.model, ("materials", "*", key)))
            if found is not None:
                return f"{values.with_unit(values.value(key, found), unit)} (from {name})"
        found = values.default(self.model, _generic(path))
        return f"{values.value(key, found)} (default)" if found is not None and found != () else ""

    def _unit(self, path: Path_) -> str:
        if self._has_default(path):
            return self.joint_units.get((path[1], path[-1]), "")
        return values.unit(self.model, _generic(path))

    def _with_unit(self, path: Path_, item: Any) -> str:
        return values.with_unit(values.value(path[-1], item), self._unit(path))

    def _users(self, material: str) -> str:
        """Return a note that lists the objects that use a material."""
        bodies = {**_mapping_at(self.b, "objects"), **_mapping_at(self.b, "links")}
        users = [name for name, item in bodies.items() if isinstance(item, dict) and item.get("material") == material]
        more = f" and {len(users) - 3} more" if len(users) > 3 else ""
        return f" (of {', '.join(users[:3])}{more})" if users else ""


def _different(old: dict[str, Any], new: dict[str, Any]) -> Iterator[tuple[str, Any, Any]]:
    """Yield each key whose values differ, with the old and new values."""
    for key in dict.fromkeys((*old, *new)):
        before, after = old.get(key, ABSENT), new.get(key, ABSENT)
        if not same(before, after):
            yield key, before, after


def _closing(old: Any, new: Any) -> str:
    """Describe a change in the limit at which a joint is considered closed."""
    now, before = (f"at its {end} limit" if end else "where it is nearest to zero" for end in (new, old))
    return f"closes {now} (was: {before})"


def _expressions(key: str, old: Any, new: Any, verbose: bool) -> Iterator[str]:
    """Yield descriptions such as ``goal gains Inside(cup, bowl)`` and ``relations lose OnTop(cup, desk)``."""
    label, gain, lose = (key, "gain", "lose") if key == "relations" else (key, "gains", "loses")
    if key == "goal":
        before, after = _conjuncts(old), _conjuncts(new)
    else:
        before, after = (tuple(map(expression, side)) if isinstance(side, tuple | list) else () for side in (old, new))
    come, gone = [t for t in after if t not in before], [t for t in before if t not in after]
    parts = [f"{verb} {', '.join(items)}" for verb, items in ((gain, come), (lose, gone)) if items]
    if parts:
        yield f"{label} {' and '.join(parts)}"
    elif verbose:
        yield f"{label}: reordered"


def _conjuncts(goal: Any) -> tuple[str, ...]:
    """Return the conditions that must all hold, including those in nested ``all`` lists."""
    match goal:
        case () | None | Absent.ABSENT:
            return ()
        case {"all": tuple() | list() as below} if len(goal) == 1:
            return tuple(text for item in below for text in _conjuncts(item))
    return (expression(goal),)


def _shape(old: dict[str, Any], new: dict[str, Any]) -> str:
    left, right = values.shape(old), values.shape(new)
    if left == right:
        return f"{left.partition(' of ')[0]} with a different outline"
    return f"{left.removesuffix(' m')} → {right}" if "box" in old and "box" in new else f"{left} → {right}"


def _place(item: Any) -> str:
    return values.place(item) if item else "none"


def _where(item: dict[str, Any]) -> str:
    if isinstance(item.get("place"), dict):
        return values.place(item["place"])
    return f"at {values.value('', (item.get('pose') or {}).get('xyz', (0.0, 0.0, 0.0)))} m"


def _angles(item: dict[str, Any]) -> dict[str, Any]:
    return item.get("place") or item.get("pose") or {}


def _flat(place: dict[str, Any]) -> dict[str, Any]:
    """Return a place as a pose in the ground plane, so that it can be compared with another place of the same kind."""
    x, y = place.get("xy") or place.get("local_xy") or (0.0, 0.0)
    return {**place, "xyz": (x, y, 0.0)}


def _quantity(old: Any, new: Any) -> bool:
    """Return True if either mapping represents a single value: an estimate, or an angle in degrees."""
    return any(isinstance(side, dict) and ("value" in side or "deg" in side) for side in (old, new))


def _material(path: Path_, document: Mapping[str, Any]) -> tuple[str, dict[str, Any]] | None:
    """Return the name and the data of the material that applies to the field at ``path``."""
    place: Any = document
    name = None
    for part in path[:-1]:
        place = place.get(part) if isinstance(place, dict) else None
        name = place["material"] if isinstance(place, dict) and "material" in place else name
    found = _mapping_at(document, "materials").get(name) if isinstance(name, str) else None
    return (str(name), found) if isinstance(found, dict) else None


def _mapping_at(document: Mapping[str, Any], key: str) -> dict[str, Any]:
    found = document.get(key)
    return found if isinstance(found, dict) else {}


def _generic(path: Path_) -> Path_:
    """Return the path with each name replaced by ``*``.

    The result is used to look up the properties of a field, which are the same for every member.
    """
    return tuple("*" if k and path[k - 1] in SECTIONS else part for k, part in enumerate(path))


def _label(path: Path_) -> str:
    """Return the label of a field, such as ``part left color``. It is the path of the field below its member."""
    start = 2 if path[0] in SECTIONS and len(path) > 2 else 0
    parts = [part.removesuffix("_deg") for part in path[start:]]
    if parts[:2] == ["shape", "compound"]:
        return " ".join(["part", *parts[2:]])
    for k in range(len(parts) - 1):
        if path[start + k] in SECTIONS:
            parts[k] = parts[k].removesuffix("s")
    return " ".join(parts)


def _looking(old: Any, new: Any) -> str:
    """Describe a change of a camera's target, which is a name, a point, or None."""
    shown = [f"at {values.value('', target)}" if target is not None else "by its rotation" for target in (old, new)]
    return f"looks {shown[1]} (was {shown[0]})"
