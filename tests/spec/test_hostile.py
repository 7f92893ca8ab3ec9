"""Documents that were made to do harm are refused with a finding, in bounded memory."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.corpora.hostile import CASES, MEGABYTES, refuse


@pytest.mark.parametrize("make", CASES, ids=lambda make: make.__name__)
def test_it_is_refused(make: Callable[[Path], None]) -> None:
    done = refuse(make)
    assert done.refused, done.text[-2000:]
    assert done.megabytes <= MEGABYTES
