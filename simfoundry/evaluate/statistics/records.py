"""Records of finished rollouts on disk.

There is one file per rollout, so an interrupted evaluation can be resumed. ``rollouts/TASK/POLICY/ENGINE/007.json``
contains the result of a rollout, ``007.npz`` its actions (for ``--policy replay:…``), and ``007.webm`` its video. A
rollout whose policy did not respond is recorded as ``007.missing.json``. It has no result and is tried again. A rollout
with an invalid response has a result and counts as a failure.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.errors import OutputError
from simfoundry.evaluate.rollouts.rollout import Rollout, RolloutEnd
from simfoundry.runtime.files import write_atomically
from simfoundry.spec.models.signals import ActionSpace

VERSION = "rollout/2"
_MISSING = ".missing.json"
MOST_BYTES = 16 * 2**20  # maximum size of a record to read; real records take a few kilobytes


@dataclass(frozen=True)
class RecordSlot:
    """The files of one rollout in the folder of an evaluation."""

    folder: Path
    task: str
    policy: str
    engine: str
    index: int

    @property
    def path(self) -> Path:
        """The file that contains the result."""
        return self.folder / "rollouts" / self.task / self.policy / self.engine / f"{self.index:03d}.json"

    @property
    def missing(self) -> Path:
        """The file that explains why the result is missing."""
        return self.path.with_suffix(_MISSING)

    @property
    def video(self) -> Path:
        """The video file."""
        return self.path.with_suffix(".webm")

    def read(self) -> dict[str, Any] | None:
        """Read the record.

        The result is None if the record does not exist.

        Raises:
            OutputError: If the file is not a record.
        """
        return read_record(self.path) if self.path.is_file() else None

    def write(self, result: Rollout, about: Mapping[str, Any], space: ActionSpace) -> dict[str, Any]:
        """Write a rollout and its context ``about``.

        The file that marks the rollout as finished is written last.
        """
        record = record_of(result, about)
        if result.end is RolloutEnd.NO_ANSWER:
            write_atomically(self.missing, _text(record))
            return record
        stored = io.BytesIO()
        np.savez_compressed(
            stored, actions=result.actions, action_space=np.array(str(space)), control_hz=np.array(result.action_hz)
        )
        write_atomically(self.path.with_suffix(".npz"), stored.getvalue())
        write_atomically(self.path, _text(record))
        self.missing.unlink(missing_ok=True)
        return record

    def write_missing(self, reason: str, about: Mapping[str, Any]) -> dict[str, Any]:
        """Record that the policy could not be opened for this rollout.

        The context ``about`` is also recorded.
        """
        found = {"index": self.index, "success": False, "end": str(RolloutEnd.NO_ANSWER), "reason": reason, "steps": 0}
        record = {"simfoundry": VERSION, **about, **found, "subtasks": {}}
        write_atomically(self.missing, _text(record))
        return record


def record_of(result: Rollout, about: Mapping[str, Any]) -> dict[str, Any]:
    """Return a rollout as plain data that can be written to its record file."""
    return {
        "simfoundry": VERSION,
        **about,
        **{key: getattr(result, key) for key in ("index", "seed", "success", "end", "reason", "steps")},
        "subtasks": dict(result.subtasks),
        "chunks": result.chunks,
        "trajectory": result.digest,
        "timings": {key: round(value, 4) for key, value in vars(result.timings).items()},
    }


def is_result(record: Mapping[str, Any]) -> bool:
    """Return True if a record contains a result.

    This requires that the policy responded.
    """
    return bool(record["end"] != RolloutEnd.NO_ANSWER)


def read_record(path: Path) -> dict[str, Any]:
    """Read a record.

    Raises:
        OutputError: If the file was not written by :class:`RecordSlot`.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise ValueError("too large")
        record = json.loads(path.read_text(encoding="utf-8"))
        if record["simfoundry"] != VERSION or not isinstance(record["index"], int):
            raise ValueError("not a rollout")
    except (ValueError, KeyError, TypeError, RecursionError):
        raise OutputError(f"{path} is not a rollout record; move it, or choose a different folder") from None
    return dict(record)


def check_layout(folder: Path) -> None:
    """Check that the folder contains no rollouts in the layout of an earlier version.

    Such rollouts would be neither read nor replaced.

    Raises:
        OutputError: If there is such a rollout.
    """
    for path in (folder / "rollouts").glob("*/*/*.json"):
        raise OutputError(
            f"{path} was written by an earlier version that did not use a separate folder per engine; "
            "choose a different folder"
        )


def read_all(folder: Path) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Yield every rollout of an evaluation, along with its file, ordered by file name.

    Missing rollouts are included. They are identified by their ``end``.

    Raises:
        OutputError: If a file is not a record, or if the folder has the layout of an earlier version.
    """
    check_layout(folder)
    for path in sorted((folder / "rollouts").glob("*/*/*/*.json")):
        if not path.name.endswith(_MISSING) or not path.with_name(path.name.replace(_MISSING, ".json")).exists():
            yield path, read_record(path)


def _text(record: Mapping[str, Any]) -> bytes:
    return (json.dumps(record, indent=1, ensure_ascii=False) + "\n").encode()
