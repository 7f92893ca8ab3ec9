"""Load documents: read the text, join it with its bases, and check types, names, and files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TypeVar

from simfoundry.spec.check.documents import check, sift
from simfoundry.spec.check.validate import sound_part, validate
from simfoundry.spec.compose.compose import REUSE, compose
from simfoundry.spec.diagnostics import Diagnostic, Severity, SpecError, nearest, similar_fixes
from simfoundry.spec.files import Loaded, resolved
from simfoundry.spec.models.base import DocumentSpec
from simfoundry.spec.models.kinds import KINDS, model_of
from simfoundry.spec.project import project_root
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import Document, Mark, Read, parse, read

# Documents read so far, keyed by resolved path and requested kind, so that each is read only once.
Known = dict[tuple[str, str], Loaded | None]

# Suffixes of USD files, which are read by a module in a higher layer that is imported on first use.
_USD = (".usda", ".usdc", ".usd", ".usdz")


def load(
    path: Path,
    root: Path | None = None,
    known: Known | None = None,
    text: str | None = None,
    parameters: Mapping[str, float] | None = None,
    reader: Read = read,
) -> Loaded:
    """Read and check one document. Errors are returned as findings instead of being raised.

    Documents that this document uses are looked up in ``known`` and added to it. If ``text`` is given, it is used
    instead of the content of the file. All other documents are read with ``reader``. A USD file is read as the scene
    from which it was compiled.
    """
    known = {} if known is None else known
    if text is None and path.suffix.lower() in _USD:
        compiled: Loaded = import_module("simfoundry.frontends.usd.compiled.loading").load_usd(path, known)
        return compiled
    root = resolved(root or project_root(path))
    try:
        document = reader(path) if text is None else parse(text, str(path))
    except YamlError as error:
        return Loaded(path, root, None, (error.diagnostic(str(path)),))
    kind, finding = kind_of(document)
    if kind is None:
        assert finding is not None
        return Loaded(path, root, None, (*document.duplicates, finding), document, source=document)
    composed = compose(document, kind, root, parameters, reader)
    findings = composed.findings
    read_in_full = Loaded(
        path, root, None, findings, composed.document, composed.bases, reuse=composed.reuse, source=document
    )
    if composed.reuse is None and any(d.code not in ("SF003", "SF201") for d in findings):
        completed = tuple(map(composed.document.completed, findings))
        return replace(read_in_full, findings=completed)  # a base is missing, and so is most of the content
    return checked(read_in_full, kind, known, reader)


def checked(joined: Loaded, kind: str, known: Known, reader: Read = read) -> Loaded:
    """Check the types, names, and files of a document that has already been read and joined with its bases."""
    assert joined.document is not None
    model = model_of(kind)
    spec, wrong = validate(model, joined.document)
    sound = spec if spec is not None else sound_part(model, joined.document)
    if joined.reuse is not None:
        from simfoundry.spec.compose.findings import Causes  # only documents that reuse something

        spec, sound = _expanded(spec), _expanded(sound)
        causes = Causes(joined.findings, joined.document.data, joined.reuse)
        wrong = causes.unrelated(wrong)
    loaded = replace(joined, spec=None if joined.findings else spec)

    def use(target: Path, kinds: tuple[str, ...]) -> Loaded | None:
        return _use(target, kinds, joined.root, known, reader)

    found = check(loaded, sound, spec is not None, use)
    complete = joined.document.completed
    findings = [*map(complete, joined.findings), *wrong, *found]
    if joined.reuse is not None:
        from simfoundry.spec.compose.findings import collapsed, with_sources

        findings = [*map(complete, causes.findings), *wrong, *causes.unrelated(found)]
        findings = collapsed(with_sources(findings, joined.reuse), joined.reuse)
    kept, silenced = sift(findings, spec.allow if spec is not None else {})
    return replace(loaded, findings=tuple(kept), silenced=tuple(silenced))


M = TypeVar("M", bound=DocumentSpec)


def _expanded(spec: M | None) -> M | None:
    """Return a scene without the keys that describe what has been written out."""
    if spec is None:
        return None
    update: dict[str, dict[str, object]] = {key: {} for key in REUSE}
    plain = spec.model_copy(update=update)
    plain.model_fields_set.difference_update(REUSE)
    return plain


def load_scene(path: Path, parameters: Mapping[str, float] | None = None) -> Loaded:
    """Load a scene. ``parameters`` replace the values of its parameters.

    Raises:
        SpecError: If the scene has errors; the exception contains every finding.
    """
    return load_kind(path, "scene/1", parameters=parameters)


def load_capture(path: Path) -> Loaded:
    """Load a capture.

    Raises:
        SpecError: If the capture has errors; the exception contains every finding.
    """
    return load_kind(path, "capture/1")


def load_kind(path: Path, *kinds: str, parameters: Mapping[str, float] | None = None) -> Loaded:
    """Load a document of one of the kinds.

    Raises:
        SpecError: If the document has errors; the exception contains every finding.
    """
    loaded = load(path, parameters=parameters)
    if loaded.errors:
        raise SpecError(loaded.errors)
    if not isinstance(loaded.spec, tuple(model_of(kind) for kind in kinds)):
        message = f"expected a {' or '.join(f'`{kind}`' for kind in kinds)} document"
        scene = getattr(loaded.spec, "scene", None)
        hint = f"its scene is `{scene}`" if isinstance(scene, str) and "scene/1" in kinds else ""
        raise SpecError([Diagnostic("SF006", Severity.ERROR, message, str(path), 1, 1, "simfoundry", hint)])
    return loaded


def _use(path: Path, kinds: tuple[str, ...], root: Path, known: Known, reader: Read) -> Loaded | None:
    """Load a document that another document uses.

    To avoid cycles, returns None if the kind of the document is not in ``kinds``.
    """
    key = (str(resolved(path)), kinds[0])
    if key not in known:
        try:
            kind = kind_of(reader(path))[0]
        except YamlError:
            kind = None
        known[key] = load(path, root, known, reader=reader) if kind is None or kind in kinds else None
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
        shown = f"`{value}`" if isinstance(value, str | int | float) else "this value"
        message = f"{shown} is not a known document kind"
    else:
        message = "the `simfoundry` key is missing"
    hint = nearest(str(value), KINDS) if value is not None else "start the document with `simfoundry: scene/1`"
    fixes = similar_fixes(str(value), KINDS) if value is not None else ()
    return None, document.finding("SF006", ("simfoundry",), message, hint, mark=Mark(fixes=fixes))
