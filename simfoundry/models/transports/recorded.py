"""Answers recorded in a folder, named by the digest of their request: a cache of answers, and the data of tests."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simfoundry.models.contract import ModelError
from simfoundry.models.wire import ANSWER, MAX_BUNDLE_BYTES, BundleError, read_bundle


def recording(folder: Path, digest: str) -> Path:
    """Return the path of the answer to a request."""
    return folder / f"{digest}.zip"


def read_recording(path: Path) -> bytes:
    """Return a recorded answer.

    Raises:
        ModelError: If the file is too large or cannot be read.
    """
    if path.stat().st_size > MAX_BUNDLE_BYTES:
        raise ModelError(f"{path} is larger than {MAX_BUNDLE_BYTES // 2**20} MiB")
    return path.read_bytes()


@dataclass(frozen=True)
class RecordedTransport:
    """A folder of recorded answers, as ``{digest}.zip``. Other requests have no answer."""

    folder: Path

    @property
    def place(self) -> str:
        """The folder."""
        return str(self.folder)

    def exchange(self, task: str, digest: str, data: bytes) -> bytes:
        """Return the recorded answer."""
        path = recording(self.folder, digest)
        if not path.is_file():
            raise ModelError(
                f"{self.folder} contains no answer to this request for `{task}` ({digest[:12]}…); to record one, "
                "configure the `url` or `command` of the model and this folder as `record`"
            )
        return read_recording(path)

    def describe(self) -> Mapping[str, Any]:
        """Return the models whose answers are recorded."""
        tasks: dict[str, Any] = {}
        for path in sorted(self.folder.glob("*.zip")):
            try:
                head = read_bundle(read_recording(path), ANSWER).head
            except BundleError as error:
                raise ModelError(f"{path} {error}") from None
            entry = tasks.setdefault(str(head.get("task")), {"model": head.get("model"), "recorded": 0})
            entry["recorded"] += 1
        if not tasks:
            raise ModelError(f"{self.folder} contains no recorded answers")
        return {"bundle": 1, "tasks": tasks}
