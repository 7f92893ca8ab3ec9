"""A sample of the corruptions of `tests.corpora.mutations`: none crashes, none passes, nearly all are pointed at."""

from __future__ import annotations

from tests.corpora.mutations import BAR, Tally, corrupt
from tests.corpora.reuse_errors import corrupt_reuse

COUNT = 300


def test_corruptions_are_found_where_they_are() -> None:
    _judge(corrupt(COUNT, seed=1)[0])


def test_corruptions_of_reuse_are_found_where_a_person_wrote_them() -> None:
    tallies = corrupt_reuse(COUNT, seed=1)[0]
    _judge(tallies)
    assert sum(t.later for t in tallies.values()) <= (1 - BAR) * COUNT, "by the first error"


def _judge(tallies: dict[str, Tally]) -> None:
    assert sum(t.count for t in tallies.values()) == COUNT
    assert [t.crashed for t in tallies.values() if t.crashed] == []
    assert [t.silent for t in tallies.values() if t.silent] == []
    elsewhere = [line for t in tallies.values() for line in t.elsewhere]
    assert len(elsewhere) <= (1 - BAR) * COUNT, elsewhere
