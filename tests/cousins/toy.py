"""A recipe without a simulator, for tests of runs: what becomes of a candidate is a function of its index alone."""

from __future__ import annotations

import os
import signal
import time

from simfoundry.cousins.recipe.candidate import Candidate, Reason

FUNCTION = "tests.cousins.toy:candidate"


def candidate(rate: float, index: int) -> Candidate:
    """Accepted at a rate that is even over the indices; every one takes a time of its own."""
    time.sleep((index * 7919 % 5) * 3e-4)
    share = index * 0.6180339887498949 % 1.0
    if share >= rate:
        code = "narrow" if index % 2 else "wide"
        return Candidate(index, reasons=(Reason(code, f"{share:.3f} is too {code}", {"share": share}),))
    return Candidate(index, {"scene": f"simfoundry: scene/1\nname: toy_{index}\n"}, (f"LeftOf(a{index}, b)",))


def fragile(mark: str, index: int) -> Candidate:
    """Candidate 3 kills its process the first time, candidate 5 every time, candidate 7 breaks."""
    if index == 5:
        os.kill(os.getpid(), signal.SIGKILL)
    if index == 3:
        try:
            os.close(os.open(mark, os.O_CREAT | os.O_EXCL))
            os.kill(os.getpid(), signal.SIGKILL)
        except FileExistsError:
            pass
    if index == 7:
        raise RuntimeError("seven")
    return candidate(1.0, index)
