"""Describe changes in terms of the scene, such as ``cup moved 3.2 cm (+x 3.0, +y 1.1); mass 0.20 → 0.31 kg``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from simfoundry.spec.change.diff.changes import NAMED, Change, Rename, diff, renamed, same
from simfoundry.spec.change.diff.fields import Describing
from simfoundry.spec.change.merge.conflict import ABSENT
from simfoundry.spec.models.base import Model

# Maximum width [columns] of a line that lists all changes to a member; if they do not fit, each gets its own line.
WIDTH = 100

# Sections in the order in which their changes are reported; "" represents all other sections.
_ORDER = (
    *("parameters", "include", "templates", "objects", "robots", "links", "joints", "goal", "subtasks", "relations"),
    *("", "cameras", "lights", "materials"),
)

_MARKS = ("moved", "added", "removed", "renamed", "changed")


@dataclass(frozen=True)
class MemberChange:
    """All changes to one member of a document.

    Attributes:
        section: The section that contains the member.
        name: The name of the member, or an empty string for the document itself.
        was: The old name of a renamed member, or an empty string.
        marks: The kinds of changes: moved, added, removed, renamed, or changed.
        verbs: Phrases that follow the name, such as ``moved 3 cm``.
        facts: Changes to individual fields, such as ``mass 0.20 → 0.31 kg``.
    """

    section: str
    name: str
    was: str
    marks: tuple[str, ...]
    verbs: tuple[str, ...]
    facts: tuple[str, ...]

    @property
    def subject(self) -> str:
        """Return the name of the member as the subject of a sentence, such as ``cup`` or ``camera left``."""
        kind = self.section.removesuffix("s")
        name = self.was or self.name
        return name if self.section == "objects" else f"{kind} {name}"

    def lines(self) -> tuple[str, ...]:
        """Return a single line if all changes fit on it; otherwise, return one indented line per change."""
        facts = [_single(fact) for fact in self.facts]
        if not self.name:
            return ("; ".join(facts),)
        head = _single(self.subject + (f" {', '.join(self.verbs)}" if self.verbs else ":"))
        if not facts:
            return (head,)
        whole = f"{head}{';' if self.verbs else ''} {'; '.join(facts)}"
        return (whole,) if len(whole) <= WIDTH or len(facts) == 1 else (head, *(f"  {fact}" for fact in facts))


def describe(
    a: Any,
    b: Any,
    model: type[Model] | None = None,
    joint_units: Mapping[tuple[str, str], str] | None = None,
    verbose: bool = False,
    changes: Iterable[Change] | None = None,
) -> tuple[MemberChange, ...]:
    """Describe the changes between two documents, member by member.

    Args:
        a: The plain data of the old document.
        b: The plain data of the new document.
        model: The model of the documents, which defines the units of fields.
        joint_units: The units of joint positions, by object and joint name in ``b``.
        verbose: Also report changes that affect only the notation or the order.
        changes: The result of :func:`diff`, if it has already been computed.
    """
    a, b = (side if isinstance(side, dict) else {} for side in (a, b))
    renames = [c for c in (diff(a, b) if changes is None else changes) if isinstance(c, Rename)]
    a = renamed(a, renames)
    words = Describing(a, b, model, joint_units or {}, verbose)
    was = {(*r.section, r.new): r.old for r in renames}
    found: dict[str, list[MemberChange]] = {section: [] for section in _ORDER}
    for section in dict.fromkeys((*b, *a)):
        entries = found[section if section in _ORDER else ""]
        old, new = (side.get(section, ABSENT) for side in (a, b))
        if section in NAMED and not any(isinstance(side, list | tuple | str) for side in (old, new)):
            entries += _members(words, section, a.get(section, {}), b.get(section, {}), was)
        elif not same(old, new) and (facts := words.field((section,), old, new)):
            entries.append(MemberChange("", "", "", ("changed",), (), tuple(facts)))
    found[""] += _other_renames(renames)
    return tuple(entry for entries in found.values() for entry in entries)


def text(entries: Iterable[MemberChange]) -> list[str]:
    """Return the lines that describe all entries."""
    return [line for entry in entries for line in entry.lines()]


def summary(entries: Iterable[MemberChange]) -> str:
    """Summarize changes, as in ``2 moved, 1 removed, goal changed``.

    The summary is empty if nothing changed.
    """
    entries = tuple(entries)
    named = [e for e in entries if e.name]
    counts = [(sum(mark in e.marks for e in named), mark) for mark in _MARKS]
    parts = [f"{count} {mark}" for count, mark in counts if count]
    parts += [f"{e.facts[0].partition(' ')[0].rstrip(':')} changed" for e in entries if not e.name]
    return ", ".join(dict.fromkeys(parts))


def _single(sentence: str) -> str:
    """Return a sentence as a single line, even if it quotes text that spans several lines."""
    return " ".join(sentence.split())


def _members(
    words: Describing, section: str, old: dict[str, Any], new: dict[str, Any], was: Mapping[tuple[str, ...], str]
) -> Iterable[MemberChange]:
    """Yield the changes to each member of a section. Added members come last."""
    for name in dict.fromkeys((*old, *new)):
        before = was.get((section, name), "")
        if name not in new:
            yield MemberChange(section, name, "", ("removed",), ("removed",), ())
        elif name not in old:
            about = words.summary(section, new[name])
            yield MemberChange(section, name, "", ("added",), (f"added: {about}" if about else "added",), ())
        elif before or not same(old[name], new[name]):
            verbs, facts = words.member((section, name), old[name], new[name])
            marks = ["moved"] * bool(verbs.moved) + ["renamed"] * bool(before)
            marks += ["changed"] * bool(not marks or facts)
            sentences = [f"renamed to {name}"] * bool(before) + list(verbs)
            if sentences or facts:
                yield MemberChange(section, name, before, tuple(marks), tuple(sentences), tuple(facts))
    if words.verbose:
        kept = [name for name in old if name in new]
        if kept != [name for name in new if name in old]:
            yield MemberChange("", "", "", ("changed",), (), (f"{section}: reordered",))


def _other_renames(renames: Iterable[Rename]) -> Iterable[MemberChange]:
    """Yield renames outside the named sections, such as renamed parts of links."""
    for r in renames:
        if len(r.section) > 1 or r.section[0] not in NAMED:
            kind = r.section[-1].removesuffix("s")
            where = f" of {r.section[-2]}" if len(r.section) > 1 else ""
            fact = f"{kind} {r.old}{where} renamed to {r.new}"
            yield MemberChange("", "", "", ("renamed",), (), (fact,))
