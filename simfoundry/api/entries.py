"""Views of parts of a document: entries, their fields, and mappings from names to entries."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, MutableMapping, MutableSequence, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Self, TypeVar, overload

from pydantic import TypeAdapter

from simfoundry.errors import SimfoundryError
from simfoundry.spec.change.diff.changes import copied
from simfoundry.spec.change.merge.conflict import ABSENT
from simfoundry.spec.diagnostics import nearest
from simfoundry.spec.models.base import Model
from simfoundry.spec.models.types import field_type
from simfoundry.spec.yaml.write import to_data

if TYPE_CHECKING:
    from simfoundry.api.document import EditableDocument

Got = TypeVar("Got")
Given = TypeVar("Given", contravariant=True)

# A path in the data of a document, such as ``("objects", "mug")``.
DataPath = tuple[str, ...]


class UnknownNameError(SimfoundryError, KeyError):
    """Raised if a name does not exist in a document; the message suggests similar names."""

    def __str__(self) -> str:
        return str(self.args[0])


class DocumentEntry:
    """A view of one entry in a document, such as an object or a material; all values are stored in the document."""

    _model: ClassVar[type[Model]]
    _document: EditableDocument
    _at: DataPath

    def __init__(self, document: EditableDocument, path: DataPath) -> None:
        object.__setattr__(self, "_document", document)
        object.__setattr__(self, "_at", path)

    def to_data(self) -> dict[str, Any]:
        """Return the values that the document states for the entry as plain data."""
        found = self._document._get(self._at)
        return copied(found) if isinstance(found, dict) else {}

    def update(self, values: Mapping[str, object] = {}, /, **more: object) -> None:
        """Set several fields at once; a value of None removes the field.

        This is useful if one field replaces another: ``update(pose=None, place=...)``.
        """
        for name, value in {**values, **more}.items():
            self._check_field(name)
            if value is not None:
                self._document._set((*self._at, name), value)
            elif self._document._get((*self._at, name)) is not ABSENT:
                self._document._delete((*self._at, name))

    def __repr__(self) -> str:
        return f"<{'.'.join(self._at)} {self.to_data()}>"

    def _check_field(self, name: str) -> None:
        if name not in self._model.model_fields:
            raise UnknownNameError(f"`{'.'.join(self._at)}` has no `{name}`; {nearest(name, self._model.model_fields)}")

    if not TYPE_CHECKING:  # type checkers see the declared fields instead

        def __getattr__(self, name: str) -> object:
            raise AttributeError(f"`{'.'.join(self._at)}` has no `{name}`; {nearest(name, self._model.model_fields)}")

        def __setattr__(self, name: str, value: object) -> None:
            if not name.startswith("_") and name not in self._model.model_fields:
                self.__getattr__(name)
            super().__setattr__(name, value)


class _Field(Generic[Given]):
    """A field of an entry that can be set and removed."""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __set__(self, entry: DocumentEntry, value: Given) -> None:
        """Set the value; None removes it. Raises :class:`SpecError` if the value is invalid."""
        entry.update({self.name: value})

    def __delete__(self, entry: DocumentEntry) -> None:
        """Remove the value."""
        entry.update({self.name: None})


class ValueField(_Field[Given], Generic[Got, Given]):
    """A field with a plain value.

    Reading it returns the value in the document, or the default if the field is not set. Assigning None or using
    ``del`` removes the value from the document.
    """

    @overload
    def __get__(self, entry: None, owner: type) -> Self:
        """Return the value with the type declared in the model."""

    @overload
    def __get__(self, entry: DocumentEntry, owner: type) -> Got: ...
    def __get__(self, entry: DocumentEntry | None, owner: type) -> Self | Got:
        """Return the value with the type declared in the model."""
        if entry is None:
            return self
        value = entry._document._get((*entry._at, self.name))
        info = entry._model.model_fields[self.name]
        if value is ABSENT:
            default: Any = None if info.is_required() else info.default
            return default  # type: ignore[no-any-return]
        typed: Got = TypeAdapter(field_type(entry._model, self.name)).validate_python(value, strict=True)
        return typed


E = TypeVar("E", bound=DocumentEntry)
View = TypeVar("View")


class EntryField(_Field[View | Model | Mapping[str, object] | None], Generic[View]):
    """A field with parts, such as a pose or a section; edit its parts individually, or assign a mapping."""

    def __init__(self, view: Callable[[EditableDocument, DataPath], View]) -> None:
        self.view = view

    @overload
    def __get__(self, entry: None, owner: type) -> Self: ...
    @overload
    def __get__(self, entry: DocumentEntry, owner: type) -> View: ...
    def __get__(self, entry: DocumentEntry | None, owner: type) -> Self | View:
        """Return a view of the field's parts."""
        return self if entry is None else self.view(entry._document, (*entry._at, self.name))


def section(kind: type[E]) -> EntryField[EntryMapping[E]]:
    """Declare a section of a document, such as its objects by name."""
    return EntryField(lambda document, path: EntryMapping(document, path, kind))


class EntryMapping(MutableMapping[str, E]):
    """The members of a section by name, such as ``scene.objects``."""

    def __init__(self, document: EditableDocument, path: DataPath, kind: type[E]) -> None:
        self._document, self._at, self._kind = document, path, kind

    def __getitem__(self, name: str) -> E:
        self._require(name)
        return self._kind(self._document, (*self._at, name))

    def __setitem__(self, name: str, value: E | Model | Mapping[str, object]) -> None:
        self._document._set((*self._at, name), to_plain(value))

    def __delitem__(self, name: str) -> None:
        self._require(name)
        self._document._delete((*self._at, name))

    def __iter__(self) -> Iterator[str]:
        return iter(self._names())

    def __len__(self) -> int:
        return len(self._names())

    def __repr__(self) -> str:
        return f"<{'.'.join(self._at)}: {', '.join(self) or 'none'}>"

    def add(self, name: str, /, **fields: object) -> E:
        """Add a member with the given fields and return it.

        Example: ``scene.objects.add("cup", shape={"box": [0.1, 0.1, 0.1]}, mass=0.2)``.
        """
        self._require_new(name)
        self[name] = fields
        return self[name]

    def rename(self, old: str, new: str) -> E:
        """Rename a member and update all references to it, for example in relations and placements."""
        self._require(old)
        self._require_new(new)
        self._document._rename(self._at, old, new)
        return self[new]

    def _names(self) -> dict[str, Any]:
        found = self._document._get(self._at)
        return dict(found) if isinstance(found, dict) else {}

    @property
    def _noun(self) -> str:
        return self._at[-1].removesuffix("s")

    def _require_new(self, name: str) -> None:
        if name in self._names():
            article = "an" if self._noun[0] in "aeiou" else "a"
            raise SimfoundryError(f"{article} {self._noun} named `{name}` already exists; choose a different name")

    def _require(self, name: str) -> None:
        if name not in (names := self._names()):
            raise UnknownNameError(f"{self._document.path} has no {self._noun} `{name}`; {nearest(name, names)}")


class ExpressionList(MutableSequence[str]):
    """A list of expressions that is edited in place, such as ``scene.relations``."""

    def __init__(self, document: EditableDocument, path: DataPath) -> None:
        self._document, self._at = document, path

    @overload
    def __getitem__(self, index: int) -> str: ...
    @overload
    def __getitem__(self, index: slice) -> list[str]: ...
    def __getitem__(self, index: int | slice) -> str | list[str]:
        return self._texts()[index]

    def __setitem__(self, index: Any, value: Any) -> None:
        texts = self._texts()
        texts[index] = value
        self._write(texts)

    def __delitem__(self, index: int | slice) -> None:
        texts = self._texts()
        del texts[index]
        self._write(texts)

    def __len__(self) -> int:
        return len(self._texts())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and list(self) == list(other)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return repr(self._texts())

    def insert(self, index: int, value: str) -> None:
        """Insert an expression before the given index."""
        texts = self._texts()
        texts.insert(index, value)
        self._write(texts)

    def _texts(self) -> list[str]:
        found = self._document._get(self._at)
        return list(found) if isinstance(found, tuple) else []

    def _write(self, texts: Iterable[str]) -> None:
        given = tuple(texts)
        if given:
            self._document._set(self._at, given)
        elif self._texts():
            self._document._delete(self._at)


def to_plain(value: Any) -> Any:
    """Convert a value to plain data: mappings, tuples and scalars."""
    if isinstance(value, Model):
        return to_data(value)
    if hasattr(value, "tolist"):  # numpy arrays and numbers
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): to_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return tuple(to_plain(item) for item in value)
    if isinstance(value, Path):
        return value.as_posix()
    return value.to_data() if hasattr(value, "to_data") else value
