"""Parse predicates and conditions: ``OnTop(cup, desk)``, ``{all: [...]}``, ``{any: [...]}``, ``{not: ...}``."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Discriminator, Field, Tag, create_model

from simfoundry.runtime.plugins import PluginError
from simfoundry.spec.models.base import Model
from simfoundry.spec.models.predicate import PREDICATES, Predicate, canonical

_CALL = re.compile(r"\s*([A-Za-z]\w*)\s*\(([^()]*)\)\s*\Z")
_ARGUMENT = re.compile(r"[a-z][a-z0-9_]*(\.[a-z][a-z0-9_]*)?\Z")
_NUMBER = re.compile(r"[-+]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][-+]?[0-9]{1,3})?\Z")


class ExpressionError(ValueError):
    """Error for a text that is not a predicate; ``word`` is the faulty part, and ``choices`` are the valid values."""

    def __init__(self, message: str, word: str = "", choices: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.word, self.choices = word, choices


@dataclass(frozen=True)
class Call:
    """Predicate with its arguments and their kinds."""

    predicate: str
    args: tuple[str, ...]

    @property
    def declaration(self) -> Predicate:
        """Return the declaration of the predicate."""
        return PREDICATES.load(self.predicate)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Return the kind of each argument."""
        return self.declaration.parameters[: len(self.args)]

    def __str__(self) -> str:
        return f"{self.predicate}({', '.join(self.args)})"


@lru_cache(maxsize=1024)  # checks, lowering and predicates parse the same few expressions
def parse_call(text: str) -> Call:
    """Parse a predicate by its name or an alias; raises :class:`ExpressionError`."""
    match = _CALL.match(text)
    if match is None:
        raise ExpressionError(f"`{text[:80]}` is not of the form `Predicate(object, object)`")
    name, inside = match.groups()
    name, arguments = canonical(name, tuple(a.strip() for a in inside.split(",")) if inside.strip() else ())
    if name not in PREDICATES:
        raise ExpressionError(f"`{name}` is not a predicate", name, tuple(PREDICATES.names()))
    try:
        predicate = PREDICATES.load(name)
    except PluginError as error:
        raise ExpressionError(str(error)) from error
    if not len(predicate.parameters) - predicate.optional <= len(arguments) <= len(predicate.parameters):
        raise ExpressionError(f"`{name}` takes {predicate.counts}, not {len(arguments)}")
    for argument, kind in zip(arguments, predicate.parameters, strict=False):
        if kind == "number" and not _NUMBER.match(argument):
            raise ExpressionError(f"`{argument}` is not a number, which `{name}` takes here")
        if kind != "number" and not _ARGUMENT.match(argument):
            raise ExpressionError(f"`{argument}` is not the name of an object or of a part of one")
    return Call(name, arguments)


def _tag(value: Any) -> str:
    if isinstance(value, Model):
        return next(iter(type(value).model_fields))
    if isinstance(value, dict):
        return next((k for k in ("all", "any", "not") if k in value), "all")
    return "text"


class AllOf(Model):
    """True if all conditions hold."""

    all: tuple[Condition, ...] = Field(description="Conditions that must all hold.")


class AnyOf(Model):
    """True if at least one condition holds."""

    any: tuple[Condition, ...] = Field(description="Conditions of which at least one must hold.")


# `not` is a Python keyword, so this model cannot be defined with a class statement.
NoneOf: type[Model] = create_model(
    "NoneOf",
    __base__=Model,
    __module__=__name__,
    __doc__="True if the condition does not hold.",
    **{"not": ("Condition", Field(description="A condition that must not hold."))},  # type: ignore[call-overload]
)

if TYPE_CHECKING:  # type checkers do not support this recursive type
    Condition = str | Model
else:
    Condition = Annotated[
        Annotated[str, Tag("text")]
        | Annotated[AllOf, Tag("all")]
        | Annotated[AnyOf, Tag("any")]
        | Annotated[NoneOf, Tag("not")],
        Discriminator(_tag),
    ]
    """Predicate, or a combination of several."""


def parts(condition: Any) -> tuple[str, tuple[Any, ...]]:
    """Return ``text``, ``all``, ``any`` or ``not`` for a condition (typed or plain data), and its operands."""
    tag = _tag(condition)
    if tag == "text":
        return tag, (condition,)
    below = condition.get(tag) if isinstance(condition, dict) else getattr(condition, tag)
    return tag, (below,) if tag == "not" else tuple(below) if isinstance(below, tuple | list) else ()


def texts(condition: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str, tuple[str | int, ...]]]:
    """Yield every predicate of a condition as written, with its path."""
    tag, below = parts(condition)
    if tag == "text":
        if isinstance(condition, str):
            yield condition, path
    elif tag == "not":
        yield from texts(below[0], (*path, tag))
    else:
        for k, item in enumerate(below):
            yield from texts(item, (*path, tag, k))
