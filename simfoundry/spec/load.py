"""Load documents: read the text, join it with its bases, and check types, names, and files."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path, PurePosixPath

from simfoundry.spec.check.documents import check, sift
from simfoundry.spec.check.validate import sound_part, validate
from simfoundry.spec.diagnostics import Diagnostic, Severity, SpecError, nearest
from simfoundry.spec.files import FileError, Loaded, reachable
from simfoundry.spec.models.kinds import KINDS, model_of, suffix
from simfoundry.spec.project import project_root
from simfoundry.spec.yaml.nodes import Node, YamlError
from simfoundry.spec.yaml.text import Document, Path_, parse, read

# Documents read so far, keyed by resolved path and requested kind, so that each is read only once.
Known = dict[tuple[str, str], Loaded | None]

# Suffixes of USD files, which are read by a module in a higher layer that is imported on first use.
_USD = (".usda", ".usdc", ".usd", ".usdz")


def load(path: Path, root: Path | None = None, known: Known | None = None, text: str | None = None) -> Loaded:
    """Read and check one document. Errors are returned as findings instead of being raised.

    Documents that this document uses are looked up in ``known`` and added to it. If ``text`` is given, it is used
    instead of the content of the file. A USD file is read as the scene from which it was compiled.
    """
    known = {} if known is None else known
    if text is None and path.suffix.lower() in _USD:
        compiled: Loaded = import_module("simfoundry.frontends.usd.compiled.loading").load_usd(path, known)
        return compiled
    root = (root or project_root(path)).resolve()
    try:
        document = read(path) if text is None else parse(text, str(path))
    except YamlError as error:
        return Loaded(path, root, None, (error.diagnostic(str(path)),))
    kind, finding = kind_of(document)
    if kind is None:
        assert finding is not None
        return Loaded(path, root, None, (*document.duplicates, finding), document)
    document, findings, bases = compose(document, kind, root)
    read_in_full = Loaded(path, root, None, tuple(findings), document, tuple(bases))
    if any(d.code not in ("SF003", "SF201") for d in findings):  # a base is missing, and so is most of the content
        return read_in_full
    return checked(read_in_full, kind, known)


def checked(read: Loaded, kind: str, known: Known) -> Loaded:
    """Check the types, names, and files of a document that has already been read and joined with its bases."""
    assert read.document is not None
    model = model_of(kind)
    spec, wrong = validate(model, read.document)
    sound = spec if spec is not None else sound_part(model, read.document)
    loaded = replace(read, spec=None if read.findings else spec)
    found = check(loaded, sound, spec is not None, lambda target, kinds: _use(target, kinds, read.root, known))
    kept, silenced = sift([*read.findings, *wrong, *found], spec.allow if spec is not None else {})
    return replace(loaded, findings=tuple(kept), silenced=tuple(silenced))


def load_scene(path: Path) -> Loaded:
    """Load a scene.

    Raises:
        SpecError: If the scene has errors; the exception contains every finding.
    """
    return load_kind(path, "scene/1")


def load_capture(path: Path) -> Loaded:
    """Load a capture.

    Raises:
        SpecError: If the capture has errors; the exception contains every finding.
    """
    return load_kind(path, "capture/1")


def load_kind(path: Path, *kinds: str) -> Loaded:
    """Load a document of one of the kinds.

    Raises:
        SpecError: If the document has errors; the exception contains every finding.
    """
    loaded = load(path)
    if loaded.errors:
        raise SpecError(loaded.errors)
    if not isinstance(loaded.spec, tuple(model_of(kind) for kind in kinds)):
        message = f"expected a {' or '.join(f'`{kind}`' for kind in kinds)} document"
        scene = getattr(loaded.spec, "scene", None)
        hint = f"its scene is `{scene}`" if isinstance(scene, str) and "scene/1" in kinds else ""
        raise SpecError([Diagnostic("SF006", Severity.ERROR, message, str(path), 1, 1, "simfoundry", hint)])
    return loaded


def _use(path: Path, kinds: tuple[str, ...], root: Path, known: Known) -> Loaded | None:
    """Load a document that another document uses.

    To avoid cycles, returns None if the kind of the document is not in ``kinds``.
    """
    key = (str(path.resolve()), kinds[0])
    if key not in known:
        try:
            kind = kind_of(read(path))[0]
        except YamlError:
            kind = None
        known[key] = load(path, root, known) if kind is None or kind in kinds else None
    return known[key]


def kind_of(document: Document) -> tuple[str | None, Diagnostic | None]:
    """Return the kind specified by the first key of a document, or a finding if the kind is invalid."""
    data = document.data
    value = data.get("simfoundry") if isinstance(data, dict) else None
    if value in KINDS:
        return str(value), None
    if not isinstance(data, dict):
        message = "a document must be a mapping that starts with `simfoundry: scene/1`"
    elif "simfoundry" in data:
        message = f"`{value}` is not a known document kind"
    else:
        message = "the `simfoundry` key is missing"
    hint = nearest(str(value), KINDS) if value is not None else "start the document with `simfoundry: scene/1`"
    return None, document.finding("SF006", ("simfoundry",), message, hint)


# Maximum number of documents in a chain of `extends`, which limits the work for malicious input.
MAX_BASES = 16


def compose(document: Document, kind: str, root: Path) -> tuple[Document, list[Diagnostic], list[Path]]:
    """Join a document with the documents that it extends.

    If a base cannot be used, the document is returned unchanged, and a finding states the reason.

    Returns:
        The joined document, the findings, and the files that the document extends, nearest first.
    """
    chained, findings, bases = [document], list[Diagnostic](), list[Path]()
    path = Path(document.file)
    while "extends" in _keys(chained[-1].root):
        found = _base(chained[-1], path, kind, root, [Path(document.file), *bases])
        if isinstance(found, Diagnostic):
            return document, [*findings, found], bases
        path = Path(found.file)
        bases.append(path)
        chained.append(found)
        findings += found.duplicates
    if not bases:
        return document, findings, bases
    whole, added = chained[-1].root, dict[Path_, tuple[str, ...]]()
    for upper in reversed(chained[:-1]):
        _take_over(whole, kind, whole.file or chained[-1].file, upper.file)
        _own(upper.root, "" if upper is document else upper.file)
        joining = _Joining(kind, upper.file)
        whole = joining.join(whole, upper.root, ())
        findings += joining.findings
        added |= joining.added
    return replace(document, data=whole.value, root=whole, added=added), findings, bases


def _keys(node: Node) -> dict[str, Node]:
    return node.children if isinstance(node.children, dict) else {}


def _base(document: Document, path: Path, kind: str, root: Path, before: list[Path]) -> Document | Diagnostic:
    """Return the document that ``document`` extends, or a finding that explains why it cannot be used."""
    written = _keys(document.root)["extends"].value
    place = ("extends",)
    if not isinstance(written, str):
        return document.finding(
            "SF103", place, "expected a string, the path of a document", "write `extends: a.scene.yaml`"
        )
    try:
        target = reachable(written, path, root, (suffix(kind), ".yaml"))
    except FileError as wrong:
        return document.finding(wrong.code, place, str(wrong), wrong.hint)
    if any(target == b.resolve() for b in before):
        cycle = " extends ".join(f"`{b.name}`" for b in [*before, target])
        return document.finding("SF207", place, f"{cycle}, which is a cycle", "remove `extends` from one of them")
    if len(before) > MAX_BASES:
        return document.finding("SF005", place, f"the chain of `extends` has more than {MAX_BASES} documents")
    shown = Path(os.path.normpath(path.parent / written))
    try:
        base = read(shown if shown.resolve() == target else target)
    except YamlError as error:
        return error.diagnostic(str(shown))
    found = _keys(base.root).get("simfoundry")
    if found is None or found.value != kind:
        named = f"a `{found.value}` document" if found is not None else "not a document"
        message = f"`{written}` is {named}, but this is a `{kind}` document"
        return document.finding("SF006", place, message, "a document can only extend a document of the same kind")
    _own(base.root, base.file)
    return base


def _own(node: Node, file: str) -> None:
    """Mark every value with its source file."""
    todo = [node]
    while todo:
        node = todo.pop()
        if node.file != file or not node.children:  # otherwise it is an alias that was already marked
            node.file = file
            todo += node.members


@dataclass
class _Joining:
    """The state needed while joining a document with its base. ``file`` is the document's path."""

    kind: str
    file: str
    findings: list[Diagnostic] = field(default_factory=list)
    added: dict[Path_, tuple[str, ...]] = field(default_factory=dict)

    def join(self, base: Node, over: Node, path: tuple[str, ...]) -> Node:
        """Return ``base`` overridden by ``over``: mappings are merged by key, and null removes a key."""
        if not isinstance(base.children, dict) or not isinstance(over.children, dict):
            return over
        children, keys = dict(base.children), dict(base.keys)
        for key, node in over.children.items():
            if node.value is None:
                if key not in children:
                    self.nothing_to_remove(over.keys[key], (*path, key), base.children)
                children.pop(key, None)
                continue
            for rival in self.rivals(key, path, children):
                if rival not in over.children:
                    del children[rival]
            if key not in base.children:
                self.added[*path, key] = tuple(base.children)
            children[key] = self.join(children[key], node, (*path, key)) if key in children else node
            keys[key] = over.keys[key]
        value = {key: child.value for key, child in children.items()}
        weight = 1 + sum(child.weight for child in children.values())
        places = {key: keys[key] for key in children}
        return Node(value, over.line, over.column, children, places, "", weight, over.file)

    def rivals(self, key: str, path: tuple[str, ...], children: dict[str, Node]) -> list[str]:
        """Return the keys that ``key`` replaces. The result is empty for named mappings."""
        from simfoundry.spec.models.types import RIVALS, is_mapping, models_at

        rivals = sorted(RIVALS.get(key, set()) & children.keys())
        models = [m for m in models_at(model_of(self.kind), path) if key in m.model_fields] if rivals else []
        return rivals if any(not is_mapping(m, key) for m in models) else []

    def nothing_to_remove(self, place: tuple[int, int], path: tuple[str, ...], there: Iterable[str]) -> None:
        message = f"the extended document does not contain `{path[-1]}`, so it cannot be removed"
        similar = nearest(path[-1], there)
        hint = similar if similar.startswith("did you mean") else "remove the line"
        self.findings.append(Diagnostic("SF201", Severity.ERROR, message, self.file, *place, ".".join(path), hint))


def _take_over(node: Node, kind: str, from_file: str, to_file: str) -> None:
    """Rewrite the file references in a base to be relative to the folder of the document that extends the base."""
    here, there = Path(from_file).parent.resolve(), Path(to_file).parent.resolve()
    if here == there:
        return
    from simfoundry.spec.models.types import file_patterns

    step = PurePosixPath(Path(os.path.relpath(here, there)).as_posix())
    for pattern in file_patterns(model_of(kind)):
        if pattern != ("extends",):
            for leaf in _leaves(node, pattern):
                if isinstance(leaf.value, str) and ":" not in leaf.value and not leaf.value.startswith("/"):
                    leaf.value = os.path.normpath(step / leaf.value)
    _refresh(node)


def _leaves(node: Node, pattern: tuple[str, ...]) -> Iterator[Node]:
    if not pattern:
        yield node
        return
    children = node.children
    named = [children[pattern[0]]] if isinstance(children, dict) and pattern[0] in children else []
    for child in node.members if pattern[0] == "*" else named:
        yield from _leaves(child, pattern[1:])


def _refresh(node: Node) -> None:
    """Recompute the values of collections from their members."""
    for child in node.members:
        _refresh(child)
    if isinstance(node.children, dict):
        node.value = {key: child.value for key, child in node.children.items()}
    elif isinstance(node.children, list):
        node.value = tuple(child.value for child in node.children)
