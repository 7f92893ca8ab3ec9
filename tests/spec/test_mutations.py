"""A sample of the corruptions of `tests.corpora.mutations`: none crashes, none passes, nearly all are pointed at."""

from __future__ import annotations

from tests.corpora.mutations import BAR, corrupt


def test_corruptions_are_found_where_they_are() -> None:
    tallies, _ = corrupt(300, seed=1)
    assert sum(t.count for t in tallies.values()) == 300
    assert [t.crashed for t in tallies.values() if t.crashed] == []
    assert [t.silent for t in tallies.values() if t.silent] == []
    elsewhere = [line for t in tallies.values() for line in t.elsewhere]
    assert len(elsewhere) <= (1 - BAR) * 300, elsewhere
