"""Candidate results and reasons for rejection."""

from __future__ import annotations

import json
from collections.abc import Container, Mapping
from dataclasses import dataclass, field
from itertools import chain, count
from types import MappingProxyType
from typing import Any

from simfoundry.errors import SimfoundryError


@dataclass(frozen=True)
class Reason:
    """A reason for rejection.

    ``code`` identifies the kind of reason for statistics, ``text`` is a message for users, and ``numbers`` contains the
    quantities in the message, in SI units.
    """

    code: str
    text: str
    numbers: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))

    def to_json(self) -> dict[str, Any]:
        """Return the reason as plain data for manifests."""
        return {"code": self.code, "text": self.text, "numbers": {k: float(v) for k, v in self.numbers.items()}}


@dataclass(frozen=True)
class Rejected:
    """A rejected random draw, with the reasons for its rejection."""

    reasons: tuple[Reason, ...]


class ImpossibleError(SimfoundryError):
    """An error raised before sampling if a request cannot be satisfied.

    ``reasons`` contains all reasons for this.
    """

    def __init__(self, reasons: tuple[Reason, ...]) -> None:
        super().__init__("; ".join(reason.text for reason in reasons))
        self.reasons = reasons


@dataclass(frozen=True)
class Candidate:
    """The result of examining a candidate.

    Attributes:
        index: 1-based index.
        documents: Document texts by kind (``scene``, ``task``). There are none if the candidate was rejected.
        asked: Predicates that were requested for the layout.
        goal: Goal of the candidate's own task, or an empty string.
        unchecked: Checks that could not be performed.
        reasons: Reasons for rejection. There are none if the candidate was accepted.
        vary: Values drawn for the axis `vary`, by path: a number, the text of a choice, or numbers by component.
        split: Name of the split that the values were drawn from, or empty.
        pictures_only: True if only pictures differ from the twin's.
    """

    index: int
    documents: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    asked: tuple[str, ...] = ()
    goal: str = ""
    unchecked: tuple[str, ...] = ()
    reasons: tuple[Reason, ...] = ()
    vary: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    split: str = ""
    pictures_only: bool = False

    @property
    def accepted(self) -> bool:
        """True if the candidate was accepted as a cousin."""
        return not self.reasons

    def files(self) -> dict[str, str]:
        """Return the file names of the documents, keyed by kind. An example is ``000017.scene.yaml``."""
        return {kind: file_of(self.index, kind) for kind in self.documents}

    def line(self) -> str:
        """Serialize the candidate to a single line of JSON. Identical candidates produce identical bytes."""
        data: dict[str, Any] = {"index": self.index}
        if self.accepted:
            data |= {"documents": dict(self.documents), "asked": list(self.asked)}
            data |= {"goal": self.goal} if self.goal else {}
            data |= {"unchecked": list(self.unchecked)} if self.unchecked else {}
            data |= self.drawn()
        else:
            data["reasons"] = [reason.to_json() for reason in self.reasons]
        return json.dumps(data, ensure_ascii=False, separators=(",", ":"))

    def drawn(self) -> dict[str, Any]:
        """Return the drawn values as plain data for logs and manifests. It is empty if no values vary."""
        if not self.vary:
            return {}
        split = {"split": self.split} if self.split else {}
        return {"vary": dict(self.vary), **split, "pictures_only": self.pictures_only}

    @classmethod
    def of(cls, line: str | bytes) -> Candidate:
        """Parse a serialized candidate.

        Raises:
            ValueError: The line is invalid.
        """
        data = json.loads(line)
        try:
            reasons = tuple(Reason(r["code"], r["text"], r["numbers"]) for r in data.get("reasons", ()))
            documents = {str(kind): str(text) for kind, text in data.get("documents", {}).items()}
            if not reasons and not documents:
                raise ValueError("neither documents nor reasons")
            asked, unchecked = tuple(data.get("asked", ())), tuple(data.get("unchecked", ()))
            drawn = dict(data.get("vary", {})), data.get("split", ""), data.get("pictures_only", False)
            return cls(int(data["index"]), documents, asked, data.get("goal", ""), unchecked, reasons, *drawn)
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"not a candidate: {error}") from None


def free_name(name: str, taken: Container[str]) -> str:
    """Return the name itself if it is not taken, otherwise the first numbered name that is free.

    The candidates for ``mug`` are ``mug``, ``mug_2``, ``mug_3``, ….
    """
    return next(n for n in chain((name,), (f"{name}_{k}" for k in count(2))) if n not in taken)


def file_of(index: int, kind: str) -> str:
    """Return the file name of a cousin's document."""
    return f"{index:06d}.{kind}.yaml"
