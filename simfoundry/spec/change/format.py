"""Format documents canonically and migrate older documents, keeping comments."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from simfoundry.spec.diagnostics import SpecError, nearest
from simfoundry.spec.editor.strict import EDITOR
from simfoundry.spec.load import kind_of
from simfoundry.spec.models.base import Model
from simfoundry.spec.models.kinds import KINDS, model_of
from simfoundry.spec.models.types import former_paths
from simfoundry.spec.project import project_root
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import Document, parse, read
from simfoundry.spec.yaml.tree import KIND, YamlTree, read_tree
from simfoundry.spec.yaml.write import write_tree

_MODELINE = re.compile(r"#\s*yaml-language-server:\s*\$schema=(\S+)\s*\Z")


@dataclass(frozen=True)
class Formatted:
    """The text of a document before and after formatting."""

    before: str
    after: str

    @property
    def changed(self) -> bool:
        """Return True if the text was not in canonical form."""
        return self.before != self.after


def format_text(text: str, file: str = "<text>", schema: str | None = None) -> str:
    """Return the canonical form of a document.

    If ``schema`` (a relative path or a URL) is specified, the first line of the result points editors to this schema.
    Otherwise, an existing schema line is kept.

    Raises:
        SpecError: If the text could not be parsed.
    """
    document = _parsed(file, text)
    return _formatted(document, _model(document), schema)


def format_file(path: Path) -> Formatted:
    """Format a document without writing the result.

    If a parent folder within the project contains the schema for the document's kind in ``schemas/`` or
    ``.simfoundry/schemas/``, the first line of the result points editors to that schema. An existing reference to a
    different schema is kept if that schema exists or is a URL.

    Raises:
        SpecError: If the document could not be read.
    """
    document = _parsed(str(path))
    return Formatted(document.text, _formatted_at(path, document))


def format_open_text(text: str, path: Path) -> str:
    """Return the canonical form of a text that an editor shows in place of a file; see :func:`format_file`.

    Raises:
        SpecError: If the text could not be parsed.
    """
    return _formatted_at(path, _parsed(str(path), text))


def _formatted_at(path: Path, document: Document) -> str:
    model = _model(document)
    return _formatted(document, model, schema_line(path, document))


def schema_line(path: Path, document: Document, root: Path | None = None) -> str | None:
    """Return the schema path to write in the first line, or None if the line does not need to change.

    This function looks for schemas in the document's folder and in its parents up to ``root``, by default the root of
    the document's project.
    """
    named = next((m[1] for m in map(_MODELINE.match, _top_comments(document.text)) if m), None)
    folder = path.resolve().parent
    if named is not None and ("://" in named or (folder / named.partition("#")[0]).is_file()):
        return None
    kind = str(document.data[KIND]).partition("/")[0]
    root = project_root(path) if root is None else root
    for above in (folder, *folder.parents):
        for schemas in (above / "schemas", above / ".simfoundry" / "schemas"):
            if (schemas / f"{kind}.schema.json").is_file():
                return schema_reference(schemas / f"{kind}.schema.json", folder)
        if above == root:
            break
    return None


def schema_reference(schema: Path, folder: Path) -> str:
    """Return the reference from a document in ``folder`` to the part of a schema file that is written for editors.

    Schema files of other versions or origin, which do not have this part, are referred to as a whole.
    """
    relative = Path(os.path.relpath(schema, folder)).as_posix()
    has_part = f'"{EDITOR}": {{'.encode() in schema.read_bytes()
    return f"{relative}#/$defs/{EDITOR}" if has_part else relative


def _top_comments(text: str) -> list[str]:
    """Return the comments at the top of the text."""
    top = re.match(r"\ufeff?(?:[ \t]*(?:#.*)?(?:\r\n|\r|\n|\Z))*", text)
    return [line.strip() for line in top[0].removeprefix("\ufeff").splitlines() if line.strip()] if top else []


def _model(document: Document) -> type[Model]:
    kind, finding = kind_of(document)
    if kind is None or document.duplicates:
        raise SpecError([*document.duplicates, *([finding] if finding is not None else [])])
    return model_of(kind)


def _formatted(document: Document, model: type[Model], schema: str | None) -> str:
    tree = read_tree(document)
    lines = sorted(tree.above, key=lambda comment: not _MODELINE.match(comment))  # stable sort
    if schema is not None:
        kept = lines[1:] if lines and _MODELINE.match(lines[0]) else lines
        lines = [f"# yaml-language-server: $schema={schema}", *kept]
    return write_tree(replace(tree, above=tuple(lines)), model)


@dataclass(frozen=True)
class Migration:
    """A migration step. ``change`` converts a document from an older version to version ``to``."""

    to: str
    change: Callable[[YamlTree], YamlTree]


# Migration for each older kind and version, such as ``scene/1``.
#
# All kinds are still at version 1, so no migrations exist yet. Add a migration for each change that alters the meaning
# of older files. A renamed key does not need a migration, because its field records the old key (``FormerKey``).
STEPS: Mapping[str, Migration] = {}

# Characters that the parser treats as line breaks.
_LINE_BREAK = re.compile("\r\n|[\n\r\x85\u2028\u2029]")


def migrated(text: str, file: str, steps: Mapping[str, Migration] = STEPS) -> str:
    """Return the text of a document in the latest version of its kind, with current key names.

    If the text is already up to date, it is returned unchanged. If the version changes, the result is in canonical
    form.

    Raises:
        SpecError: If the kind is unknown.
    """
    document = _parsed(file, text)
    kind = _kind(document, steps)
    if kind in steps:
        tree, seen = read_tree(document), [kind]
        while kind in steps:
            step = steps[kind]
            changed = step.change(tree)
            tree = replace(changed, value={**changed.value, KIND: replace(changed.value[KIND], value=step.to)})
            kind = step.to
            if kind in seen:
                raise ValueError(f"the steps from {seen[0]} lead back to {kind}")
            seen.append(kind)
        document = _parsed(file, write_tree(tree, model_of(kind)))
    return _with_present_keys(document, kind)


def _parsed(file: str, text: str | None = None) -> Document:
    """Parse the given text, or the contents of the file if no text is passed."""
    try:
        return read(Path(file)) if text is None else parse(text, file)
    except YamlError as error:
        raise SpecError([error.diagnostic(file)]) from None


def _kind(document: Document, steps: Mapping[str, Migration]) -> str:
    """Return the kind and version of a document.

    Raises:
        SpecError: If no such version ever existed.
    """
    data = document.data
    kind = data.get(KIND) if isinstance(data, dict) else None
    if isinstance(kind, str) and (kind in KINDS or kind in steps):
        return kind
    versions = [*steps, *KINDS]
    message = f"`{kind}` is not a known document kind" if kind is not None else f"the `{KIND}` key is missing"
    hint = nearest(str(kind), versions) if kind is not None else "start the document with `simfoundry: scene/1`"
    raise SpecError([*document.duplicates, document.finding("SF006", (KIND,), message, hint)])


def _with_present_keys(document: Document, kind: str) -> str:
    """Rename old keys in the text without making any other changes."""
    text = document.text
    starts = [0, *(found.end() for found in _LINE_BREAK.finditer(text))]
    edits: dict[int, tuple[str, str]] = {}
    for path, name in former_paths(model_of(kind), document.data):
        line, column = document.place(path, of_key=True)
        edits[starts[line - 1] + column - 1] = (str(path[-1]), name)
    for start, (old, new) in sorted(edits.items(), reverse=True):
        start += text[start] in "\"'"
        if text.startswith(old, start):
            text = f"{text[:start]}{new}{text[start + len(old) :]}"
    return text
