"""Update references between members of a document after renames and deletions."""

from __future__ import annotations

from collections.abc import Mapping, Set
from typing import Any

from simfoundry.spec.change.diff.changes import Rename
from simfoundry.spec.change.diff.changes import renamed as with_new_names
from simfoundry.spec.models.predicate import Call, ExpressionError, parse_call

Data = dict[str, Any]

ANCHORS = ("on", "inside", "left_of", "right_of", "in_front_of", "behind")
"""Keys of a placement that name other objects."""


def renamed(data: Data, names: Mapping[tuple[str, str], str]) -> Data:
    """Return the document with renamed members; ``names`` contains new names by section and old name."""
    renames = [Rename((section,), old, new) for (section, old), new in names.items()]
    out: Data = with_new_names(data, renames)
    return out


def without(data: Data, gone: Set[str]) -> Data:
    """Return the document without references to deleted members in relations, viewpoint, and silenced warnings.

    Placements and mounts on them remain; the caller must replace them.
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
    """Return the objects that a placement refers to."""
    if not isinstance(place, dict):
        return set()
    return {str(place[key]).split(".")[0] for key in ANCHORS if isinstance(place.get(key), str)}


def _call(text: Any) -> Call | None:
    try:
        return parse_call(text) if isinstance(text, str) else None
    except ExpressionError:
        return None


def _about(text: Any, gone: Set[str]) -> bool:
    call = _call(text)
    return call is not None and any(arg.split(".")[0] in gone for arg in call.args)
