"""Why a cousin is not accepted: a code to count by, a sentence, and its numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from simfoundry.errors import SimfoundryError


@dataclass(frozen=True)
class Reason:
    """``code`` is short and the same for all of a kind; ``text`` a sentence; ``numbers`` what it says, SI units."""

    code: str
    text: str
    numbers: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))

    def to_json(self) -> dict[str, Any]:
        """A plain mapping, for manifests."""
        return {"code": self.code, "text": self.text, "numbers": {k: float(v) for k, v in self.numbers.items()}}


@dataclass(frozen=True)
class Rejected:
    """No cousin, and why."""

    reasons: tuple[Reason, ...]


class ImpossibleError(SimfoundryError):
    """What is asked for can never be: each reason is certain before anything is tried."""

    def __init__(self, reasons: tuple[Reason, ...]) -> None:
        super().__init__("; ".join(reason.text for reason in reasons))
        self.reasons = reasons
