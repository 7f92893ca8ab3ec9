"""Compare two states of a document, as data and as text, and collect the errors in each state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from simfoundry.spec.change.diff.changes import Change, diff
from simfoundry.spec.change.diff.words import MemberChange, describe, summary, text
from simfoundry.spec.change.flatten import relocated
from simfoundry.spec.check.validate import sound_part
from simfoundry.spec.diagnostics import Diagnostic, Severity
from simfoundry.spec.files import FileError, Loaded
from simfoundry.spec.load import kind_of, load
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.base import DocumentSpec
from simfoundry.spec.models.kinds import model_of
from simfoundry.spec.models.scene import Place, SceneSpec
from simfoundry.spec.yaml.write import to_data


@dataclass(frozen=True)
class Side:
    """One of two compared states of a document.

    Attributes:
        label: The display name, such as ``HEAD~1:desk.scene.yaml``.
        loaded: The document as it was loaded.
        spec: The valid part of the document, or None if no part is valid.
        text: The content of the file.
        findings: The errors in the document.
    """

    label: str
    loaded: Loaded
    spec: DocumentSpec | None
    text: str
    findings: tuple[Diagnostic, ...]

    @cached_property
    def data(self) -> dict[str, Any]:
        """Return the document as plain data without defaults."""
        return to_data(self.spec) if self.spec is not None else {}


@dataclass(frozen=True)
class DocumentComparison:
    """A comparison of two states of a document.

    ``old`` or ``new`` is None if the document did not exist in that state.
    """

    name: str
    old: Side | None
    new: Side | None
    changes: tuple[Change, ...]
    entries: tuple[MemberChange, ...]
    obstacle: str = ""
    """The reason the two states cannot be compared, or an empty string if they can be compared."""
    was: str = ""
    """The former path of a renamed document, or an empty string."""

    @property
    def differs(self) -> bool:
        """Return True unless the two states are equal or differ only in formatting."""
        return bool(self.changes or self.entries or self.obstacle or self.old is None or self.new is None)

    @property
    def identical(self) -> bool:
        """Return True if the document and everything that it refers to are the same, including the formatting."""
        texts = (self.old and self.old.text, self.new and self.new.text)
        return not self.differs and not self.was and texts[0] == texts[1]

    @property
    def findings(self) -> tuple[Diagnostic, ...]:
        """Return the errors on both sides."""
        return tuple(d for side in (self.old, self.new) if side is not None for d in side.findings)

    @property
    def along(self) -> tuple[str, ...]:
        """Return the objects that moved only because their `place` refers to another object that moved."""
        if self.new is None or not isinstance(self.new.spec, SceneSpec):
            return ()
        named = {e.name for e in self.entries if e.section == "objects"}
        gone = {e.name for e in self.entries if e.section == "objects" and "moved" in e.marks}
        places = {name: item.place for name, item in self.new.spec.objects.items() if item.place is not None}
        while found := {name for name, place in places.items() if name not in gone and gone & _anchors(place)}:
            gone |= found
        return tuple(name for name in places if name in gone - named)

    def lines(self) -> list[str]:
        """Return one line for each change, followed by a summary line."""
        if self.obstacle:
            return [f"cannot be compared: {self.obstacle}"]
        if self.old is None or self.new is None:
            return [f"{'added' if self.old is None else 'removed'}: {contents(self.new or self.old)}"]
        if self.entries:
            along = self.along
            object_of = "object that its place refers" if len(along) == 1 else "objects that their places refer"
            lines = [f"{', '.join(along)} moved along with the {object_of} to"] if along else []
            return [*text(self.entries), *lines, summary(self.entries)]
        if self.changes:
            return ["equivalent, reordered"]
        return ["equivalent, written differently" if self.old.text != self.new.text else "no difference"]


def _anchors(place: Place) -> set[str]:
    """Return the names of the objects that determine the horizontal position of a place."""
    if place.xy is not None:
        return set()
    beside = {n for n in (place.left_of, place.right_of, place.in_front_of, place.behind) if n is not None}
    return beside or {(place.on or place.inside or "").partition(".")[0]}


def side(path: Path, label: str, root: Path | None = None) -> Side:
    """Read one state of a document from a file.

    Findings refer to the file by the display name ``label``.
    """
    loaded = load(path, root)
    spec = loaded.spec or _sound(loaded)
    text_ = path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
    errors = tuple(_named(d, loaded, label) for d in loaded.all_findings() if d.severity is Severity.ERROR)
    return Side(label, loaded, spec, text_, errors)


def compare(
    name: str, old: Side | None, new: Side | None, verbose: bool = False, files: bool = True
) -> DocumentComparison:
    """Compare two states of a document.

    The files that both states refer to are also compared, unless ``files`` is False.
    """
    unsound = [s.label for s in (old, new) if s is not None and s.spec is None]
    if unsound:
        return DocumentComparison(name, old, new, (), (), f"no part of {' or '.join(unsound)} is valid")
    if old is None or new is None or old.spec is None or new.spec is None:
        return DocumentComparison(name, old, new, (), ())
    if type(old.spec) is not type(new.spec):
        kinds = f"from `{old.data['simfoundry']}` to `{new.data['simfoundry']}`"
        return DocumentComparison(name, old, new, (), (), f"the kind changed {kinds}")
    before = old.data
    if old.loaded.root == new.loaded.root:  # make file references relative to the same folder
        before = relocated(before, type(old.spec), old.loaded.path.parent, new.loaded.path.parent)
    changes = diff(before, new.data)
    entries = describe(before, new.data, type(new.spec), _joint_units(new), verbose, changes)
    if old.loaded.reuse is not None or new.loaded.reuse is not None:
        from simfoundry.spec.change.diff.reuse import with_reuse  # only documents that reuse something

        entries = with_reuse(entries, old.loaded.reuse, new.loaded.reuse, verbose)
    if files:
        entries += (*_changed_files(old, new, verbose), *_changed_source(old, new, verbose))
    return DocumentComparison(name, old, new, changes, entries)


def _sound(loaded: Loaded) -> DocumentSpec | None:
    """Return the valid part of a document that has errors, or None if a document it extends is missing."""
    document = loaded.document
    if document is None or not isinstance(document.data, dict):
        return None
    kind, _ = kind_of(document)
    if kind is None or ("extends" in document.data and not loaded.bases):
        return None
    return sound_part(model_of(kind), document)


def _named(d: Diagnostic, loaded: Loaded, label: str) -> Diagnostic:
    """Return a copy of the finding that refers to its file by the display name."""
    if d.file == str(loaded.path):
        return replace(d, file=label)
    revision, colon, _ = label.rpartition(":")
    file = Path(d.file).resolve()
    if colon and file.is_relative_to(loaded.root):
        return replace(d, file=f"{revision}:{file.relative_to(loaded.root).as_posix()}")
    return d


def contents(side: Side | None) -> str:
    """Summarize a document in one line, as in ``7 objects (desk, cereal, …), 1 camera (view)``."""
    parts = []
    for section, members in (side.data if side is not None else {}).items():
        if isinstance(members, dict) and members and all(isinstance(m, dict) for m in members.values()):
            names = list(members)
            few = ", ".join(names[:4]) + (", …" if len(names) > 4 else "")
            parts.append(f"{len(names)} {section.removesuffix('s') if len(names) == 1 else section} ({few})")
    return ", ".join(parts) or "no named members"


def _joint_units(side: Side) -> Mapping[tuple[str, str], str]:
    """Return the unit of each joint position in a scene, by object and joint name."""
    if not isinstance(side.spec, SceneSpec):
        return {}
    found: dict[tuple[str, str], str] = {}
    for name, item in side.spec.objects.items():
        used = side.loaded.used(item.asset) if item.asset is not None else None
        if used is not None and isinstance(used.spec, AssetSpec):
            found |= {(name, j): "m" if s.type == "prismatic" else "rad" for j, s in used.spec.single_joints.items()}
    return found


def _changed_files(old: Side, new: Side, verbose: bool) -> list[MemberChange]:
    """Return an entry for each object whose file has the same name in both states but different content."""
    if not isinstance(old.spec, SceneSpec) or not isinstance(new.spec, SceneSpec):
        return []
    entries = []
    for name in (name for name in new.spec.objects if name in old.spec.objects):
        before, item = old.spec.objects[name], new.spec.objects[name]
        for was, reference in ((before.asset, item.asset), (before.visual, item.visual)):
            fact = _file_change(old.loaded, new.loaded, reference, verbose) if reference and was == reference else ""
            if fact:
                entries.append(MemberChange("objects", name, "", ("changed",), (), (fact,)))
    return entries


def _changed_source(old: Side, new: Side, verbose: bool) -> list[MemberChange]:
    """Return an entry for a task's scene, or a recipe's twin, that has the same name but different content."""
    key = {"task/1": "scene", "cousins/1": "twin"}.get(new.data["simfoundry"])
    was, reference = (getattr(side.spec, key) if key is not None else "" for side in (old, new))
    fact = _file_change(old.loaded, new.loaded, reference, verbose) if reference and was == reference else ""
    return [MemberChange("", "", "", ("changed",), (), (f"{key} {fact}",))] if fact else []


def _file_change(old: Loaded, new: Loaded, reference: str, verbose: bool) -> str:
    """Summarize the changes to a file that both sides refer to, or return an empty string if it is unchanged."""
    before, after = old.used(reference), new.used(reference)
    if before is None or after is None:
        return f"{reference} is a different file" if _bytes(old, reference) != _bytes(new, reference) else ""
    if before.spec is None or after.spec is None:
        return ""
    old_side, new_side = (Side(reference, loaded, loaded.spec, "", ()) for loaded in (before, after))
    entries = compare(reference, old_side, new_side, verbose).entries
    return f"{reference} changed ({summary(entries)})" if entries else ""


def _bytes(loaded: Loaded, reference: str) -> bytes:
    try:
        return loaded.file(reference).read_bytes()
    except (OSError, ValueError, FileError):
        return b""
