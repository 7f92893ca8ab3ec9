"""Load compiled stages in place of scene documents, and write their documents for ``simfoundry import``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from simfoundry.errors import OutputError
from simfoundry.frontends.errors import refusing_faults
from simfoundry.frontends.usd.compiled.edits import differs
from simfoundry.frontends.usd.compiled.reading import StageReading, read_spec, renamed
from simfoundry.frontends.usd.compiled.stage import StageError, StageNote, open_stage
from simfoundry.runtime.files import write_atomically
from simfoundry.spec.change.flatten import relocated
from simfoundry.spec.check.validate import validate
from simfoundry.spec.compose.compose import compose, inherited_data
from simfoundry.spec.compose.expand import Reuse
from simfoundry.spec.diagnostics import Diagnostic, Severity, SpecError
from simfoundry.spec.files import Loaded
from simfoundry.spec.load import Known, checked
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.types import RIVALS, models_at
from simfoundry.spec.project import project_root
from simfoundry.spec.yaml.nodes import Node, YamlError
from simfoundry.spec.yaml.text import Document, parse, read
from simfoundry.spec.yaml.tree import YamlTree, read_tree, with_data
from simfoundry.spec.yaml.write import to_yaml, write_tree

KIND = "scene/1"

Data = dict[str, Any]
Path_ = tuple[str, ...]
NOTHING = object()


# A path, and the old and the new value at this path; either is ``NOTHING`` if the value was added or removed.
Edit = tuple[Path_, Any, Any]


def edits(old: Data, new: Data, path: Path_ = ()) -> list[Edit]:
    """Return the edits that turn ``old`` into ``new``.

    Mappings are compared member by member. All other values are compared as a whole.
    """
    found: list[Edit] = []
    for key in dict.fromkeys((*old, *new)):
        a, b = old.get(key, NOTHING), new.get(key, NOTHING)
        if isinstance(a, dict) and isinstance(b, dict) and (a.keys() & b.keys() or len(path) == 0):
            found += edits(a, b, (*path, key))
        elif a is NOTHING or b is NOTHING or a != b:
            found.append(((*path, key), a, b))
    return found


# Lists that follow from the members of a scene: removing a copy also removes its relations.
LISTS = (("relations",), ("no_contact",))


class AppliedEdits(NamedTuple):
    """The edits of a stage, applied to its document.

    Attributes:
        name: Name of the document.
        text: The new text.
        disputed: Paths of values that had also been changed in the document.
        exceptions: Copies of repeated objects and members of included scenes that have an entry of their own now, each
            with the object or include that it comes from.
    """

    name: str
    text: str
    disputed: tuple[str, ...] = ()
    exceptions: tuple[tuple[str, str], ...] = ()


def written_into(path: Path, reading: StageReading) -> AppliedEdits:
    """Apply the edits in a stage to the document at ``path``, without modifying the file.

    An overlay remains an overlay: only the differences are written, with ``null`` for values of its base that were
    removed.

    Raises:
        SpecError: If the document cannot be read.
    """
    try:
        document = read(path)
    except YamlError as error:
        raise SpecError([error.diagnostic(str(path))]) from None
    tree = read_tree(document)
    root = project_root(path).resolve()
    composed = compose(document, KIND, root)
    if composed.findings or not isinstance(tree.value, dict):
        raise SpecError(composed.findings)
    whole = composed.document
    base, name = inherited_data(composed, KIND, root), str(whole.data.get("name"))
    own = {key: new_name for key, new_name in reading.renamed.items() if _at(base, key) is NOTHING}
    todo = edits(renamed(reading.before, own), reading.data)
    if not todo and not own:
        return AppliedEdits(name, document.text)
    if own:
        tree = _with_names(tree, own)
    present = renamed(whole.data, own)
    data, disputed = tree.data, []
    # Lists come last: relations of a copy that was removed are gone already.
    for place, old, new in sorted(todo, key=lambda edit: edit[0] in LISTS):
        if place in LISTS and composed.reuse is not None and _expanded(path, tree, data, root).get(place[0]) == new:
            continue
        there = _at(present, place)
        if there is not NOTHING and there != new and _other(there, old):
            disputed.append(".".join(place))
        data = _applied(data, base, (), place, new)
    text = write_tree(with_data(tree, data), SceneSpec)
    return AppliedEdits(name, text, tuple(disputed), tuple(_exceptions(composed.reuse, tree.data, data)))


def _expanded(path: Path, tree: YamlTree, data: Data, root: Path) -> Data:
    """Return the data of the edited document with everything written out."""
    document = parse(write_tree(with_data(tree, data), SceneSpec), str(path))
    expanded: Data = compose(document, KIND, root).document.data
    return expanded


def _exceptions(reuse: Reuse | None, before: Data, after: Data) -> Iterator[tuple[str, str]]:
    """Yield the generated members that only the edited document has an entry for, each with its source."""
    for section, name in reuse.generated if reuse is not None else ():
        source = reuse.source(section, name) if reuse is not None else None
        if source is not None and name in (after.get(section) or {}) and name not in (before.get(section) or {}):
            yield name, source[1]


def _other(there: Any, old: Any) -> bool:
    """Return True if the value in a document differs from the compiled value."""
    if old is NOTHING:
        return True
    if isinstance(there, dict) and isinstance(old, dict):
        return any(_other(there[key], old.get(key, NOTHING)) for key in there if key in old)
    return differs(there, old)


def _at(data: Any, path: Path_) -> Any:
    for key in path:
        if not isinstance(data, dict) or key not in data:
            return NOTHING
        data = data[key]
    return data


def _applied(data: Data, base: Any, above: Path_, path: Path_, value: Any) -> Data:
    """Return ``data``, which is located at ``above`` in a document, with ``value`` set at the relative ``path``.

    ``base`` is the data that an overlay extends at the same location.
    """
    key, below = path[0], path[1:]
    inherited = base.get(key, NOTHING) if isinstance(base, dict) else NOTHING
    out = dict(data)
    # Keys that exclude `key`; the name of a member excludes no other name.
    rivals = RIVALS.get(key, set()) if models_at(SceneSpec, above) else set()
    if below:
        inside = out.get(key)
        child = _applied(inside if isinstance(inside, dict) else {}, inherited, (*above, key), below, value)
        if child:
            out[key] = child
        else:
            out.pop(key, None)
    elif value is NOTHING:
        out.pop(key, None)
        if inherited is not NOTHING and not any(out.get(rival) is not None for rival in rivals):
            out[key] = None
    else:
        out = {k: v for k, v in out.items() if k not in rivals and (k != key or value != inherited)}
        if value != inherited:
            out[key] = value
    return out


def _with_names(tree: YamlTree, names: Mapping[tuple[str, str], str]) -> YamlTree:
    """Return the tree with its members renamed and their comments preserved."""
    sections = dict(tree.value)
    for section, child in ((section, child) for section, child in sections.items() if isinstance(child.value, dict)):
        value = {names.get((section, name), name): member for name, member in child.value.items()}
        sections[section] = replace(child, value=value)
    tree = replace(tree, value=sections)
    return with_data(tree, renamed(tree.data, names))


def read_stage(path: Path) -> StageReading:
    """Read a stage as a document.

    Raises:
        StageError: If the stage is missing or was not compiled from a document.
    """
    stage = open_stage(path)
    try:
        reading = read_spec(stage)
    except StageError as error:
        raise StageError(error.reason, path) from None
    if reading is None:
        raise StageError("the stage was not compiled from a document; use `simfoundry import` to create one", path)
    return reading


def load_usd(path: Path, known: Known | None = None) -> Loaded:
    """Read and check the scene in a stage, returning errors as findings instead of raising them.

    The file of a finding includes the prim in USD notation, as in ``scene.usda</World/Objects/cup>``. Files that the
    scene refers to are resolved relative to its document; see :func:`home`.
    """
    try:
        reading = read_stage(path)
    except StageError as error:
        finding = Diagnostic("SF001", Severity.ERROR, error.reason, str(path))
        return Loaded(path, project_root(path), None, (finding,))
    place = home(path, reading.file)
    loaded = Loaded(place, project_root(place).resolve(), None, (), stage_document(path, reading))
    loaded = checked(loaded, KIND, {} if known is None else known)
    return replace(loaded, findings=(*loaded.findings, *_findings(path, reading)))


def _findings(path: Path, reading: StageReading) -> Iterator[Diagnostic]:
    """Yield a finding for each note on a stage."""
    for note in reading.notes:
        about = next((key for key, prim in reading.prims.items() if f"{note.prim}/".startswith(f"{prim}/")), ())
        file = f"{path}<{note.prim}>"
        yield Diagnostic("SF421", Severity.WARNING, note.message, file, path=".".join(about), hint=note.hint)


def home(stage: Path, file: str) -> Path:
    """Find the document from which a stage was compiled.

    ``file`` is resolved relative to each parent folder of the stage and then to the current folder. If no such document
    exists, the result is a path in the stage's folder. In this case, the document's assets are probably missing as
    well.
    """
    folders = [*stage.absolute().parents, Path.cwd()]
    places = [folder / name for folder in folders for name in dict.fromkeys((file, Path(file).name))]
    found = next((p for p in places if file and p.is_file()), None)
    return found or stage.absolute().parent / (Path(file).name or stage.name)


def stage_document(path: Path, reading: StageReading) -> Document:
    """Return a stage's document.

    Findings about a member refer to its prim, and all other findings refer to the file as a whole.
    """
    files: dict[tuple[Any, ...], str] = {key: f"{path}<{prim}>" for key, prim in reading.prims.items()}
    return Document(str(path), "", reading.data, _node(reading.data, (), str(path), files), ())


def _node(data: Any, at: tuple[Any, ...], file: str, files: Mapping[tuple[Any, ...], str]) -> Node:
    file = files.get(at, file)
    if isinstance(data, dict):
        children = {key: _node(value, (*at, key), file, files) for key, value in data.items()}
        return Node(data, 0, 0, children, dict.fromkeys(data, (0, 0)), file=file)
    if isinstance(data, tuple):
        return Node(data, 0, 0, [_node(value, (*at, k), file, files) for k, value in enumerate(data)], file=file)
    return Node(data, 0, 0, file=file)


@dataclass(frozen=True)
class Imported:
    """The text of an imported document, with ``notes`` on stage content that the document does not include.

    ``disputed`` contains the paths of values in the document that differed from both the compiled and the edited stage.
    The values of the edited stage were used for them. ``exceptions`` contains the copies of repeated objects, and the
    members of included scenes, that have an entry of their own now, each with the object or include it comes from.
    """

    text: str
    notes: tuple[StageNote, ...] = ()
    disputed: tuple[str, ...] = ()
    exceptions: tuple[tuple[str, str], ...] = ()


def import_usd(path: Path, original: Path | None = None, into: Path | None = None) -> Imported:
    """Return the document of a compiled stage.

    For a stage without edits, this is equal to the compiled document.

    Args:
        path: Compiled stage.
        original: Document to which the edits are applied, so that comments are preserved and an overlay remains an
            overlay. By default, the result is a standalone document in canonical form.
        into: Folder for a standalone document; references are made relative to this folder.

    Raises:
        StageError: If the file is not a compiled stage or does not match ``original``.
        SpecError: If a document cannot be read.
    """
    reading = read_stage(path)
    spec, findings = validate(SceneSpec, stage_document(path, reading))
    if spec is None:
        raise SpecError(findings)
    if original is None:
        folder = home(path, reading.file).parent
        data = relocated({k: v for k, v in reading.data.items() if k != "extends"}, SceneSpec, folder, into or folder)
        return Imported(to_yaml(SceneSpec.model_validate(data)), reading.notes)
    name, text, disputed, exceptions = written_into(original, reading)
    if name != reading.data["name"]:
        raise StageError(f"{path} was compiled from `{reading.data['name']}`, but {original} is `{name}`")
    return Imported(text, reading.notes, disputed, exceptions)


def import_stage(path: Path, out: Path, onto: Path | None = None, force: bool = False) -> Imported:
    """Write the document of the compiled stage at ``path`` to ``out``.

    The edits are applied to the document ``onto`` or, unless ``force`` is set, to ``out`` if it exists. Otherwise, a
    new document is written.

    Raises:
        OutputError: If a document with relative references would be written to a different folder.
    """
    original = onto or (out if out.exists() and not force else None)
    if original is not None and original.absolute().parent != out.absolute().parent:
        raise OutputError(f"{out.name} must be in the same folder as {original}, because its references are relative")
    with refusing_faults(path):
        imported = import_usd(path, original, out.parent)
    if original is None or not out.exists() or out.read_text(encoding="utf-8") != imported.text:
        write_atomically(out, imported.text.encode())
    return imported
