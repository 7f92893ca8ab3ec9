"""What a backend returns: the files of one target and the losses on the way, and how they reach the disk."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from simfoundry.files import staged


class Fidelity(StrEnum):
    """What became of a field of the scene in a target."""

    APPROXIMATED = "approximated"
    DROPPED = "dropped"


@dataclass(frozen=True)
class Loss:
    """One field that a target cannot hold exactly: which (``cup.restitution``), what became of it, and why.

    ``feature`` is the row of the support matrix that it belongs to, where the path does not say it already.
    """

    path: str
    fidelity: Fidelity
    reason: str
    feature: str = ""


@dataclass(frozen=True)
class Artifact:
    """The files of one target by relative POSIX path, its entry file, and what it could not keep."""

    target: str
    entry: str
    files: Mapping[str, bytes]
    losses: tuple[Loss, ...] = ()

    @property
    def manifest(self) -> bytes:
        """``manifest.json``: the target, its entry and the SHA-256 of every file."""
        hashes = {path: hashlib.sha256(data).hexdigest() for path, data in sorted(self.files.items())}
        return _json({"target": self.target, "entry": self.entry, "files": hashes})

    def write(self, folder: Path) -> None:
        """Write everything below ``folder``, replacing what was there in one step: a killed write leaves the old."""
        with staged(folder) as staging:
            for path, data in {**self.files, "manifest.json": self.manifest}.items():
                target = staging / path
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(data)


def _json(data: object) -> bytes:
    return (json.dumps(data, indent=2, ensure_ascii=False) + "\n").encode()


def number(value: float) -> str:
    """A number for a text format: twelve significant digits, so that the last bits of a CPU do not show.

    What is smaller than any quantity of ours is zero: readers refuse the denormal numbers that rounding leaves.
    """
    text = format(float(value) if abs(value) > 1e-100 else 0.0, ".12g")
    return "0" if text == "-0" else text


def numbers(values: object) -> str:
    """Space-separated :func:`number` of each value of an iterable or array, flattened."""
    import numpy as np

    return " ".join(number(v) for v in np.asarray(values, dtype=np.float64).ravel())
