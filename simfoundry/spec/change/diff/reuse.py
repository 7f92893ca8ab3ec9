"""Describe changes in terms of what documents reuse, such as ``cup: 4 × 3 → 4 × 4, 4 more``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from simfoundry.spec.change.diff.words import MemberChange, describe
from simfoundry.spec.compose.copies import Group
from simfoundry.spec.compose.expand import Reuse
from simfoundry.spec.compose.join import LISTS
from simfoundry.spec.models.reuse import RepeatSpec
from simfoundry.spec.models.scene import SceneSpec

# Keys whose changes are described as they are written.
_WRITTEN = ("parameters", "include", "templates")


def with_reuse(
    entries: tuple[MemberChange, ...], old: Reuse | None, new: Reuse | None, verbose: bool = False
) -> tuple[MemberChange, ...]:
    """Return the changes with those of copies combined, and with the changes of parameters, templates and includes.

    Args:
        entries: The changes between the documents in which everything is written out.
        old: What the old document reuses.
        new: What the new document reuses.
        verbose: Also report changes that affect only the notation.
    """
    groups_before, groups_after = (side.groups if side is not None else {} for side in (old, new))
    rest = [kept for entry in entries if (kept := _without_step(entry, groups_before, groups_after)) is not None]
    if old is None or new is None:  # one document is written out, which is not a change by itself
        return tuple(_with_groups(rest, groups_before, groups_after))
    before, after = ({k: v for k, v in _written(side).items() if k in _WRITTEN} for side in (old, new))
    written = describe(before, after, SceneSpec, verbose=verbose)
    if not {"include"} & {*_written(old), *_written(new)}:  # otherwise, the lists also contain those of other files
        before, after = ({k: v for k, v in _written(side).items() if k in LISTS} for side in (old, new))
        lists = describe(before, after, SceneSpec, verbose=verbose)
        rest = [e for e in rest if e.name or not e.facts or not e.facts[0].startswith(LISTS)]
    else:
        lists = ()
    includes = {*_written(old).get("include", {}), *_written(new).get("include", {})}
    rest = [e for e in rest if e.section != "frames" or e.name not in includes]
    rest, templates = _without_inherited(rest, written, new)
    return (*templates, *_with_groups(rest, groups_before, groups_after), *lists)


def _without_step(entry: MemberChange, old: Mapping[str, Group], new: Mapping[str, Group]) -> MemberChange | None:
    """Return a change without the motion of a copy that follows from a new step, or None if nothing remains."""
    name = _group_of(entry, old, new)
    if name is None or name not in old or name not in new or old[name].repeat.steps == new[name].repeat.steps:
        return entry
    verbs = tuple(verb for verb in entry.verbs if not verb.startswith("moved "))
    if verbs == entry.verbs:
        return entry
    return replace(entry, verbs=verbs, marks=("changed",)) if verbs or entry.facts else None


def _written(reuse: Reuse | None) -> Mapping[str, Any]:
    return reuse.written if reuse is not None and isinstance(reuse.written, dict) else {}


def _without_inherited(
    entries: list[MemberChange], written: tuple[MemberChange, ...], new: Reuse
) -> tuple[list[MemberChange], list[MemberChange]]:
    """Return the changes without those that objects take over from a template, and the changes that say so."""
    users: dict[str, list[str]] = {}
    facts = {e.name: {*e.facts, *e.verbs} for e in written if e.section == "templates"}
    kept = []
    objects = _written(new).get("objects", {})
    for entry in entries:
        group = next((n for n, g in new.groups.items() if g.has(entry.name)), entry.name)
        item = objects.get(group, {}) if isinstance(objects, dict) else {}
        like = item.get("like") if isinstance(item, dict) else None
        if entry.section == "objects" and like in facts and {*entry.facts, *entry.verbs} <= facts[like]:
            users.setdefault(like, [])
            users[like] += [group] * (group not in users[like])
        else:
            kept.append(entry)
    return kept, [_with_users(entry, users.get(entry.name, [])) for entry in written]


def _with_users(entry: MemberChange, names: list[str]) -> MemberChange:
    """Return the change of a template with the objects that it applies to."""
    if not names or not entry.facts:
        return entry
    return replace(entry, facts=(*entry.facts[:-1], f"{entry.facts[-1]}{_users(names)}"))


def _users(names: list[str]) -> str:
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return f" (of {', '.join(names[:3])}{more})"


def _with_groups(
    entries: Iterable[MemberChange], old: Mapping[str, Group], new: Mapping[str, Group]
) -> list[MemberChange]:
    """Return the changes with those of the copies of an object combined."""
    of_group: dict[str, list[MemberChange]] = {}
    out: list[MemberChange | str] = []
    for entry in entries:
        name = _group_of(entry, old, new)
        if name is None:
            out.append(entry)
            continue
        if name not in of_group:
            out.append(name)
        of_group.setdefault(name, []).append(entry)
    kept = [name for name in old if name in new and name not in of_group and old[name].root == name]
    out += [name for name in kept if old[name].repeat != new[name].repeat]
    combined: list[MemberChange] = []
    for item in out:
        if isinstance(item, str):
            combined += _combined(item, of_group.get(item, []), old.get(item), new.get(item))
        else:
            combined.append(item)
    return combined


def _group_of(entry: MemberChange, old: Mapping[str, Group], new: Mapping[str, Group]) -> str | None:
    """Return the repeated object that a changed object is a copy of, or None."""
    if entry.section != "objects":
        return None
    sides = (old, new) if "removed" not in entry.marks else (old,)
    return next((name for side in reversed(sides) for name, group in side.items() if group.has(entry.name)), None)


def _combined(name: str, entries: list[MemberChange], old: Group | None, new: Group | None) -> list[MemberChange]:
    """Return the changes to the copies of one object."""
    out, rest = list[MemberChange](), list[MemberChange]()
    counted = [e for e in entries if e.marks in (("added",), ("removed",))]
    if old is not None and new is not None and old.repeat != new.repeat and new.root == name:
        facts = tuple(_repeat_facts(old, new))
        marks = ("changed",) if facts else ()
        out.append(MemberChange("objects", name, "", marks, (), facts))
        rest = [e for e in entries if e not in counted]
    elif old is not None and new is not None and old.repeat != new.repeat:
        rest = [e for e in entries if e not in counted]  # the object repeats with another one, which is described
    elif counted and (group := new or old) is not None and len(counted) == len(group.copies):
        verb = counted[0].verbs[0].partition(":")[0]
        out.append(MemberChange("objects", name, "", counted[0].marks, (f"{verb}: {len(counted)} copies",), ()))
        rest = [e for e in entries if e not in counted]
    else:
        rest = entries
    if len(rest) < 2:
        return out + rest
    alike: dict[tuple[Any, ...], list[MemberChange]] = {}
    for entry in rest:
        moved = "moved" in entry.marks and not entry.facts
        others = tuple(verb for verb in entry.verbs if not verb.startswith("renamed to "))
        key = (entry.marks, "moved") if moved else (entry.marks, others, entry.facts)
        alike.setdefault(key, []).append(entry)
    total = len(new.copies) if new is not None else len(rest)
    for same in alike.values():
        out += [_of_copies(name, same, total)] if len(same) > 2 else same
    return out


def _of_copies(name: str, entries: list[MemberChange], total: int) -> MemberChange:
    """Return one change for several copies that changed alike."""
    first = entries[0]
    count = f"{len(entries)} copies" if len(entries) == total else f"{len(entries)} of {total} copies"
    if first.was:
        verbs = (f"renamed to {name}", *(verb for verb in first.verbs if not verb.startswith("renamed to ")))
        return replace(first, name=name, was=f"{first.was.rstrip('_0123456789')} ({count})", verbs=verbs)
    verbs = first.verbs if all(entry.verbs == first.verbs for entry in entries) else ("moved",)
    return replace(first, name=f"{name} ({count})", verbs=verbs)


def _repeat_facts(old: Group, new: Group) -> Iterable[str]:
    a, b = old.repeat, new.repeat
    if (a.counts, a.stack) != (b.counts, b.stack):
        more = len(new.copies) - len(old.copies)
        change = f", {abs(more)} {'more' if more > 0 else 'fewer'}" if more else ""
        yield f"{_size(a)} → {_size(b)}{change}"
    if a.steps != b.steps and a.counts and b.counts:
        yield f"step {_step(a)} → {_step(b)} m"


def _size(repeat: RepeatSpec) -> str:
    parts = [str(count) for count in repeat.counts] + ([f"stack of {repeat.stack}"] if repeat.stack else [])
    return " × ".join(parts)


def _step(repeat: RepeatSpec) -> str:
    step = repeat.step
    if not isinstance(step, tuple):
        return f"{step:g}"
    return f"[{', '.join(f'{v:g}' if isinstance(v, int | float) else str(list(v)) for v in step)}]"
