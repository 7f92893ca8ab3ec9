"""Names in a document that others refer to, when a thing is called otherwise or is gone."""

from __future__ import annotations

from collections.abc import Mapping, Set
from typing import Any

from simfoundry.spec.models.expressions import Call, ExpressionError, parse_call

Data = dict[str, Any]

ANCHORS = ("on", "inside", "left_of", "right_of", "in_front_of", "behind")
"""Keys of a place that name other things."""


def renamed(data: Data, names: Mapping[tuple[str, str], str]) -> Data:
    """The same document with members called otherwise: ``names`` has the new name by section and old name."""
    out = dict(data)
    for section in dict.fromkeys(section for section, _ in names):
        if isinstance(out.get(section), dict):
            out[section] = {names.get((section, name), name): member for name, member in out[section].items()}
    things = {old: new for (_, old), new in names.items()}
    if isinstance(out.get("relations"), tuple):
        out["relations"] = tuple(_relation(text, things) for text in out["relations"])
    if isinstance(out.get("no_contact"), tuple):
        out["no_contact"] = tuple(tuple(_part(n, things) for n in pair) for pair in out["no_contact"])
    if out.get("viewpoint") in things:
        out["viewpoint"] = things[out["viewpoint"]]
    for section, key in (("objects", "place"), ("cameras", "mount")):
        if isinstance(out.get(section), dict):
            out[section] = {name: _member(member, key, things) for name, member in out[section].items()}
    if isinstance(out.get("allow"), dict):
        out["allow"] = {
            code: {_part(n, things): why for n, why in entry.items()} if isinstance(entry, dict) else entry
            for code, entry in out["allow"].items()
        }
    return out


def without(data: Data, gone: Set[str]) -> Data:
    """The same document without what speaks of things that are gone: relations, a viewpoint, silenced warnings.

    Places and mounts on them stay: what becomes of those is for the caller to say.
    """
    out = dict(data)
    if isinstance(out.get("relations"), tuple):
        out["relations"] = tuple(text for text in out["relations"] if not _about(text, gone))
    if isinstance(out.get("no_contact"), tuple):
        out["no_contact"] = tuple(pair for pair in out["no_contact"] if not {n.split(".")[0] for n in pair} & gone)
    if out.get("viewpoint") in gone:
        del out["viewpoint"]
    if isinstance(out.get("allow"), dict):
        kept = {
            code: {n: why for n, why in entry.items() if n.split(".")[0] not in gone}
            if isinstance(entry, dict)
            else entry
            for code, entry in out["allow"].items()
        }
        out["allow"] = {code: entry for code, entry in kept.items() if entry}
    for key in ("relations", "no_contact", "allow"):
        if key in out and not out[key] and data[key]:
            del out[key]
    return out


def anchors(place: Any) -> set[str]:
    """The things that a place is about."""
    if not isinstance(place, dict):
        return set()
    return {str(place[key]).split(".")[0] for key in ANCHORS if isinstance(place.get(key), str)}


def _call(text: Any) -> Call | None:
    try:
        return parse_call(text) if isinstance(text, str) else None
    except ExpressionError:
        return None


def _relation(text: Any, things: Mapping[str, str]) -> Any:
    call = _call(text)
    if call is None:
        return text
    args = tuple(_part(arg, things) for arg in call.args)
    return str(Call(call.predicate, args)) if args != call.args else text


def _about(text: Any, gone: Set[str]) -> bool:
    call = _call(text)
    return call is not None and any(arg.split(".")[0] in gone for arg in call.args)


def _part(text: str, things: Mapping[str, str]) -> str:
    """``cup`` or ``cabinet.drawer`` with the thing called as it is now."""
    thing, dot, part = text.partition(".")
    return f"{things.get(thing, thing)}{dot}{part}"


def _member(member: Any, key: str, things: Mapping[str, str]) -> Any:
    if not isinstance(member, dict) or key not in member:
        return member
    value = member[key]
    if isinstance(value, dict):
        new: Any = {k: _part(v, things) if k in ANCHORS and isinstance(v, str) else v for k, v in value.items()}
    else:
        new = _part(value, things) if isinstance(value, str) else value
    return member if new == value else {**member, key: new}
