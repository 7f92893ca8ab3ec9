"""Findings of reconstructions name their place, and only their codes can be accepted."""

from __future__ import annotations

import pytest

from simfoundry.capture.findings import LEFT_OUT, MOVED, CaptureFinding, accepted_codes, ordered_findings
from simfoundry.errors import SimfoundryError


def test_places() -> None:
    assert CaptureFinding(MOVED, "tilted 9 deg", objects=("cup", "jug")).text() == "cup, jug: SF603 tilted 9 deg"
    assert CaptureFinding(LEFT_OUT, "x", outline=((4, 9), (2, 7))).place == "pixels [2, 7] to [4, 9]"
    assert CaptureFinding(LEFT_OUT, "x", outline=((4, 9),)).place == "pixel [4, 9]"
    assert CaptureFinding(LEFT_OUT, "x", "look").text() == "SF601 x\n  hint: look"


def test_findings_are_sorted_and_said_once() -> None:
    one, two = CaptureFinding(MOVED, "a", objects=("b",)), CaptureFinding(LEFT_OUT, "z")
    assert ordered_findings([one, two, CaptureFinding(MOVED, "a", objects=("b",))]) == (two, one)


def test_accepted_codes() -> None:
    assert accepted_codes(["sf603", "SF601", "SF603"]) == ("SF601", "SF603")
    for wrong in ("SF504", "SF699", ""):
        with pytest.raises(SimfoundryError, match="not a finding of a reconstruction"):
            accepted_codes([wrong])
