"""Describe changes in terms of the scene: ``cup moved 3.2 cm (+x 3.0, +y 1.1); mass 0.20 → 0.31 kg``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from simfoundry.spec.change.diff.changes import NAMED, Change, Rename, diff, renamed, same
from simfoundry.spec.change.diff.fields import Describing
from simfoundry.spec.models.base import Model

# Maximum width of a line of changes [columns]; if the changes of a member are longer, each one gets its own line.
WIDTH = 100

_RANK = {"objects": 0, "robots": 1, "links": 2, "joints": 3, "goal": 4, "subtasks": 5, "relations": 6}
_LAST = {"cameras": 8, "lights": 9, "materials": 10}

_MARKS = ("moved", "added", "removed", "renamed", "changed")


@dataclass(frozen=True)
class MemberChange:
    """All changes of one member.

    ``section`` and ``name`` identify the member (``name`` is empty for the document itself), and ``was`` is its former
    name. ``marks`` are among moved, added, removed, renamed, and changed. ``verbs`` follow the name directly (``moved 3
    cm``), ``facts`` follow after a colon (``mass 0.20 → 0.31 kg``).
    """

    section: str
    name: str
    was: str
    marks: tuple[str, ...]
    verbs: tuple[str, ...]
    facts: tuple[str, ...]

    @property
    def subject(self) -> str:
        """Return the name of the member in a sentence: ``cup``, ``camera left``."""
        kind = self.section.removesuffix("s")
        name = self.was or self.name
        return name if self.section == "objects" else f"{kind} {name}"

    def lines(self) -> tuple[str, ...]:
        """Return a single line if the changes fit on it, and otherwise one indented line for each change."""
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
    """Describe the changes between the plain data of two documents, member by member.

    ``model`` provides the units of the fields, and ``joint_units`` the units of object joints (by object and joint name
    in ``b``). With ``verbose``, changes of notation without a change of meaning and changes of order are reported as
    well. ``changes`` are the changes from :func:`diff`, if they have already been computed.
    """
    a, b = (side if isinstance(side, dict) else {} for side in (a, b))
    renames = [c for c in (diff(a, b) if changes is None else changes) if isinstance(c, Rename)]
    a = renamed(a, renames)
    words = Describing(a, b, model, joint_units or {}, verbose)
    was = {(*r.section, r.new): r.old for r in renames}
    found: list[tuple[int, MemberChange]] = []
    for section in dict.fromkeys((*b, *a)):
        rank = _RANK.get(section, _LAST.get(section, 7))
        old, new = a.get(section), b.get(section)
        if section in NAMED and isinstance(old or {}, dict) and isinstance(new or {}, dict):
            found += ((rank, e) for e in _members(words, section, old or {}, new or {}, was))
        elif not same(old, new):
            facts = words.field((section,), old, new, section in a, section in b)
            if facts:
                found.append((rank, MemberChange("", "", "", ("changed",), (), tuple(facts))))
    found += ((r, e) for r, e in _other_renames(renames))
    return tuple(entry for _, entry in sorted(found, key=lambda item: item[0]))


def text(entries: Iterable[MemberChange]) -> list[str]:
    """Return the lines of all entries."""
    return [line for entry in entries for line in entry.lines()]


def summary(entries: Iterable[MemberChange]) -> str:
    """Summarize the changes as ``2 moved, 1 removed, goal changed``; the summary is empty if nothing changed."""
    entries = tuple(entries)
    named = [e for e in entries if e.name]
    counts = [(sum(mark in e.marks for e in named), mark) for mark in _MARKS]
    parts = [f"{count} {mark}" for count, mark in counts if count]
    parts += [f"{e.facts[0].partition(' ')[0].rstrip(':')} changed" for e in entries if not e.name]
    return ", ".join(dict.fromkeys(parts))


def _single(sentence: str) -> str:
    """Return a sentence on a single line, even if it quotes multi-line text."""
    return " ".join(sentence.split())


def _members(
    words: Describing, section: str, old: dict[str, Any], new: dict[str, Any], was: Mapping[tuple[str, ...], str]
) -> Iterable[MemberChange]:
    """Yield the changes of each member of a section: members of the old document in order, then added members."""
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


def _other_renames(renames: Iterable[Rename]) -> Iterable[tuple[int, MemberChange]]:
    """Yield renames outside the named sections, such as parts of links or objects that a task refers to."""
    for r in renames:
        if len(r.section) > 1 or r.section[0] not in NAMED:
            kind = r.section[-1].removesuffix("s")
            where = f" of {r.section[-2]}" if len(r.section) > 1 else ""
            fact = f"{kind} {r.old}{where} renamed to {r.new}"
            yield 7, MemberChange("", "", "", ("renamed",), (), (fact,))
