"""Documents that can be edited in place and saved with their comments and layout."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar, Self

from pydantic import TypeAdapter, ValidationError

from simfoundry.api.entries import DataPath, DocumentEntry, UnknownNameError, to_plain
from simfoundry.errors import OutputError, SimfoundryError
from simfoundry.spec.change.diff.changes import Rename, copied, renamed
from simfoundry.spec.change.edit_text import edit_text, own_data
from simfoundry.spec.change.merge.conflict import ABSENT
from simfoundry.spec.diagnostics import Diagnostic, Severity, SpecError
from simfoundry.spec.files import Loaded
from simfoundry.spec.load import load, load_kind
from simfoundry.spec.models.base import DocumentSpec, Model
from simfoundry.spec.models.types import field_type, file_patterns, models_at
from simfoundry.spec.yaml.write import to_data, to_yaml


class EditableDocument(DocumentEntry):
    """A document that is edited in place. Nothing is written to disk until :meth:`save` is called.

    All methods that read the document (``check``, ``lower``, ``save``) use the edited text. Findings refer to lines in
    that text, and the comments and layout around each edit are preserved.
    """

    _model: ClassVar[type[DocumentSpec]]
    _kind: ClassVar[str]

    def __init__(self, loaded: Loaded) -> None:
        assert isinstance(loaded.spec, self._model)
        super().__init__(self, ())
        self._file = loaded.path
        text = loaded.document.text if loaded.document is not None else ""
        self._source = text or to_yaml(loaded.spec)  # a document loaded from a USD stage has no YAML text
        self._before: dict[str, Any] = to_data(loaded.spec)
        self._data: dict[str, Any] = copied(self._before)
        self._loaded = loaded
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
        if self._data == self._before:
            return self._source
        from simfoundry.spec.yaml.text import parse, read

        base: Any = ABSENT
        if self._loaded.bases:
            base = (load(self._loaded.bases[0]).document or read(self._loaded.bases[0])).data
        own = own_data(parse(self._source).data, self._before, self._data, base)
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
        """
        from simfoundry.runtime.files import write_atomically

        target = Path(path) if path is not None else self.path
        if path is None and self._imported_from is not None:
            raise SimfoundryError(
                f"this document was imported from {self._imported_from}; save it elsewhere: `save('a.scene.yaml')`"
            )
        if not target.name.endswith(".yaml"):
            raise SimfoundryError(f"{target} is not a YAML file; specify one, such as `save('desk.scene.yaml')`")
        if target.resolve().parent != self.path.resolve().parent and any(self._files()):
            self._take_files(target)
        text = self.text
        loaded = load(target, text=text)
        if loaded.errors:
            raise SpecError(loaded.errors)
        write_atomically(target, text.encode())
        self._file, self._source, self._before = target, text, copied(self._data)
        self._imported_from = None
        self._loaded = loaded
        return target

    def mark_imported(self, source: Path, mesh_folder: Path | None = None) -> None:
        """Record the source file of an imported document and the mesh folder to copy when the document is saved."""
        self._imported_from, self._mesh_folder = source, mesh_folder

    def _take_files(self, target: Path) -> None:
        """Copy the mesh folder of an imported document to the folder in which the document is saved."""
        import shutil

        folder = self._mesh_folder
        if folder is None:
            raise SimfoundryError(
                f"{target} cannot be written: the document refers to files relative to {self.path.resolve().parent}; "
                "save it in that folder"
            )
        if (target.parent / folder.name).exists():
            raise OutputError(f"{target.parent / folder.name} already exists; save to a different folder")
        shutil.copytree(folder, target.parent / folder.name)

    def __repr__(self) -> str:
        edited = ", edited" if self._data != self._before else ""
        return f"<{type(self).__name__} {self._data.get('name')} of {self.path}{edited}>"

    def _load(self) -> Loaded:
        """Return the edited document, including any findings."""
        return self._loaded if self._data == self._before else load(self.path, text=self.text)

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
        """Return the plain value at a path, or :data:`ABSENT`."""
        value: Any = self._data
        for part in path:
            value = value.get(part, ABSENT) if isinstance(value, dict) else ABSENT
        return value

    def _set(self, path: DataPath, value: Any) -> None:
        """Set the value at a path.

        Raises:
            SpecError: If the value is invalid.
        """
        before, plain = copied(self._data), to_plain(value)
        place = self._data
        for part in path[:-1]:
            place = place.setdefault(part, {})
        place[path[-1]] = plain
        try:
            _validate(self._model, path, plain)
        except ValidationError:
            findings = [d for d in self._load().findings if d.severity is Severity.ERROR]
            self._data = before
            raise SpecError(findings) from None

    def _delete(self, path: DataPath) -> None:
        """Remove the value at a path, along with all parent mappings that become empty as a result."""
        place = self._get(path[:-1])
        del place[path[-1]]
        if not place and len(path) > 1:
            self._delete(path[:-1])

    def _rename(self, section: DataPath, old: str, new: str) -> None:
        """Rename a member and all references to it."""
        self._data = renamed(self._data, [Rename(section, old, new)])


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
