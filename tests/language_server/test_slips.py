"""A sample of the slips of `tests.corpora.slips`: nearly all are underlined, and every suggestion is valid."""

from __future__ import annotations

import pytest

from tests.corpora.slips import BAR, run

COUNT, SEED = 24, 3


@pytest.mark.slow  # 8 s: a check of the document after each suggestion
def test_slips_are_underlined_and_suggestions_are_valid() -> None:
    tallies = run(COUNT, SEED)
    assert sum(t.count for t in tallies.values()) == COUNT and sum(t.fixes for t in tallies.values()) > COUNT / 4
    assert [line for t in tallies.values() for line in t.bad_fixes] == []
    unseen = [line for t in tallies.values() for line in t.unseen]
    assert len(unseen) <= max(1, (1 - BAR) * COUNT), unseen
