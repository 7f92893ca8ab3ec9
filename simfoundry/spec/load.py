"""Files to checked documents: the text, the types, the names and the files that they refer to."""

from __future__ import annotations

from pathlib import Path

from simfoundry.spec.asset import AssetSpec
from simfoundry.spec.base import Model
from simfoundry.spec.capture import CaptureSpec
from simfoundry.spec.check import check
from simfoundry.spec.diagnostics import Diagnostic, Severity, SpecError, nearest
from simfoundry.spec.loaded import Loaded, project_root
from simfoundry.spec.scene import SceneSpec
from simfoundry.spec.text import Document, YamlError, read
from simfoundry.spec.validate import sound_part, validate

KINDS: dict[str, type[Model]] = {"scene/1": SceneSpec, "asset/1": AssetSpec, "capture/1": CaptureSpec}


def load(path: Path, root: Path | None = None) -> Loaded:
    """Read and check one document; the findings say what is wrong, nothing is raised."""
    root = (root or project_root(path)).resolve()
    try:
        document = read(path)
    except YamlError as error:
        return Loaded(path, root, None, (error.diagnostic(str(path)),))
    model, finding = kind_of(document)
    if model is None:
        assert finding is not None
        return Loaded(path, root, None, (*document.duplicates, finding))
    spec, findings = validate(model, document)
    sound = spec if spec is not None else sound_part(model, document)
    loaded = Loaded(path, root, spec, ())
    findings += check(document, loaded, sound, spec is not None, _load_asset)
    return Loaded(path, root, spec, tuple(findings), loaded.assets)


def load_scene(path: Path) -> Loaded:
    """A scene document without errors; raises :class:`SpecError` with every finding otherwise."""
    return _of_kind(path, SceneSpec, "scene/1")


def load_capture(path: Path) -> Loaded:
    """A capture document without errors; raises :class:`SpecError` with every finding otherwise."""
    return _of_kind(path, CaptureSpec, "capture/1")


def _of_kind(path: Path, model: type[Model], kind: str) -> Loaded:
    loaded = load(path)
    if loaded.errors:
        raise SpecError(loaded.errors)
    if not isinstance(loaded.spec, model):
        message = f"expected a `{kind}` document"
        raise SpecError([Diagnostic("SF006", Severity.ERROR, message, str(path), 1, 1, "simfoundry")])
    return loaded


def _load_asset(path: Path, root: Path) -> Loaded | None:
    """An asset document; None for a document of another kind, which is not read further: it might refer back."""
    try:
        model = kind_of(read(path))[0]
    except YamlError:
        model = None
    return load(path, root) if model in (None, AssetSpec) else None


def kind_of(document: Document) -> tuple[type[Model] | None, Diagnostic | None]:
    """The model of a document by its first key."""
    data = document.data
    if not isinstance(data, dict):
        message, value = "a document is a mapping that starts with `simfoundry: scene/1`", None
    else:
        value = data.get("simfoundry")
        if isinstance(value, str) and value in KINDS:
            return KINDS[value], None
        message = f"`{value}` is not a kind of document" if "simfoundry" in data else "the key `simfoundry` is missing"
    line, column = document.place(("simfoundry",))
    hint = nearest(str(value), KINDS) if value is not None else "start the document with `simfoundry: scene/1`"
    return None, Diagnostic("SF006", Severity.ERROR, message, document.file, line, column, "simfoundry", hint)
