"""Look up model types and the canonical key order along document paths."""

from __future__ import annotations

import functools
import types
import typing
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from pydantic import BaseModel, Tag, TypeAdapter

from simfoundry.spec.models.base import BodySpec, DocumentSpec, FormerKey, Model, Reference
from simfoundry.spec.yaml.text import read

_KEYS: dict[str, Any] = read(Path(__file__).with_name("keys.yaml")).data

# Groups of mutually exclusive keys; a key set by an overlay replaces the base's other keys in the same group.
EXCLUSIVE: tuple[tuple[str, ...], ...] = _KEYS["exclusive"]

# Sections in which names are looked up, keyed by the field whose value is a name or a list of names.
REFERENCES: dict[str, tuple[str, ...]] = _KEYS["references"]

# Keys whose values are predicates, or lists of predicates.
EXPRESSIONS: tuple[str, ...] = _KEYS["expressions"]

# Mappings whose keys are names: for each kind of document, the section of the names by the pattern of the path.
NAMES: dict[str, dict[str, str]] = _KEYS["names"]

# For each key, the keys that it cannot be combined with.
RIVALS = {key: {k for group in EXCLUSIVE if key in group for k in group} - {key} for key in sum(EXCLUSIVE, ())}

# Path in which ``*`` matches any name or index.
Pattern = tuple[str, ...]


def models_at(root: Any, loc: tuple[Any, ...]) -> list[type[BaseModel]]:
    """Return the possible model classes at ``loc`` below the type ``root``."""
    current = list(flat(root))
    for part in loc:
        following: list[Any] = []
        for tag, kind in current:
            if tag is not None and tag == part:
                following += [(None, kind)]
            following += [t for inner in inside(kind, part) for t in flat(inner)]
        current = following
    return [kind for _, kind in current if isinstance(kind, type) and issubclass(kind, BaseModel)]


def kinds_at(root: Any, path: tuple[Any, ...]) -> list[Any]:
    """Return the possible types at a path in a document of the type ``root``, without unions and constraints."""
    current = [kind for _, kind in flat(root)]
    for part in path:
        current = [each for kind in current for inner in inside(kind, part) for _, each in flat(inner)]
    return current


def inside(kind: Any, part: Any) -> Iterator[Any]:
    """Yield the types that a member of a type can have. ``part`` is the key or index of the member."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        if part in kind.model_fields:
            yield field_type(kind, part)
    elif typing.get_origin(kind) is dict:
        yield typing.get_args(kind)[1]
    elif typing.get_origin(kind) is tuple and isinstance(part, int):
        yield typing.get_args(kind)[0]


def field_type(model: type[BaseModel], name: str) -> Any:
    """Return the type of a field, annotated with its constraints."""
    info = model.model_fields[name]
    if isinstance(info.annotation, typing.ForwardRef):  # a recursive type, which has not been resolved yet
        model.model_rebuild()
        info = model.model_fields[name]
    return typing.Annotated[info.annotation, *info.metadata] if info.metadata else info.annotation


@functools.cache
def field_adapter(model: type[BaseModel], name: str) -> TypeAdapter[Any]:
    """Return the validator for the value of a field."""
    return TypeAdapter(field_type(model, name))


def former_keys(model: type[BaseModel]) -> dict[str, str]:
    """Return a mapping from each of a model's old keys to its current key."""
    marks = ((name, mark) for name, info in model.model_fields.items() for mark in info.metadata)
    return {mark.key: name for name, mark in marks if isinstance(mark, FormerKey)}


def former_paths(root: Any, data: Any, at: tuple[str | int, ...] = ()) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """Yield the path of each former key in a document together with its current key, innermost first."""
    kinds = [kind for _, kind in flat(root)]
    if isinstance(data, dict):
        models = models_at(root, ())
        former = {old: new for model in models for old, new in former_keys(model).items() if new not in data}
        for key, value in data.items():
            for below in [type_ for kind in kinds for type_ in inside(kind, former.get(key, key))]:
                yield from former_paths(below, value, (*at, key))
        yield from (((*at, key), former[key]) for key in data if key in former)
    elif isinstance(data, tuple | list):
        for k, value in enumerate(data):
            for below in [type_ for kind in kinds for type_ in inside(kind, k)]:
                yield from former_paths(below, value, (*at, k))


def with_present_keys(root: Any, data: Any) -> Any:
    """Return a document's data with all former keys renamed to the current ones."""
    for path, name in former_paths(root, data):
        data = _renamed(data, path, name)
    return data


def _renamed(data: Any, path: tuple[str | int, ...], name: str) -> Any:
    head, *rest = path
    if isinstance(data, dict) and not rest:
        return {name if key == head else key: value for key, value in data.items()}
    if isinstance(data, dict):
        return {key: _renamed(value, tuple(rest), name) if key == head else value for key, value in data.items()}
    return tuple(_renamed(item, tuple(rest), name) if k == head else item for k, item in enumerate(data))


def is_mapping(model: type[BaseModel], key: str) -> bool:
    """Return True if a field is a mapping from names to members."""
    return typing.get_origin(model.model_fields[key].annotation) is dict


def flat(kind: Any, tag: str | None = None) -> Iterator[tuple[str | None, Any]]:
    """Yield each member of a union type with its discriminator tag."""
    origin = typing.get_origin(kind)
    if origin is typing.Annotated:
        inner, *metadata = typing.get_args(kind)
        tags = [m.tag for m in metadata if isinstance(m, Tag)]
        yield from flat(inner, tags[0] if tags else tag)
    elif origin in (typing.Union, types.UnionType):
        for member in typing.get_args(kind):
            yield from flat(member, tag)
    else:
        yield tag, kind


def file_patterns(model: type[Model], seen: tuple[type, ...] = ()) -> Iterator[Pattern]:
    """Yield patterns for the paths at which a kind of document refers to files."""
    yield from _file_patterns(model, seen)


@functools.cache
def _file_patterns(model: type[Model], seen: tuple[type, ...]) -> tuple[Pattern, ...]:
    fields = ((name, _files(field_type(model, name), (*seen, model))) for name in model.model_fields)
    return tuple((name, *below) for name, found in fields for below in found)


def is_file(kind: Any) -> bool:
    """Return True if a value of this type is the path of a file."""
    return () in set(_files(kind, ()))


def _files(kind: Any, seen: tuple[type, ...]) -> Iterator[Pattern]:
    origin = typing.get_origin(kind)
    if origin is typing.Annotated:
        inner, *metadata = typing.get_args(kind)
        if any(isinstance(m, Reference) for m in metadata):
            yield ()
        yield from _files(inner, seen)
    elif origin in (typing.Union, types.UnionType):
        for member in typing.get_args(kind):
            yield from _files(member, seen)
    elif origin in (dict, tuple):
        yield from (("*", *below) for below in _files(typing.get_args(kind)[origin is dict], seen))
    elif isinstance(kind, type) and issubclass(kind, Model) and kind not in seen:
        yield from file_patterns(kind, seen)


# The rank of keys that come first or last in a mapping; all other keys have rank 0.
_RANK = {name: rank - len(_KEYS["first"]) for rank, name in enumerate(_KEYS["first"])} | dict.fromkeys(_KEYS["last"], 1)


def field_order(model: type[Model]) -> list[str]:
    """Return the names of a model's fields in canonical order.

    This is the order of definition, except for bodies and whole documents, whose models begin with inherited fields.
    """
    if not issubclass(model, BodySpec | DocumentSpec):
        return list(model.model_fields)
    return sorted(model.model_fields, key=lambda name: _RANK.get(name, 0))


class KeyOrder:
    """The canonical order of the keys at a path in a document and below it."""

    def __init__(self, *types_: Any) -> None:
        kinds = [kind for type_ in types_ for _, kind in flat(type_)]
        self._fields: dict[str, Any] = {}
        for model in (k for k in kinds if isinstance(k, type) and issubclass(k, Model)):
            for name in field_order(model):
                self._fields.setdefault(name, model.model_fields[name].annotation)
        self._rank = {name: rank for rank, name in enumerate(self._fields)}
        self._others = [typing.get_args(k)[-1] for k in kinds if typing.get_origin(k) is dict]
        self._items = [t for k in kinds if typing.get_origin(k) is tuple for t in typing.get_args(k) if t is not ...]
        self._inside: dict[str, KeyOrder] = {}

    def ordered(self, keys: Iterable[str]) -> list[str]:
        """Return fields in canonical order, followed by all other keys, such as names, in their original order."""
        rank = self._rank
        return sorted(keys, key=lambda key: rank.get(key, len(rank))) if rank else list(keys)

    def member(self, key: str) -> KeyOrder:
        """Return the key order for the value of ``key``."""
        known = key if key in self._fields else ""
        if known not in self._inside:
            self._inside[known] = KeyOrder(*([self._fields[key]] if known else self._others))
        return self._inside[known]

    @functools.cached_property
    def item(self) -> KeyOrder:
        """Return the key order for the items of a list."""
        return KeyOrder(*self._items)


@functools.cache
def key_order(model: type[Model] | None) -> KeyOrder:
    """Return the key order for a complete document."""
    return KeyOrder(model)
