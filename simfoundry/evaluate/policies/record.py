"""Statistics of the exchange between a policy and its server, for reports."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

KEPT = 100
"""Maximum number of error messages kept; further ones are only counted, to keep reports short."""


@dataclass
class PolicyRecord:
    """Counts, times and errors of the queries to a policy, accumulated over rollouts.

    ``seconds`` are the times [s] from each query to its answer, including reconnections and repeated queries.
    """

    questions: int = 0
    connections: int = 0
    reconnects: int = 0
    failures: int = 0
    errors: list[str] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    def failed(self, sentence: str) -> None:
        """Record an error."""
        self.failures += 1
        if len(self.errors) < KEPT:
            self.errors.append(sentence)

    def to_json(self) -> Mapping[str, Any]:
        """Return numbers and messages for a report; times as median and maximum [s]."""
        ordered = sorted(self.seconds)
        return {
            "questions": self.questions,
            "connections": self.connections,
            "reconnects": self.reconnects,
            "failures": self.failures,
            "errors": list(self.errors),
            "median_s": ordered[len(ordered) // 2] if ordered else None,
            "longest_s": ordered[-1] if ordered else None,
        }
