"""Read a compiled stage, including later edits, as a document.

Values that were not edited are returned as they were written in the document. Edited values are taken from the stage.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from simfoundry.backends.usd.source import SCOPES
from simfoundry.frontends.usd.compiled.added_prims import added_prims
from simfoundry.frontends.usd.compiled.edits import MOVED_M, as_name, edited_object, edited_robot, has_moved, pose_data
from simfoundry.frontends.usd.compiled.stage import Edited, StageError, StageMember, StageNote, carrier, document, parts
from simfoundry.frontends.usd.compiled.stage_frame import StageFrame
from simfoundry.frontends.usd.compiled.variants import variant_data
from simfoundry.frontends.usd.compiled.views import edit_gravity, edited_camera, edited_light
from simfoundry.spec.change.diff.changes import Rename
from simfoundry.spec.change.diff.changes import renamed as with_new_names
from simfoundry.spec.models.predicate import ExpressionError, parse_call

if TYPE_CHECKING:
    from pxr import Usd

Data = dict[str, Any]

# Placement keys that refer to other objects.
ANCHORS = ("on", "inside", "left_of", "right_of", "in_front_of", "behind")


def renamed(data: Data, names: Mapping[tuple[str, str], str]) -> Data:
    """Return the document with renamed members. ``names`` maps sections and old names to new names."""
    return dict(with_new_names(data, [Rename((section,), old, new) for (section, old), new in names.items()]))


def without(data: Data, gone: Set[str]) -> Data:
    """Return the document without references to deleted members in relations, the viewpoint, and allowed findings.

    Placements and camera mounts that refer to deleted members remain unchanged; the caller must replace them.
    """

    def remains(name: str) -> bool:
        return name.split(".")[0] not in gone

    out = dict(data)
    if isinstance(out.get("relations"), tuple):
        out["relations"] = tuple(text for text in out["relations"] if all(map(remains, _arguments(text))))
    if isinstance(out.get("no_contact"), tuple):
        out["no_contact"] = tuple(pair for pair in out["no_contact"] if all(map(remains, pair)))
    if out.get("viewpoint") in gone:
        del out["viewpoint"]
    if isinstance(out.get("allow"), dict):
        allow = dict(out["allow"])
        for code in (code for code, entry in allow.items() if isinstance(entry, dict)):
            allow[code] = {name: why for name, why in allow[code].items() if remains(name)}
        out["allow"] = {code: entry for code, entry in allow.items() if entry}
    for key in ("relations", "no_contact", "allow"):
        if key in out and not out[key] and data[key]:
            del out[key]
    return out


def anchors(place: Any) -> set[str]:
    """Return the objects that a placement refers to."""
    if not isinstance(place, dict):
        return set()
    return {str(place[key]).split(".")[0] for key in ANCHORS if isinstance(place.get(key), str)}


def _arguments(text: Any) -> tuple[str, ...]:
    try:
        return parse_call(text).args
    except (ExpressionError, TypeError):
        return ()


@dataclass(frozen=True)
class StageReading:
    """A stage as a document.

    Attributes:
        data: Current content of the stage, complete but without defaults.
        before: Content of the stage as compiled. Deleted members are represented only by their names.
        file: Path of the document within its project.
        renamed: New names of renamed members, by section and old name.
        prims: Prim path of each member, by section and name.
        notes: Notes on stage content that is not represented in ``data``.
    """

    data: Data
    before: Data
    file: str
    renamed: Mapping[tuple[str, str], str]
    prims: Mapping[tuple[str, str], str]
    notes: tuple[StageNote, ...]


def read_spec(stage: Usd.Stage) -> StageReading | None:
    """Return the current document of a stage, or None if the stage was not compiled from a document."""
    if (prim := carrier(stage)) is None:
        return None
    file, written = document(prim)
    if written.get("simfoundry") != "scene/1":
        raise StageError(f"the stage contains a `{written.get('simfoundry')}` document; this version supports scene/1")
    world = StageFrame(stage, prim)
    found = parts(stage, world)
    members, names, copies = identified = _identified(found, written)
    edited = {key: _edited(part) for key, part in members.items()}
    data = renamed(_joined(written, edited, copies), names)
    owners = [(s, n) for s in ("objects", "robots", "cameras") for n in written.get(s, {})]
    # A member without data in the document had its own prim, and was deleted with it.
    gone = {n for s, n in owners if (s, n) not in members and written[s][n] is None}
    data = _placed(without(data, gone - set(names.values())), identified, gone)
    edit_gravity(prim, data, world)
    new = added_prims(stage, prim, {part.path for part in found}, data, world)
    for section, added in new.members.items():
        data[section] = {**data.get(section, {}), **added}
    notes = [note for each in edited.values() for note in each.notes]
    prims = {(s, names.get((s, n), n)): part.path for (s, n), part in members.items()}
    prims |= {(part.section, name): part.path for name, part in copies.items()}
    return StageReading(data, _compiled(written, members), file, names, {**prims, **new.prims}, (*notes, *new.notes))


class Identified(NamedTuple):
    """The members of a stage, matched with the members of the written document.

    Attributes:
        members: Original members, keyed by section and original name.
        names: New names of renamed members, keyed by section and original name.
        copies: Copies of members, keyed by their new names.
    """

    members: dict[tuple[str, str], StageMember]
    names: dict[tuple[str, str], str]
    copies: dict[str, StageMember]


def _identified(found: list[StageMember], written: Data) -> Identified:
    members: dict[tuple[str, str], StageMember] = {}
    for part in sorted(found, key=_identity_rank):
        if written.get(part.section, {}).get(part.name, part) is None:
            members.setdefault((part.section, part.name), part)
    taken = {name for section in written.values() if isinstance(section, dict) for name in section}
    names: dict[tuple[str, str], str] = {}
    copies: dict[str, StageMember] = {}
    for part in found:
        key, name = (part.section, part.name), part.prim.GetName()
        original = members.get(key) is part  # a member from another stage is treated as a copy
        if original and part.name in (name, as_name(name, ())):
            continue
        new = as_name(name, taken)
        taken.add(new)
        if original:
            names[key] = new
        else:
            copies[new] = part
    return Identified(members, names, copies)


def _identity_rank(part: StageMember) -> tuple[bool, bool]:
    """Return a sort key that places members with their original name and scope before their copies."""
    return part.prim.GetName() != part.name, part.prim.GetParent().GetName() != SCOPES[part.section]


def _edited(part: StageMember) -> Edited:
    edit = {"objects": edited_object, "robots": edited_robot, "cameras": edited_camera, "lights": edited_light}
    return edit[part.section](part)


def _compiled(written: Data, members: Mapping[tuple[str, str], StageMember]) -> Data:
    """Return the document as it was compiled, in which deleted members are represented only by their names."""
    filled = _filled(written, {key: part.spec for key, part in members.items()})
    return {key: {n: {} if v is None else v for n, v in section.items()} if isinstance(section, dict) else section
            for key, section in filled.items()}  # fmt: skip


def _filled(written: Data, found: Mapping[tuple[str, str], Data]) -> Data:
    """Return ``written`` with the data of its members filled in. Members that are not in ``found`` remain None."""
    out = dict(written)
    for section, names in written.items():
        if isinstance(names, dict):
            out[section] = {n: found.get((section, n)) if v is None else v for n, v in names.items()}
    return out


def _joined(written: Data, edited: Mapping[tuple[str, str], Edited], copies: dict[str, StageMember]) -> Data:
    """Return the document without deleted members.

    Edited members keep their original order and are followed by the copies.
    """
    out = _filled(written, {key: each.data for key, each in edited.items()})
    for section, members in out.items():
        if isinstance(members, dict):
            out[section] = {n: v for n, v in members.items() if v is not None}
    for name, part in copies.items():
        out[part.section] = {**out.get(part.section, {}), name: _edited(part).data}
    return {key: value for key, value in out.items() if value or not isinstance(written[key], dict) or not written[key]}


def _placed(data: Data, found: Identified, gone: set[str]) -> Data:
    """Return the document with the poses from the stage.

    A placement is kept only if none of its anchors moved; otherwise, it would resolve to a different pose.
    """
    out, (members, names, copies) = dict(data), found
    by_name = {names.get(key, key[1]): part for key, part in members.items() if key[0] == "objects"}
    # Placements relative to these objects would now resolve to different poses.
    changed = {name for name, part in by_name.items() if has_moved(part) or _resized(part, data["objects"][name])}
    rigid = {name for name in changed if not _only_along(by_name[name], data["objects"][name])}
    seen_from = data.get("viewpoint")
    viewer = members.get(("cameras", str(seen_from)))
    shifted = seen_from is not None and ((viewer is not None and has_moved(viewer)) or seen_from in gone)
    objects = dict(out.get("objects", {}))
    for name, item in objects.items():
        if (place := item.get("place")) is None:
            continue
        part = copies.get(name) or by_name.get(name)
        about = anchors(place)
        fresh = name in copies or bool(about & gone) or bool(about & (rigid if "xy" in place else changed))
        if part is not None and (fresh or (shifted and set(place) & {"left_of", "right_of", "in_front_of", "behind"})):
            pose = pose_data(part.X_WP, None, part.X_WP_built)
            objects[name] = {**{k: v for k, v in item.items() if k != "place"}, "pose": pose}
    if objects:
        out["objects"] = objects
    if "cameras" in out:
        out["cameras"] = {n: c for n, c in out["cameras"].items() if str(c.get("mount", "")).split(".")[0] not in gone}
    return out


def _resized(part: StageMember, data: Data) -> bool:
    """Return True if an object's shape or joints changed, except by selecting another variant."""
    old, new = (variant_data(spec, part.variant) for spec in (part.spec, data))
    return any(old.get(key) != new.get(key) for key in ("shape", "scale", "joints"))


def _only_along(part: StageMember, data: Data) -> bool:
    """Return True if an object was only moved horizontally, so that world positions on top of it remain valid."""
    level = abs(float(part.X_WP.p[2] - part.X_WP_built.p[2])) <= MOVED_M
    up = part.X_WP.rotation[:, 2] @ part.X_WP_built.rotation[:, 2]
    return not _resized(part, data) and level and bool(up > 1.0 - 1e-6)
