"""Load documents: read the text, join it with its bases, and check types, names, and files."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from simfoundry.spec.check.allow import sift
from simfoundry.spec.check.documents import check
from simfoundry.spec.check.validate import sound_part, validate
from simfoundry.spec.diagnostics import Diagnostic, Severity, SpecError, nearest
from simfoundry.spec.loaded import Loaded
from simfoundry.spec.models.kinds import KINDS, model_of
from simfoundry.spec.project import project_root
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import Document, parse, read

Known = dict[tuple[str, str], Loaded | None]
"""Documents read so far, by resolved path and requested kind, so that each is read only once."""

_OTHER_FORMATS = dict.fromkeys(
    (".usda", ".usdc", ".usd", ".usdz"), "simfoundry.frontends.usd.compiled.loading:load_usd"
)
"""Functions that read documents from files other than YAML, by suffix.

They belong to a higher layer, so they are listed by name and imported on first use.
"""


def load(path: Path, root: Path | None = None, known: Known | None = None, text: str | None = None) -> Loaded:
    """Read and check one document; errors are returned as findings, not raised.

    Documents that it uses are looked up in ``known`` and added to it. If ``text`` is given, it is checked as if it were
    the content of the file. A USD file is read as the scene that it was compiled from.
    """
    known = {} if known is None else known
    if text is None and path.suffix.lower() in _OTHER_FORMATS:
        module, _, function = _OTHER_FORMATS[path.suffix.lower()].partition(":")
        other: Loaded = getattr(import_module(module), function)(path, known)
        return other
    root = (root or project_root(path)).resolve()
    try:
        document = read(path) if text is None else parse(text, str(path))
    except YamlError as error:
        return Loaded(path, root, None, (error.diagnostic(str(path)),))
    kind, finding = kind_of(document)
    if kind is None:
        assert finding is not None
        return Loaded(path, root, None, (*document.duplicates, finding), document)
    findings, bases = list[Diagnostic](), list[Path]()
    if isinstance(document.root.children, dict) and "extends" in document.root.children:
        from simfoundry.spec.compose import compose

        document, findings, bases = compose(document, kind, root)
    if any(d.code not in ("SF003", "SF201") for d in findings):  # a base is missing, and with it most of the content
        return Loaded(path, root, None, tuple(findings), document, tuple(bases))
    return checked(Loaded(path, root, None, tuple(findings), document, tuple(bases)), kind, known)


def checked(read: Loaded, kind: str, known: Known) -> Loaded:
    """Check the types, names, and files of a document that was read and joined."""
    path, root, document, bases, findings = read.path, read.root, read.document, read.bases, list(read.findings)
    assert document is not None
    model = model_of(kind)
    spec, wrong = validate(model, document)
    sound = spec if spec is not None else sound_part(model, document)
    loaded = Loaded(path, root, None if findings else spec, (), document, bases)

    def use(target: Path, kinds: tuple[str, ...]) -> Loaded | None:
        return _use(target, kinds, root, known)

    findings += [*wrong, *check(loaded, sound, spec is not None, use)]
    kept, silenced = sift(findings, spec.allow if spec is not None else {})
    return Loaded(path, root, loaded.spec, tuple(kept), document, bases, loaded.uses, tuple(silenced))


def load_scene(path: Path) -> Loaded:
    """Load a scene; raises :class:`SpecError` with all findings if it has errors."""
    return load_kind(path, "scene/1")


def load_capture(path: Path) -> Loaded:
    """Load a capture; raises :class:`SpecError` with all findings if it has errors."""
    return load_kind(path, "capture/1")


def load_kind(path: Path, *kinds: str) -> Loaded:
    """Load a document of one of the kinds; raises :class:`SpecError` with all findings if it has errors."""
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
    """Load a document that another uses; None for other kinds, which are not read further to avoid cycles."""
    key = (str(path.resolve()), kinds[0])
    if key not in known:
        try:
            kind = kind_of(read(path))[0]
        except YamlError:
            kind = None
        known[key] = load(path, root, known) if kind is None or kind in kinds else None
    return known[key]


def kind_of(document: Document) -> tuple[str | None, Diagnostic | None]:
    """Return the kind that the first key of a document names, or a finding."""
    data = document.data
    if not isinstance(data, dict):
        message, value = "a document is a mapping that starts with `simfoundry: scene/1`", None
    else:
        value = data.get("simfoundry")
        if isinstance(value, str) and value in KINDS:
            return value, None
        message = f"`{value}` is not a kind of document" if "simfoundry" in data else "the key `simfoundry` is missing"
    hint = nearest(str(value), KINDS) if value is not None else "start the document with `simfoundry: scene/1`"
    return None, document.finding("SF006", ("simfoundry",), message, hint)
