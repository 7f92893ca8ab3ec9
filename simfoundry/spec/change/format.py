"""Format documents canonically; meaning and comments are preserved, and each value has one notation."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, replace
from pathlib import Path

from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.load import kind_of
from simfoundry.spec.models.base import Model
from simfoundry.spec.models.kinds import model_of
from simfoundry.spec.project import project_root
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import Document, parse, read
from simfoundry.spec.yaml.tree import KIND, YamlTree, read_tree
from simfoundry.spec.yaml.write import write_tree

_MODELINE = re.compile(r"#\s*yaml-language-server:\s*\$schema=(\S+)\s*\Z")


@dataclass(frozen=True)
class Formatted:
    """Text before and after formatting."""

    before: str
    after: str

    @property
    def changed(self) -> bool:
        """Return True if the text was not in canonical form."""
        return self.before != self.after


def format_text(text: str, file: str = "<text>", schema: str | None = None) -> str:
    """Return the canonical form of a document; raises :class:`SpecError` if the text cannot be read.

    If ``schema`` (a relative path or a URL) is given, the first line names it for editors; otherwise an existing schema
    line is kept.
    """
    try:
        document = parse(text, file)
    except YamlError as error:
        raise SpecError([error.diagnostic(file)]) from None
    return _formatted(document, _model(document), schema)


def format_file(path: Path) -> Formatted:
    """Format a document without writing it. Raises :class:`SpecError` if it cannot be read.

    If ``schemas/`` or ``.simfoundry/schemas/`` in a parent folder within the project contains the schema of the
    document's kind, the first line names that schema for editors. A line that names another schema is kept if that
    schema exists or is a URL.
    """
    try:
        document = read(path)
    except YamlError as error:
        raise SpecError([error.diagnostic(str(path))]) from None
    model = _model(document)
    return Formatted(document.text, _formatted(document, model, schema_line(path, document)))


def schema_line(path: Path, document: Document, root: Path | None = None) -> str | None:
    """Return the path of the schema that the first line should name; None if the line can stay as it is.

    The search goes up to ``root``, by default the root of the document's project.
    """
    tree = YamlTree(None, tuple(_top_comments(document.text)))
    named = next((m[1] for m in map(_MODELINE.match, tree.above) if m), None)
    folder = path.resolve().parent
    if named is not None and ("://" in named or (folder / named).is_file()):
        return None
    kind = str(document.data[KIND]).partition("/")[0]
    root = project_root(path) if root is None else root
    for above in (folder, *folder.parents):
        for schemas in (above / "schemas", above / ".simfoundry" / "schemas"):
            if (schemas / f"{kind}.schema.json").is_file():
                return Path(os.path.relpath(schemas / f"{kind}.schema.json", folder)).as_posix()
        if above == root:
            break
    return None


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
    lines = [c for c in tree.above if _MODELINE.match(c)]
    others = [c for c in tree.above if not _MODELINE.match(c)]
    if schema is not None:
        lines = [f"# yaml-language-server: $schema={schema}", *lines[1:]]
    return write_tree(replace(tree, above=(*lines, *others)), model)
