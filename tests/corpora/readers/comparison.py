"""Comparison of what a reader returns with what was written. It needs numpy only, and no SimFoundry."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np


class Expected:
    """What was written: the values and images of each episode, the sentences and the statistics."""

    def __init__(self, folder: Path) -> None:
        about = json.loads((folder / "expected.json").read_text(encoding="utf-8"))
        self.fps: float = about["fps"]
        self.features: dict[str, dict[str, Any]] = about["features"]
        self.splits: dict[str, list[int]] = about["splits"]
        self.episodes: list[dict[str, Any]] = about["episodes"]
        self.statistics: dict[str, dict[str, Any]] = about["statistics"]
        self._folder = folder
        self._open: tuple[int, dict[str, Any]] | None = None

    def values(self, episode: int) -> dict[str, Any]:
        """The arrays of an episode by feature, time first, and ``final/FEATURE`` after the last action."""
        if self._open is None or self._open[0] != episode:
            with np.load(self._folder / f"{episode:06d}.npz") as stored:
                self._open = episode, {name: stored[name] for name in stored.files}
        return self._open[1]

    def names(self, *kinds: str) -> list[str]:
        """The features of some kinds: ``array``, ``video``, ``image``, ``depth`` and ``mask``."""
        return [name for name, one in self.features.items() if one["kind"] in kinds]


class Report:
    """Named checks, each with its worst figure."""

    def __init__(self) -> None:
        self.checks: dict[str, dict[str, Any]] = {}

    def equal(self, name: str, found: Any, wanted: Any) -> None:
        """Require equality of arrays or plain values."""
        if isinstance(wanted, np.ndarray):
            found = np.asarray(found)
            good = found.shape == wanted.shape and bool((found == wanted).all())
            shown = f"{found.dtype}{found.shape}, not {wanted.dtype}{wanted.shape}"
        else:
            good, shown = found == wanted, f"{found!r}, not {wanted!r}"
        self._note(name, good, "equal", "" if good else shown)

    def close(self, name: str, found: Any, wanted: Any, tolerance: float) -> None:
        """Require arrays to be close; the largest difference is reported."""
        found, wanted = np.asarray(found, np.float64), np.asarray(wanted, np.float64)
        error = float(np.abs(found - wanted).max()) if found.shape == wanted.shape else float("inf")
        self._note(name, error <= tolerance, "max error", error)

    def at_least(self, name: str, found: float, bound: float) -> None:
        """Require a number to be at least a bound; the smallest is reported."""
        self._note(name, found >= bound, "min", found)

    def _note(self, name: str, good: bool, measure: str, figure: Any) -> None:
        check = self.checks.setdefault(name, {"ok": True, "count": 0, "measure": measure, "figure": figure})
        check["count"] += 1
        if measure == "max error":
            check["figure"] = max(float(check["figure"]), figure)
        elif measure == "min":
            check["figure"] = min(check["figure"], figure)
        elif not good and check["ok"]:
            check["figure"] = figure
        check["ok"] = bool(check["ok"] and good)


def psnr(found: Any, wanted: Any) -> float:
    """The peak signal-to-noise ratio of an image with values from 0 to 255 [dB]."""
    error = float(np.mean((np.asarray(found, np.float64) - np.asarray(wanted, np.float64)) ** 2))
    return 99.0 if error == 0 else 10 * float(np.log10(255.0**2 / error))


def main(check: Callable[[Path, Expected, Report], str]) -> None:
    """Run a check of DATASET against EXPECTED, the arguments, and print its outcome as the last line in JSON."""
    report = Report()
    reader = check(Path(sys.argv[1]), Expected(Path(sys.argv[2])), report)
    print(json.dumps({"reader": reader, "checks": report.checks}))
