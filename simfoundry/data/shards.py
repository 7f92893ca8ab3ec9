"""Shards of recorded attempts: ZIP files with one JSON file and arrays in NumPy's format.

A shard contains consecutive attempts. Every attempt has an entry in ``shard.json``. Attempts that were kept also have
arrays in float64, such as ``000017/actions.npy``. Equal attempts give equal bytes. ``numpy.load`` reads the arrays.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.errors import OutputError
from simfoundry.evaluate.policies.codec import from_npy
from simfoundry.geometry.frames import Array
from simfoundry.runtime.files import write_atomically

FORMAT = "demonstrations/1"
_HEAD = "shard.json"

# Maximum uncompressed size of a shard to read [bytes]. A demonstration of 60 s takes about 1 MB.
LARGEST = 2**30


@dataclass(frozen=True, eq=False)
class Attempt:
    """The outcome of one attempt, in which the policy started from the initial state with the same index.

    Attributes:
        about: The entry in ``shard.json``. ``kept`` is True for a demonstration.
        arrays: The arrays of a demonstration, keyed by name; empty for other attempts.
    """

    about: Mapping[str, Any]
    arrays: Mapping[str, Array] = field(default_factory=dict)

    @property
    def index(self) -> int:
        """The index of the attempt and its initial state."""
        return int(self.about["index"])

    @property
    def is_kept(self) -> bool:
        """True if the attempt is a demonstration: it succeeded, and its replay was identical."""
        return bool(self.about["kept"])


def write_shard(path: Path, attempts: Iterable[Attempt]) -> None:
    """Write consecutive attempts atomically."""
    stored, listed = io.BytesIO(), list(attempts)
    with zipfile.ZipFile(stored, "w", zipfile.ZIP_DEFLATED) as files:
        head = {"simfoundry": FORMAT, "attempts": [dict(attempt.about) for attempt in listed]}
        _add(files, _HEAD, (json.dumps(head, indent=1, ensure_ascii=False) + "\n").encode())
        for attempt in listed:
            for name, array in attempt.arrays.items():
                data = io.BytesIO()
                np.lib.format.write_array(data, np.ascontiguousarray(array), allow_pickle=False)
                _add(files, f"{attempt.index:06d}/{name}.npy", data.getvalue())
    write_atomically(path, stored.getvalue())


def _add(files: zipfile.ZipFile, name: str, data: bytes) -> None:
    # ZipInfo has a fixed date, so that equal content gives equal bytes.
    files.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED)


def read_shard(path: Path, with_arrays: bool = True) -> list[Attempt]:
    """Read the attempts in a shard, with the arrays of demonstrations or without them.

    Raises:
        OutputError: If the file is not a shard.
    """
    try:
        with zipfile.ZipFile(path) as files:
            if sum(file.file_size for file in files.infolist()) > LARGEST:
                raise ValueError(f"its content exceeds {LARGEST // 2**20} MiB")
            head = json.loads(files.read(_HEAD), parse_constant=_refuse_constant)
            if head["simfoundry"] != FORMAT:
                raise ValueError(f"its format is {str(head['simfoundry'])[:40]}, not {FORMAT}")
            if not with_arrays:
                return [Attempt({**about, "kept": bool(about["kept"])}) for about in head["attempts"]]
            attempts = [Attempt(about, _arrays(files, int(about["index"]))) for about in head["attempts"]]
            if any(bool(attempt.about["kept"]) != bool(attempt.arrays) for attempt in attempts):
                raise ValueError("its arrays do not match its attempts")
    except OSError:
        raise
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, zipfile.BadZipFile, EOFError) as error:
        raise OutputError(f"{path} is not a shard of demonstrations: {error}; move it, and record again") from None
    return attempts


def _refuse_constant(text: str) -> float:
    raise ValueError(f"{text} is not a finite number")


def _arrays(files: zipfile.ZipFile, index: int) -> dict[str, Array]:
    start, found = f"{index:06d}/", {}
    for file in files.infolist():
        if file.filename.startswith(start) and file.filename.endswith(".npy"):
            array = from_npy(files.read(file))
            if array.dtype != np.float64 or not np.isfinite(array).all():
                raise ValueError(f"{file.filename} does not contain finite numbers in float64")
            array.setflags(write=False)
            found[file.filename.removeprefix(start).removesuffix(".npy")] = array
    return found
