"""Statistics of the exchange between a policy and its server, for reports."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

KEPT = 100
"""Largest number of errors that are kept in words; of more, only the number: a report lists no hundred pages."""


@dataclass
class PolicyRecord:
    """Counts, times and errors of the questions to a policy; they grow from rollout to rollout.

    ``seconds`` are the times [s] from each question to its answer, reconnections and repeated questions included.
    """

    questions: int = 0
    connections: int = 0
    reconnects: int = 0
    failures: int = 0
    errors: list[str] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    def failed(self, sentence: str) -> None:
        """Note an error."""
        self.failures += 1
        if len(self.errors) < KEPT:
            self.errors.append(sentence)

    def to_json(self) -> Mapping[str, Any]:
        """Numbers and sentences for a report; the times as median and longest [s]."""
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
