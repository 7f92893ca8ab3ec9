"""What came of importing one file, compiling it back and comparing it with what its own engine says of the original."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

MASS, LIMIT, POSE = 1e-6, 1e-5, 1e-5
"""Relative for masses and mass matrices; rad or m for limits and poses. Engines read text, some in single precision."""

FAULT = "the importer failed because of a bug"
"""How refusals read that nobody foresaw, see :mod:`simfoundry.frontends.errors`."""


@dataclass
class Outcome:
    """What became of one file.

    ``loads`` says whether its own engine takes it, ``refused`` why we do not, ``broke`` how a process ended. ``worst``
    are the largest errors by quantity, ``differing`` what is not equal, ``told`` what is not where the import says so.
    """

    corpus: str
    file: str
    format: str = ""
    loads: bool = True
    refused: str = ""
    broke: str = ""
    compared: Counter[str] = field(default_factory=Counter)
    worst: dict[str, float] = field(default_factory=dict)
    differing: list[str] = field(default_factory=list)
    told: list[str] = field(default_factory=list)
    seconds: float = 0.0

    def compare(self, quantity: str, ours: float, theirs: float, bar: float, what: str) -> None:
        """Compare two numbers that must not differ by more than ``bar``."""
        self.compared[quantity] += 1
        error = abs(ours - theirs)
        self.worst[quantity] = max(self.worst.get(quantity, 0.0), error)
        if not error <= bar:
            self.differing.append(f"{quantity} of {what}: {ours:.6g}, not {theirs:.6g}")

    def compare_matrices(
        self, ours: NDArray[np.float64], theirs: NDArray[np.float64], names: list[str], told: str = ""
    ) -> None:
        """Compare mass matrices, each element relative to the diagonal; ``told`` says why they may differ."""
        scale = np.sqrt(np.outer(np.diag(theirs), np.diag(theirs)))
        error = np.abs(ours - theirs) / np.where(scale > 0, scale, 1.0)
        self.compared["mass matrix"] += 1
        worst = float(error.max(initial=0.0))
        if not worst <= MASS:
            i, j = np.unravel_index(int(np.argmax(error)), error.shape)
            text = f"mass matrix at ({names[i]}, {names[j]}): {ours[i, j]:.6g}, not {theirs[i, j]:.6g}"
            (self.told if told else self.differing).append(f"{text} ({told})" if told else text)
        else:
            self.worst["mass matrix"] = max(self.worst.get("mass matrix", 0.0), worst)

    @property
    def is_fault(self) -> bool:
        """Whether something went wrong that nobody foresaw."""
        return bool(self.broke) or FAULT in self.refused

    @property
    def is_equal(self) -> bool:
        """Whether it came through, and is what it was."""
        return not (self.refused or self.broke or self.differing or self.told)

    @property
    def reason(self) -> str:
        """Why it was refused, without the names and numbers of this file."""
        text = re.sub(r"`[^`]*`", "`…`", self.broke or self.refused)
        text = re.sub(r"(/[\w.+-]+){2,}", "PATH", text)
        text = re.sub(r"'[^']*'|\"[^\"]*\"", "'…'", text)
        return re.sub(r"[-+]?\d[\d.e+-]*", "N", text).strip(" :")[:110]
