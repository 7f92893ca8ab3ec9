"""Documents that can be edited in place and saved with their comments and layout."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from copy import copy
from pathlib import Path
from typing import Any, ClassVar, Self, get_args

from pydantic import TypeAdapter, ValidationError

from simfoundry.api.entries import DataPath, DocumentEntry, FixedField, UnknownNameError, to_plain
from simfoundry.errors import SimfoundryError
from simfoundry.spec.change.diff.changes import Rename, renamed, same
from simfoundry.spec.change.edit_data import is_member, with_value
from simfoundry.spec.change.edit_text import edit_text
from simfoundry.spec.change.flatten import own_data
from simfoundry.spec.change.merge.conflict import ABSENT
from simfoundry.spec.compose.compose import inherited_data
from simfoundry.spec.diagnostics import Diagnostic, Severity, SpecError, nearest
from simfoundry.spec.files import Loaded
from simfoundry.spec.load import load, load_kind
from simfoundry.spec.models.base import Conflict, DocumentSpec, Model
from simfoundry.spec.models.predicate import ExpressionError, parse_call, texts
from simfoundry.spec.models.types import field_adapter, field_type, file_patterns, models_at
from simfoundry.spec.yaml.write import to_data, to_yaml


class EditableDocument(DocumentEntry):
    """A document that is edited in place. Nothing is written to disk until :meth:`save` is called.

    All methods that read the document (``check``, ``lower``, ``save``) use the edited text. Findings refer to lines in
    that text, and the comments and layout around each edit are preserved.
    """

    _model: ClassVar[type[DocumentSpec]]
    _kind: ClassVar[str]

    simfoundry = FixedField[str]()
    extends = FixedField[str | None]()
    conflicts = FixedField[Mapping[str, Conflict]]()

    def __init__(self, loaded: Loaded) -> None:
        assert isinstance(loaded.spec, self._model)
        super().__init__(self, ())
        self._set_loaded(loaded)
        self._imported_from: Path | None = None
        self._mesh_folder: Path | None = None
        self._original = self  # a copy of an imported document uses files that exist as long as the original

    def __copy__(self) -> Self:
        """Return an independent document with the same edits."""
        copied = object.__new__(type(self))
        vars(copied).update(vars(self), _document=copied)
        return copied

    def __deepcopy__(self, _memo: object) -> Self:
        return copy(self)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Load a document.

        Raises:
            SpecError: If the document has errors; the exception contains every finding.
        """
        return cls(load_kind(Path(path), cls._kind))

    @property
    def path(self) -> Path:
        """The path of the document's file."""
        return self._file

    @property
    def text(self) -> str:
        """The text of the document with all edits applied."""
        if same(self._data, self._before):
            return self._source
        from simfoundry.spec.yaml.text import parse

        written, before, base = parse(self._source).data, self._before, self._base
        for rename in self._renames:  # they apply to everything as it is written, such as the place of repeated objects
            written, before, base = (renamed(side, [rename]) for side in (written, before, base))
        own = own_data(written, before, self._data, base)
        return edit_text(self._source, own, self._model)

    @property
    def changes(self) -> list[str]:
        """Descriptions of the edits made since the document was loaded or saved, such as ``mug mass 0.31 → 0.3 kg``."""
        from simfoundry.spec.change.diff.words import describe, text

        return text(describe(self._before, self._data, self._model))

    def check(self, *, lints: bool = True) -> list[Diagnostic]:
        """Check the edited document and return all findings. If ``lints`` is False, only its structure is checked."""
        from simfoundry.lint.lints import lint

        loaded = self._load()
        return [*loaded.all_findings(), *(lint(loaded) if lints else ())]

    def save(self, path: str | Path | None = None) -> Path:
        """Write the document, preserving the comments and layout around the edits.

        Args:
            path: File to write; defaults to the original file.

        Returns:
            The path of the file that was written.

        Raises:
            SpecError: If the edited document has errors. In this case, nothing is written.
            OutputError: If the mesh folder of an imported document would replace files that SimFoundry did not write.
        """
        from simfoundry.runtime.files import write_in_place

        target = Path(path) if path is not None else self.path
        if path is None and self._imported_from is not None:
            raise SimfoundryError(
                f"this document was imported from {self._imported_from}; save it elsewhere: `save('a.scene.yaml')`"
            )
        if target.suffix.lower() not in (".yaml", ".yml"):
            raise SimfoundryError(f"{target} is not a YAML file; specify one, such as `save('desk.scene.yaml')`")
        text = self.text
        with self._copied_files(target):
            loaded = load(target, text=text)
            if loaded.errors:
                raise SpecError(loaded.errors)
            write_in_place(target, text.encode())
        self._set_loaded(loaded)
        self._imported_from = None
        return target

    def mark_imported(self, source: Path, mesh_folder: Path | None = None) -> None:
        """Record the source file of an imported document and the mesh folder to copy when the document is saved."""
        self._imported_from, self._mesh_folder = source, mesh_folder

    @contextmanager
    def _copied_files(self, target: Path) -> Iterator[None]:
        """Copy the mesh folder of an imported document to the folder of ``target``. Undo this if the block fails."""
        from simfoundry.runtime.files import copied_folder

        moved = target.parent.resolve() != self.path.parent.resolve() and any(self._files())
        if moved and self._mesh_folder is None:
            raise SimfoundryError(
                f"{target} cannot be written: the document refers to files relative to {self.path.parent.resolve()}; "
                "save it in that folder"
            )
        source = self._mesh_folder
        if not moved or source is None or not source.is_dir():
            yield
            return
        with copied_folder(source, target.parent / source.name, f"{target.stem}.files.json"):
            yield

    def __repr__(self) -> str:
        edited = ", edited" if self._data != self._before else ""
        return f"<{type(self).__name__} {self._data.get('name')} of {self.path}{edited}>"

    def _set_loaded(self, loaded: Loaded) -> None:
        """Make a loaded document the current state, without edits."""
        assert loaded.spec is not None and loaded.document is not None
        text = loaded.document.text
        self._file, self._loaded = loaded.path, loaded
        self._source = text or to_yaml(loaded.spec)  # a document loaded from a USD stage has no YAML text
        # All values that the text states, including defaults, joined with the documents that it extends.
        self._before: dict[str, Any] = loaded.document.data if text else to_data(loaded.spec)
        self._renames: tuple[Rename, ...] = ()
        self._data = self._before  # edits replace the mappings that contain them and leave others as they are
        self._base = inherited_data(loaded, self._kind, loaded.root)

    def _load(self) -> Loaded:
        """Return the edited document, including any findings."""
        return self._loaded if same(self._data, self._before) else load(self.path, text=self.text)

    def _checked(self) -> Loaded:
        """Return the edited document.

        Raises:
            SpecError: If the document has errors.
        """
        loaded = self._load()
        if loaded.errors:
            raise SpecError(loaded.errors)
        return loaded

    def _files(self) -> list[str]:
        """Return the file paths in the document that are relative to its folder."""
        found = (value for pattern in file_patterns(self._model) for value in _values(self._data, pattern))
        return [value for value in found if isinstance(value, str) and ":" not in value and not value.startswith("/")]

    # -- access by entries ------------------------------------------------------------------------------------------

    def _get(self, path: DataPath) -> Any:
        """Return the plain value at a path, or :data:`ABSENT` if a field is not set.

        Raises:
            UnknownNameError: If a member of a section does not exist.
        """
        value: Any = self._data
        for k, part in enumerate(path):
            members = value if isinstance(value, dict) else {}
            value = members.get(part, ABSENT)
            if value is ABSENT and is_member(self._model, path[: k + 1]):
                kind = path[k - 1].removesuffix("s")
                raise UnknownNameError(f"{self.path} has no {kind} `{part}`; {nearest(str(part), members)}")
        return value

    def _edit(self, edits: Mapping[DataPath, Any]) -> None:
        """Set the values at the given paths, where :data:`ABSENT` removes a value.

        If an error is raised, nothing is changed.

        Raises:
            SpecError: If a value is invalid.
            UnknownNameError: If a path contains a member that does not exist, for example because it was renamed.
        """
        data = self._data
        given = {path: ABSENT if value is ABSENT else to_plain(value) for path, value in edits.items()}
        for path, value in given.items():
            before = self._get(path if value is ABSENT else path[:-1])
            if value is not ABSENT or before is not ABSENT:
                data = with_value(self._model, data, path, value)
        with self._replacing(data, given):
            for path, value in given.items():
                if value is not ABSENT:
                    _judge(self._model, path, value)

    def _rename(self, section: DataPath, old: str, new: str) -> None:
        """Rename a member and all references to it."""
        (sections,) = (field_type(owner, section[-1]) for owner in models_at(self._model, section[:-1]))
        rename = Rename(section, old, new)
        with self._replacing(renamed(self._data, [rename]), [(*section, new)]):
            TypeAdapter(get_args(sections)[0]).validate_python(new, strict=True)
        if self._is_own(section, old):
            self._renames = (*self._renames, rename)

    def _is_own(self, section: DataPath, name: str) -> bool:
        """Return True if a member is written in this document, rather than in a base or by a repeat or include."""
        value: Any = self._base
        for part in (*section, name):
            value = value.get(part, ABSENT) if isinstance(value, dict) else ABSENT
        return value is ABSENT

    @contextmanager
    def _replacing(self, data: dict[str, Any], paths: Iterable[DataPath]) -> Iterator[None]:
        """Replace the data of the document after the body of the ``with`` statement has validated it.

        Raises:
            SpecError: If the data is invalid. The exception contains the findings at or below ``paths``.
        """
        try:
            yield
        except (ValidationError, ExpressionError) as error:
            edited = copy(self)
            edited._data = data
            starts = tuple(f"{'.'.join(path)}." for path in paths)
            errors = (d for d in edited._load().findings if d.severity is Severity.ERROR)
            findings = [d for d in errors if f"{d.path}.".startswith(starts)]
            code = "SF202" if isinstance(error, ExpressionError) else "SF103"
            # Some values of other types have the same text as valid values, which therefore has no error for them.
            reason = error.errors()[0]["msg"] if isinstance(error, ValidationError) else str(error)
            raise SpecError(findings or [Diagnostic(code, Severity.ERROR, reason, str(self.path))]) from None
        self._data = data


def _values(data: Any, pattern: tuple[str, ...]) -> Iterator[Any]:
    """Yield the values at the paths that match a pattern."""
    if not pattern:
        yield data
    elif isinstance(data, dict):
        for key in data if pattern[0] == "*" else pattern[:1]:
            yield from _values(data.get(key), pattern[1:])


def _judge(model: type[Model], path: DataPath, value: Any) -> None:
    """Check all properties of the value at a path that do not depend on other values.

    Raises:
        ValidationError: If the value or a name in it has the wrong type.
        ExpressionError: If a predicate in the value is invalid.
    """
    for owner in models_at(model, path[:-1]):
        if path[-1] in owner.model_fields:
            field_adapter(owner, path[-1]).validate_python(value, strict=True)
            for text in _predicates(path[-1], value):
                parse_call(text)
            return
    _judge(model, path[:-1], {path[-1]: value})  # a member is checked together with its name


def _predicates(key: str, value: Any) -> Iterator[str]:
    """Yield the predicates in the value of a key."""
    if key in ("relations", "goal"):
        yield from (text for text, _ in texts({"all": value} if key == "relations" else value))
    for name, item in value.items() if isinstance(value, dict) else ():
        yield from _predicates(name, item)
