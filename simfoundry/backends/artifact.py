"""Backend output: the files for one target, the compilation losses, and number formatting for text files."""

from __future__ import annotations

import hashlib
import json
import json.encoder
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from simfoundry.backends.features import FEATURES, Cells
from simfoundry.backends.losses import Loss
from simfoundry.geometry.frames import Array
from simfoundry.runtime.files import staged, write_file


@dataclass(frozen=True)
class Artifact:
    """The output for one target: files keyed by relative POSIX path, the entry file, and the compilation losses."""

    target: str
    entry: str
    files: Mapping[str, bytes]
    losses: tuple[Loss, ...] = ()

    def __post_init__(self) -> None:
        if wrong := [path for path, data in self.files.items() if not isinstance(data, bytes)]:
            raise TypeError(f"the content of {', '.join(wrong)} must be bytes")

    @property
    def manifest(self) -> bytes:
        """Return ``manifest.json``, which lists the target, its entry file and the SHA-256 of every file."""
        hashes = {path: hashlib.sha256(data).hexdigest() for path, data in sorted(self.files.items())}
        return json_text({"target": self.target, "entry": self.entry, "files": hashes})

    def write(self, folder: Path) -> None:
        """Write all files to ``folder``, replacing the folder atomically.

        An interrupted write leaves the old folder intact.
        """
        with staged(folder) as staging:
            for path, data in {**self.files, "manifest.json": self.manifest}.items():
                write_file(staging / path, data)


def json_text(data: Mapping[str, object]) -> bytes:
    """Format data as a JSON file with one line per key.

    This applies to the keys of the top-level mapping and of its direct children.
    """
    return ("{\n" + ",\n".join([f"  {_entry(key, value)}" for key, value in data.items()]) + "\n}\n").encode()


def _entry(key: str, value: object) -> str:
    if isinstance(value, Mapping) and value:
        inside = ",\n".join([f"    {json_string(name)}: {json_line(item)}" for name, item in value.items()])
        return f"{json_string(key)}: {{\n{inside}\n  }}"
    return f"{json_string(key)}: {json_line(value)}"


# Encode a string as JSON.
json_string: Callable[[str], str] = json.encoder.encode_basestring


def json_line(value: object) -> str:
    """Format plain data as a single line of JSON."""
    return "".join(_chunks(value, 0))


# The encoder that ``json.JSONEncoder(ensure_ascii=False)`` would construct for each call; reusing it is faster.
_chunks: Callable[[object, int], Iterable[str]] = json.encoder.c_make_encoder(  # type: ignore[attr-defined]
    None, None, json_string, None, ": ", ", ", False, False, True
)


@lru_cache(maxsize=16384)  # a scene contains few distinct numbers, and every target writes the same ones
def number(value: float) -> str:
    """Format a number with twelve significant digits to hide rounding differences between CPUs.

    Magnitudes below 1e-100, far below any quantity in a scene, become zero because some readers reject denormal
    numbers.
    """
    return f"{value:.12g}" if abs(value) > 1e-100 else "0"


@lru_cache(maxsize=16384)
def rounded(value: float) -> float:
    """Round a number to the value that :func:`number` writes, because the last bits of a double differ between CPUs."""
    return float(number(value))


def numbers(values: Array | Iterable[float]) -> str:
    """Format values with :func:`number`, separated by spaces, flattening arrays in row-major order."""
    return " ".join(map(number, values.ravel().tolist() if isinstance(values, np.ndarray) else values))


def rounded_list(values: Array) -> list[float]:
    """Return the :func:`rounded` values of an array in row-major order."""
    return [rounded(v) for v in np.asarray(values).ravel().tolist()]


# Errors of this size [1] come from converting numbers between frames and units in double precision.
NOISE = 5e-16


def exact(value: float) -> str:
    """Format a number with all digits that are not rounding noise, so that reading the text returns the number.

    A number that is within this noise of a short decimal, such as most numbers that people write, becomes that decimal.
    """
    tolerance = NOISE * max(1.0, abs(value))
    for digits in (6, 12):
        text = f"{value:.{digits}g}"
        if abs(float(text) - value) <= tolerance:
            return "0" if float(text) == 0 or abs(value) <= NOISE else text
    return repr(float(value))


def exacts(values: Array | Iterable[float]) -> str:
    """Format values with :func:`exact`, separated by spaces."""
    return " ".join(exact(float(v)) for v in values)


@dataclass(frozen=True)
class Backend:
    """A compiler for one format.

    ``compile(scene, **options)`` returns an :class:`Artifact`. Its keyword parameters are the options that a target
    profile can set. ``features`` maps each feature to its fidelity, except for ``collision_shape``, which is the same
    in all backends.
    """

    compile: Callable[..., Artifact]
    features: Cells

    def __post_init__(self) -> None:
        if missing := FEATURES.keys() - {*self.features, "collision_shape"}:
            raise ValueError(f"`features` has no entry for {', '.join(sorted(missing))}")
