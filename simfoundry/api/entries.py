"""Views of parts of a document: entries, their fields, and mappings from names to entries."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, MutableMapping, MutableSequence, Sequence
from copy import copy
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Never, NoReturn, Self, TypeVar, overload

from simfoundry.errors import SimfoundryError
from simfoundry.spec.change.diff.changes import copied
from simfoundry.spec.change.merge.conflict import ABSENT
from simfoundry.spec.diagnostics import nearest
from simfoundry.spec.models.base import Model
from simfoundry.spec.models.types import field_adapter
from simfoundry.spec.yaml.spelling import LARGE
from simfoundry.spec.yaml.write import to_data

if TYPE_CHECKING:
    from simfoundry.api.document import EditableDocument

Got = TypeVar("Got")
Given = TypeVar("Given", contravariant=True)

# A path in the data of a document, such as ``("objects", "mug")``.
DataPath = tuple[str, ...]


class UnknownNameError(SimfoundryError, KeyError):
    """Raised if a name does not exist in a document. The message suggests similar names."""

    def __str__(self) -> str:
        return str(self.args[0])


class DocumentEntry:
    """A view of one entry in a document, such as an object or a material. All values are stored in the document."""

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
        """Set several fields at once. A value of None removes the field.

        This is useful if one field replaces another: ``update(pose=None, place=...)``. If an error is raised, no field
        is changed.

        Raises:
            SpecError: If a value is invalid.
            UnknownNameError: If a field does not exist, or if the entry was removed or renamed.
        """
        fields = {**values, **more}
        for name in fields:
            self._check_field(name)
        self._document._edit({(*self._at, n): ABSENT if value is None else value for n, value in fields.items()})

    def __repr__(self) -> str:
        try:
            return f"<{'.'.join(self._at)} {self.to_data()}>"
        except UnknownNameError:
            return f"<{'.'.join(self._at)}, which was removed or renamed>"

    def _check_field(self, name: str, error: type[Exception] = UnknownNameError) -> None:
        """Check that there is a field called ``name`` that can be edited, and raise an error otherwise."""
        fields = {n: getattr(type(self), n, None) for n in self._model.model_fields}
        if isinstance(fields.get(name), FixedField):
            raise error(f"`{name}` cannot be changed in Python; edit it in {self._document.path}")
        if name not in fields:
            title = f"`{'.'.join(self._at)}`" if self._at else self._document.path
            names = (n for n, field in fields.items() if not isinstance(field, FixedField))
            raise error(f"{title} has no field `{name}`; {nearest(str(name), names)}")

    if not TYPE_CHECKING:  # type checkers see the declared fields instead

        def __getattr__(self, name: str) -> object:
            if not name.startswith("_"):  # copying and pickling look for such names before `_at` exists
                self._check_field(name, AttributeError)
            raise AttributeError(name)

        def __setattr__(self, name: str, value: object) -> None:
            if not name.startswith("_"):
                self._check_field(name, AttributeError)
            super().__setattr__(name, value)


class _Field(Generic[Given]):
    """A field of an entry that can be set and removed."""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __set__(self, entry: DocumentEntry, value: Given) -> None:
        """Set the value, or remove it if it is None.

        Raises:
            SpecError: If the value is invalid.
        """
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
            value = None if info.is_required() else info.default
        else:
            value = field_adapter(entry._model, self.name).validate_python(value, strict=True)
        return _read_only(value)  # type: ignore[no-any-return]


class FixedField(ValueField[Got, Never]):
    """A field that can be read but not edited. Changing it would change the meaning of the rest of the document."""


class ReadOnlyDict(dict[str, Any]):
    """A read-only mapping in a value that was read from a document. Edits to it would not change the document."""

    def _refuse(self, *_: object, **__: object) -> NoReturn:
        raise TypeError("this mapping is read-only; assign a new value to its field: `x.y = {**x.y, name: value}`")

    __setitem__ = __delitem__ = __ior__ = update = pop = popitem = clear = setdefault = _refuse

    def __reduce__(self) -> tuple[type[ReadOnlyDict], tuple[dict[str, Any]]]:
        return type(self), (dict(self),)


def _read_only(value: Any) -> Any:
    """Return a copy of a typed value in which no mapping can be edited."""
    match value:
        case dict():
            return ReadOnlyDict({key: _read_only(item) for key, item in value.items()})
        case tuple():
            return tuple(map(_read_only, value))
        case Model():
            value = value.model_copy()
            vars(value).update({name: _read_only(item) for name, item in vars(value).items()})
    return value


E = TypeVar("E", bound=DocumentEntry)
View = TypeVar("View")


class EntryField(_Field[View | Model | Mapping[str, object] | None], Generic[View]):
    """A field with parts, such as a pose or a section. Edit its parts individually, or assign a mapping."""

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
    """Declare a section of a document, such as the objects of a scene by name."""
    return EntryField(lambda document, path: EntryMapping(document, path, kind))


class EntryMapping(MutableMapping[str, E]):
    """The members of a section by name, such as ``scene.objects``."""

    def __init__(self, document: EditableDocument, path: DataPath, kind: type[E]) -> None:
        self._document, self._at, self._kind = document, path, kind

    def __getitem__(self, name: str) -> E:
        self._document._get((*self._at, name))
        return self._kind(self._document, (*self._at, name))

    def __setitem__(self, name: str, value: E | Model | Mapping[str, object]) -> None:
        self._document._edit({(*self._at, str(name)): value})

    def __delitem__(self, name: str) -> None:
        self._document._edit({(*self._at, name): ABSENT})

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
        self._require_new(name := str(name))
        self[name] = fields
        return self[name]

    def pop(self, name: str, /, *default: Any) -> E | Any:
        """Remove a member and return its entry, which belongs to a copy of the document."""
        before = EntryMapping(copy(self._document), self._at, self._kind)
        super().pop(name, *default)
        return before.get(name, *default)

    def popitem(self) -> tuple[str, E]:
        """Remove the first member and return its name and its entry. The entry belongs to a copy of the document."""
        name = next(iter(self), "")
        return name, self.pop(name)

    def update(self, members: Any = (), /, **more: Any) -> None:
        """Set several members at once. If an error is raised, no member is changed."""
        self._document._edit({(*self._at, str(name)): value for name, value in {**dict(members), **more}.items()})

    def clear(self) -> None:
        """Remove all members."""
        self._document._edit({self._at: ABSENT})

    def rename(self, old: str, new: str) -> E:
        """Rename a member and update all references to it in this document, for example in relations and placements.

        Documents that use this one, such as tasks, stay as they are; ``simfoundry rename`` changes them, too.
        """
        self._document._get((*self._at, old))
        self._require_new(new := str(new))
        self._document._rename(self._at, old, new)
        return self[new]

    def _names(self) -> dict[str, Any]:
        found = self._document._get(self._at)
        return dict(found) if isinstance(found, dict) else {}

    def _require_new(self, name: str) -> None:
        if name in self._names():
            noun = self._at[-1].removesuffix("s")
            article = "an" if noun[0] in "aeiou" else "a"
            raise SimfoundryError(f"{article} {noun} named `{name}` already exists; choose a different name")


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
        self._document._edit({self._at: tuple(texts) or ABSENT})


def to_plain(value: Any) -> Any:
    """Convert a value to plain data, which consists of mappings, tuples and scalars. Mappings omit values of None."""
    if isinstance(value, Model):
        return to_data(value)
    if hasattr(value, "tolist"):  # numpy arrays and numbers
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): to_plain(item) for key, item in value.items() if item is not None}
    if isinstance(value, float) and abs(value) < LARGE and value.is_integer():
        return int(value)  # as in the document's text, so that 77.0 is also accepted for an integer
    if isinstance(value, str | int | float | None):
        return value
    if isinstance(value, Sequence) and not isinstance(value, bytes | bytearray):
        return tuple(to_plain(item) for item in value)
    if isinstance(value, Path):
        return value.as_posix()
    if isinstance(value, DocumentEntry):
        return value.to_data()
    raise SimfoundryError(f"{value!r} cannot be written to a document; use numbers, strings, lists and mappings")
