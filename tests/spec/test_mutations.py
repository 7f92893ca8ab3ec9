"""A sample of the corruptions of `tests.corpora.mutations`: none crashes, none passes, nearly all are pointed at."""

from __future__ import annotations

import pytest

from tests.corpora.mutations import BAR, Tally, corrupt
from tests.corpora.reuse_errors import corrupt_reuse

counts = pytest.mark.parametrize("count", [120, pytest.param(300, marks=pytest.mark.slow)])


@counts
def test_corruptions_are_found_where_they_are(count: int) -> None:
    _judge(corrupt(count, seed=1)[0], count)


@pytest.mark.slow  # 3 s
@counts
def test_corruptions_of_reuse_are_found_where_a_person_wrote_them(count: int) -> None:
    tallies = corrupt_reuse(count, seed=1)[0]
    _judge(tallies, count)
    assert sum(t.later for t in tallies.values()) <= (1 - BAR) * count, "by the first error"


def _judge(tallies: dict[str, Tally], count: int) -> None:
    assert sum(t.count for t in tallies.values()) == count
    assert [t.crashed for t in tallies.values() if t.crashed] == []
    assert [t.silent for t in tallies.values() if t.silent] == []
    elsewhere = [line for t in tallies.values() for line in t.elsewhere]
    assert len(elsewhere) <= (1 - BAR) * count, elsewhere
