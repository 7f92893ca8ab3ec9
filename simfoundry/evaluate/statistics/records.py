"""Finished rollouts on disk, one file each, so that a run that is stopped goes on where it was.

``rollouts/TASK/POLICY/ENGINE/007.json`` tells what came of a rollout, ``007.npz`` holds its actions (``--policy
replay:…`` takes it), ``007.webm`` its video. A rollout whose policy did not answer is ``007.missing.json``: it has no
result and is tried again. One whose policy answered with something invalid has a result: it has failed.
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
from simfoundry.evaluate.policies.base import ActionSpace
from simfoundry.evaluate.rollouts.rollout import Rollout, RolloutEnd
from simfoundry.runtime.files import write_atomically

VERSION = "rollout/2"
_MISSING = ".missing.json"
MOST_BYTES = 16 * 2**20


@dataclass(frozen=True)
class RecordSlot:
    """The place of one rollout below the folder of an evaluation."""

    folder: Path
    task: str
    policy: str
    engine: str
    index: int

    @property
    def path(self) -> Path:
        """The file that says it is done."""
        return self.folder / "rollouts" / self.task / self.policy / self.engine / f"{self.index:03d}.json"

    @property
    def missing(self) -> Path:
        """The file that says why it is not."""
        return self.path.with_suffix(_MISSING)

    @property
    def video(self) -> Path:
        """Its video."""
        return self.path.with_suffix(".webm")

    def read(self) -> dict[str, Any] | None:
        """Read the record, None if there is none; raises :class:`OutputError` for a file that is none of ours."""
        return read_record(self.path) if self.path.is_file() else None

    def write(self, result: Rollout, about: Mapping[str, Any], space: ActionSpace) -> dict[str, Any]:
        """Write a rollout with what else is to be known ``about`` it; the file that says it is done comes last."""
        record = record_of(result, about)
        if result.end is RolloutEnd.NO_ANSWER:
            write_atomically(self.missing, _text(record))
            return record
        stored = io.BytesIO()
        np.savez_compressed(stored, actions=result.actions, action_space=np.array(str(space)))
        write_atomically(self.path.with_suffix(".npz"), stored.getvalue())
        write_atomically(self.path, _text(record))
        self.missing.unlink(missing_ok=True)
        return record

    def write_missing(self, reason: str, about: Mapping[str, Any]) -> dict[str, Any]:
        """Write that the policy could not even be opened for this rollout, with what is to be known ``about`` it."""
        found = {"index": self.index, "success": False, "end": str(RolloutEnd.NO_ANSWER), "reason": reason, "steps": 0}
        record = {"simfoundry": VERSION, **about, **found, "subtasks": {}}
        write_atomically(self.missing, _text(record))
        return record


def record_of(result: Rollout, about: Mapping[str, Any]) -> dict[str, Any]:
    """A rollout as plain data."""
    return {
        "simfoundry": VERSION,
        **about,
        "index": result.index,
        "seed": result.seed,
        "success": result.success,
        "end": str(result.end),
        "reason": result.reason,
        "steps": result.steps,
        "subtasks": dict(result.subtasks),
        "chunks": result.chunks,
        "trajectory": result.digest,
        "timings": {key: round(value, 4) for key, value in vars(result.timings).items()},
    }


def is_result(record: Mapping[str, Any]) -> bool:
    """True if a record has a result; a policy that did not answer has none."""
    return bool(record["end"] != RolloutEnd.NO_ANSWER)


def read_record(path: Path) -> dict[str, Any]:
    """A file that :meth:`Slot.write` wrote; raises :class:`OutputError` for any other."""
    try:
        if path.stat().st_size > MOST_BYTES:
            raise ValueError("too large")
        record = json.loads(path.read_text(encoding="utf-8"))
        if record["simfoundry"] != VERSION or not isinstance(record["index"], int):
            raise ValueError("not a rollout")
    except (ValueError, KeyError, TypeError, RecursionError):
        raise OutputError(f"{path} is no record of a rollout; move it away, or write to another folder") from None
    return dict(record)


def check_layout(folder: Path) -> None:
    """Raise :class:`OutputError` where an earlier version wrote rollouts, which would neither be read nor replaced."""
    for path in (folder / "rollouts").glob("*/*/*.json"):
        raise OutputError(
            f"{path} was written by an earlier version, which kept no folder for each engine; write to another folder"
        )


def read_all(folder: Path) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Every rollout of an evaluation with its file, in the order of the names: the missing ones too, by their ``end``.

    Raises :class:`OutputError` for a file that is none of ours, or that an earlier version laid out differently.
    """
    check_layout(folder)
    for path in sorted((folder / "rollouts").glob("*/*/*/*.json")):
        if not path.name.endswith(_MISSING) or not path.with_name(path.name.replace(_MISSING, ".json")).exists():
            yield path, read_record(path)


def _text(record: Mapping[str, Any]) -> bytes:
    return (json.dumps(record, indent=1, ensure_ascii=False) + "\n").encode()
