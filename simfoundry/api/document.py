"""Documents that can be edited in place and saved with their comments and layout."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar, Self

from pydantic import TypeAdapter, ValidationError

from simfoundry.api.entries import DataPath, DocumentEntry, UnknownNameError, to_plain
from simfoundry.errors import SimfoundryError
from simfoundry.spec.change.diff.changes import Rename, copied, renamed, same
from simfoundry.spec.change.edit_text import edit_text
from simfoundry.spec.change.flatten import own_data
from simfoundry.spec.change.merge.conflict import ABSENT
from simfoundry.spec.diagnostics import Diagnostic, Severity, SpecError
from simfoundry.spec.files import Loaded
from simfoundry.spec.load import compose, load, load_kind
from simfoundry.spec.models.base import DocumentSpec, Model
from simfoundry.spec.models.types import field_type, file_patterns, models_at
from simfoundry.spec.yaml.write import to_data, to_yaml


class EditableDocument(DocumentEntry):
    """A document that is edited in place. Nothing is written to disk until :meth:`save` is called.

    All methods that read the document (``check``, ``lower``, ``save``) use the edited text: findings refer to lines in
    that text, and the comments and layout around each edit are preserved.
    """

    _model: ClassVar[type[DocumentSpec]]
    _kind: ClassVar[str]

    def __init__(self, loaded: Loaded) -> None:
        assert isinstance(loaded.spec, self._model)
        super().__init__(self, ())
        self._set_loaded(loaded)
        self._imported_from: Path | None = None
        self._mesh_folder: Path | None = None

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
        return self._text(self._data)

    @property
    def changes(self) -> list[str]:
        """Descriptions of the edits made since the document was loaded or saved, such as ``mug mass 0.31 → 0.3 kg``."""
        from simfoundry.spec.change.diff.words import describe, text

        return text(describe(self._before, self._data, self._model))

    def check(self, *, lints: bool = True) -> list[Diagnostic]:
        """Check the edited document and return all findings; if ``lints`` is False, check only its structure."""
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
            SpecError: If the edited document has errors; nothing is written in this case.
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
        """Copy the mesh folder of an imported document to the folder of ``target``; undo this if the block fails."""
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
        from simfoundry.spec.yaml.text import read

        assert loaded.spec is not None and loaded.document is not None
        text = loaded.document.text
        self._file, self._loaded = loaded.path, loaded
        self._source = text or to_yaml(loaded.spec)  # a document loaded from a USD stage has no YAML text
        # All values that are stated in the text, including defaults, joined with the documents that it extends.
        self._before: dict[str, Any] = copied(loaded.document.data) if text else to_data(loaded.spec)
        self._data: dict[str, Any] = copied(self._before)
        bases = loaded.bases[:1]
        self._base = compose(read(bases[0]), self._kind, loaded.root)[0].data if bases else ABSENT

    def _text(self, data: dict[str, Any]) -> str:
        """Return the text of the document with the given content."""
        if same(data, self._before):
            return self._source
        from simfoundry.spec.yaml.text import parse

        return edit_text(self._source, own_data(parse(self._source).data, self._before, data, self._base), self._model)

    def _load(self) -> Loaded:
        """Return the edited document, including any findings."""
        return self._loaded if self._data == self._before else load(self.path, text=self.text)

    def _checked(self) -> Loaded:
        """Return the edited document, or raise :class:`SpecError` if it has errors."""
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
        """Return the plain value at a path, or :data:`ABSENT`."""
        return _value_at(self._data, path)

    def _set(self, path: DataPath, value: Any) -> None:
        """Set the value at a path, or raise :class:`SpecError` if the value is invalid."""
        plain = to_plain(value)
        try:
            _validate(self._model, path, plain)
        except ValidationError:
            plain = self._as_written(path, plain)
        _put(self._data, path, plain)

    def _as_written(self, path: DataPath, plain: Any) -> Any:
        """Return a value as it is read from the document's text, such as 77 for 77.0.

        Raises:
            SpecError: If the value is invalid in the text too; the findings are those of the edited text.
        """
        data = copied(self._data)
        _put(data, path, plain)
        loaded = load(self.path, text=self._text(data))
        written = _value_at(loaded.document.data, path) if loaded.document is not None else ABSENT
        try:
            _validate(self._model, path, written)
        except ValidationError:
            raise SpecError(d for d in loaded.findings if d.severity is Severity.ERROR) from None
        return copied(written)

    def _delete(self, path: DataPath) -> None:
        """Remove the value at a path, and all parent mappings that become empty as a result."""
        place = self._get(path[:-1])
        del place[path[-1]]
        if not place and len(path) > 1:
            self._delete(path[:-1])

    def _rename(self, section: DataPath, old: str, new: str) -> None:
        """Rename a member and all references to it."""
        self._data = renamed(self._data, [Rename(section, old, new)])


def _value_at(data: Any, path: DataPath) -> Any:
    for part in path:
        data = data.get(part, ABSENT) if isinstance(data, dict) else ABSENT
    return data


def _put(data: dict[str, Any], path: DataPath, value: Any) -> None:
    for part in path[:-1]:
        data = data.setdefault(part, {})
    data[path[-1]] = value


def _values(data: Any, pattern: tuple[str, ...]) -> Iterator[Any]:
    """Yield the values at the paths that match a pattern."""
    if not pattern:
        yield data
    elif isinstance(data, dict):
        for key in data if pattern[0] == "*" else pattern[:1]:
            yield from _values(data.get(key), pattern[1:])


def _validate(model: type[Model], path: DataPath, value: Any) -> None:
    """Validate a value against the type of the field or section member at a path."""
    for owner in models_at(model, path[:-1]):
        if path[-1] in owner.model_fields and issubclass(owner, Model):
            TypeAdapter(field_type(owner, path[-1])).validate_python(value, strict=True)
            return
    for kind in models_at(model, path):
        kind.model_validate(value)
        return
    raise UnknownNameError(f"`{'.'.join(path)}` is not a path in this document")
