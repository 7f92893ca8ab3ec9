"""Join a document with the documents that it extends, and write out what it reuses."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simfoundry.spec.compose.join import LISTS, SCENE, SECTIONS, Joining, mark_file, members, relocate
from simfoundry.spec.diagnostics import Diagnostic, Severity, SpecError
from simfoundry.spec.files import FileError, Loaded, reachable, resolved
from simfoundry.spec.models.kinds import model_of, suffix
from simfoundry.spec.yaml.nodes import Node, YamlError
from simfoundry.spec.yaml.text import Document, Path_, Read, read

if TYPE_CHECKING:
    from simfoundry.spec.compose.expand import Reuse

# Maximum number of documents in a chain of `extends`, which limits the work for malicious input.
MAX_BASES = 16


@dataclass(frozen=True)
class Composed:
    """A document joined with the documents that it extends, with everything that it reuses written out.

    Attributes:
        document: The joined document. Each value has the position at which it was written.
        findings: Findings about the composition.
        bases: The files that the document extends, nearest first.
        reuse: What was written out, or None if the document does not reuse anything.
    """

    document: Document
    findings: tuple[Diagnostic, ...] = ()
    bases: tuple[Path, ...] = ()
    reuse: Reuse | None = None


def compose(
    document: Document,
    kind: str,
    root: Path,
    parameters: Mapping[str, float] | None = None,
    reader: Read = read,
) -> Composed:
    """Join a document with the documents that it extends, and write out what it reuses.

    If a base cannot be used, the document is returned unchanged, and a finding states the reason.

    Args:
        document: The document.
        kind: The kind of the document.
        root: Folder of the project, which contains all files that the document uses.
        parameters: Values that replace those of the document's parameters.
        reader: Function that reads the documents that it extends or includes.
    """
    return _composed(document, kind, _Composition(root, reader), parameters or {}, ())


@dataclass(frozen=True)
class _Composition:
    """Settings shared by all documents that are joined: the project's folder and the reader."""

    root: Path
    reader: Read


def _composed(
    document: Document, kind: str, work: _Composition, parameters: Mapping[str, float], including: tuple[Path, ...]
) -> Composed:
    """Compose a document that is included by the given files, outermost first."""
    chained, findings, bases = [document], list[Diagnostic](), list[Path]()
    path = Path(document.file)
    while "extends" in members(chained[-1].root):
        found = _base(chained[-1], path, kind, work, [Path(document.file), *bases])
        if isinstance(found, Diagnostic):
            return Composed(document, (*findings, found), tuple(bases))
        path = Path(found.file)
        bases.append(path)
        chained.append(found)
        findings += found.duplicates
    whole, added, removals = chained[-1].root, dict[Path_, tuple[str, ...]](), dict[Path_, Diagnostic | None]()
    replaced = dict[str, frozenset[str]]()
    reuses = kind == SCENE and (bool(parameters) or any(uses_reuse(each) for each in chained))
    for upper in reversed(chained[:-1]):
        relocate(whole, kind, whole.file or chained[-1].file, upper.file)
        mark_file(upper.root, "" if upper is document else upper.file)
        for key in LISTS:
            if key in members(upper.root):  # replaces the whole list, including the items of scenes included so far
                replaced[key] = frozenset(members(members(whole).get("include")))
        joining = Joining(kind, upper.file, reuses, removals)
        whole = joining.join(whole, upper.root, ())
        findings += joining.findings
        added |= joining.added
    if bases:
        texts = {each.file: each.text for each in chained[1:]}
        document = replace(document, data=whole.value, root=whole, added=added, texts=texts)
    if not reuses:
        return Composed(document, tuple(findings), tuple(bases))
    from simfoundry.spec.compose.expand import expand  # only documents that reuse something need it

    files = (*including, Path(document.file))
    document, faults, reuse = expand(document, removals, replaced, parameters, partial(_included, work, files))
    return Composed(document, (*findings, *faults), tuple(bases), reuse)


def inherited_data(composed: Composed | Loaded, kind: str, root: Path, reader: Read = read) -> dict[str, Any]:
    """Return the data that a document would have without its own entries for inherited or written-out members.

    This is the content of its base, the copies of repeated objects, the members of included scenes, and what templates
    contribute to objects. An edit of the composed document that differs from this data becomes an entry of its own.
    ``reader`` reads the base.
    """
    data: dict[str, Any] = {}
    if composed.bases:
        base = compose(reader(composed.bases[0]), kind, root, reader=reader).document.data
        data = dict(base) if isinstance(base, dict) else {}
    for (section, name), generated in composed.reuse.generated.items() if composed.reuse is not None else ():
        data[section] = {**data.get(section, {}), name: generated.value}
    return data


def _included(
    work: _Composition,
    including: tuple[Path, ...],
    include: Node,
    path: Path_,
    scene: str,
    parameters: Mapping[str, float],
) -> Composed:
    """Return the composed scene of an include; see :data:`simfoundry.spec.compose.expand.ReadScene`.

    Raises:
        SpecError: If the scene cannot be read.
    """
    outer = including[-1]
    at = members(include).get("scene", include)

    def refused(code: str, message: str, hint: str = "") -> SpecError:
        place = (at.file or str(outer), at.line, at.column, ".".join(map(str, path)), hint)
        return SpecError([Diagnostic(code, Severity.ERROR, message, *place)])

    try:
        target = reachable(scene, outer, work.root, (suffix(SCENE), ".yaml"))
    except FileError as wrong:
        raise refused(wrong.code, str(wrong), wrong.hint) from None
    if any(target == resolved(file) for file in including):
        cycle = " includes ".join(f"`{file.name}`" for file in [*including, target])
        raise refused("SF207", f"{cycle}, which is a cycle", "remove one of the includes")
    if len(including) > MAX_BASES:
        raise refused("SF005", f"scenes are included more than {MAX_BASES} levels deep")
    shown = Path(os.path.normpath(outer.parent / scene))
    try:
        document = work.reader(shown if resolved(shown) == target else target)
    except YamlError as error:
        raise SpecError([error.diagnostic(str(shown))]) from None
    kind = members(document.root).get("simfoundry")
    if kind is None or kind.value != SCENE:
        raise refused("SF006", f"`{scene}` is not a `{SCENE}` document", "only scenes can be included")
    composed = _composed(document, SCENE, work, parameters, including)
    mark_file(composed.document.root, str(shown))
    composed = replace(composed, findings=(*composed.findings, *_misused(composed.document)))
    relocate(composed.document.root, SCENE, str(shown), str(outer))
    return replace(composed, findings=(*document.duplicates, *composed.findings))


def _misused(document: Document) -> list[Diagnostic]:
    """Return the type errors of an included scene, except those in the members that are included.

    The scene that includes them reports the latter.
    """
    from simfoundry.spec.check.validate import validate

    included = {*SECTIONS, *LISTS}
    kinds = {key: list if key in LISTS else dict for key in included}
    keys = members(document.root)
    rest = {key: node for key, node in keys.items() if not isinstance(node.children, kinds.get(key, ()))}
    root = document.root.with_members(rest)
    return validate(model_of(SCENE), replace(document, data=root.value, root=root, duplicates=()))[1]


# Keys of a scene that describe reuse; the expanded scene does not need them.
REUSE = ("parameters", "include", "templates")


# A parameter outside a comment, such as the one that names the schema of a document.
_PARAMETER = re.compile(r"^[^#\n]*\$[a-z]", re.MULTILINE)


def uses_reuse(document: Document) -> bool:
    """Return True if a document contains anything to write out."""
    if _PARAMETER.search(document.text):
        return True
    keys = members(document.root)
    return not keys.keys().isdisjoint(REUSE) or any(
        not members(item).keys().isdisjoint(("repeat", "like")) for item in members(keys.get("objects")).values()
    )


def _base(document: Document, path: Path, kind: str, work: _Composition, before: list[Path]) -> Document | Diagnostic:
    """Return the document that ``document`` extends, or a finding that explains why it cannot be used."""
    written = members(document.root)["extends"].value
    place = ("extends",)
    if not isinstance(written, str):
        return document.finding(
            "SF103", place, "expected a string, the path of a document", "write `extends: a.scene.yaml`"
        )
    try:
        target = reachable(written, path, work.root, (suffix(kind), ".yaml"))
    except FileError as wrong:
        return document.finding(wrong.code, place, str(wrong), wrong.hint)
    if any(target == resolved(b) for b in before):
        cycle = " extends ".join(f"`{b.name}`" for b in [*before, target])
        return document.finding("SF207", place, f"{cycle}, which is a cycle", "remove `extends` from one of them")
    if len(before) > MAX_BASES:
        return document.finding("SF005", place, f"the chain of `extends` has more than {MAX_BASES} documents")
    shown = Path(os.path.normpath(path.parent / written))
    try:
        base = work.reader(shown if resolved(shown) == target else target)
    except YamlError as error:
        return error.diagnostic(str(shown))
    found = members(base.root).get("simfoundry")
    if found is None or found.value != kind:
        named = f"a `{found.value}` document" if found is not None else "not a document"
        message = f"`{written}` is {named}, but this is a `{kind}` document"
        return document.finding("SF006", place, message, "a document can only extend a document of the same kind")
    mark_file(base.root, base.file)
    return base
