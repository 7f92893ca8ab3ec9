"""The results of stages in a work folder, each with the digests of what it was made from."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from simfoundry.capture.stages.codec import decode, encode
from simfoundry.capture.stages.stage import STAGES, Stage, stage_index
from simfoundry.runtime.files import staged, write_files

# File in the folder of each result that tells what the result was made from.
ENTRY = "stage.json"

# Hex digits of a key in the name of a folder; two results of one object in one stage practically never share them.
KEY_DIGITS = 8


@dataclass(frozen=True, eq=False)
class StageEntry:
    """A result in the work folder.

    ``label`` is the object of a per-object stage, and empty otherwise. ``digest`` identifies the content of the result.
    """

    label: str
    folder: Path
    files: Mapping[str, str]
    digest: str

    def load(self) -> Any:
        """Read the result.

        Raises:
            OSError, ValueError: A file is missing, damaged or edited.
        """
        content = {name: (self.folder / name).read_bytes() for name in self.files}
        for name, data in content.items():
            if hashlib.sha256(data).hexdigest() != self.files[name]:
                raise ValueError(f"{self.folder / name} was changed since it was written")
        return decode(content)


@dataclass
class StageStore:
    """Results of stages below ``folder``, one folder ``NN_stage`` for each stage.

    A stage that runs for each object has a folder ``NN_stage/OBJECT-KEY`` for each of them. Each result is written
    atomically. Results that no run used are removed by :meth:`prune`.
    """

    folder: Path
    used: set[Path] = field(default_factory=set)

    @cached_property
    def entries(self) -> dict[str, StageEntry]:
        """The results that were in the folder at first, by their keys."""
        found = {}
        for stage in STAGES:
            for path in sorted(stage_folder(self.folder, stage).glob("*/" + ENTRY if stage.per_object else ENTRY)):
                try:
                    data = json.loads(path.read_bytes())
                    files = {str(name): str(digest) for name, digest in data["files"].items()}
                    entry = StageEntry(str(data["object"]), path.parent, files, str(data["digest"]))
                    found[str(data["key"])] = entry
                except (OSError, ValueError, KeyError, TypeError, AttributeError):
                    continue
        return found

    def find(self, key: str) -> tuple[Any, str] | None:
        """Return the result with this key and its digest, or None if there is none or if its files were changed."""
        entry = self.entries.get(key)
        if entry is None:
            return None
        try:
            value = entry.load()
        except (OSError, ValueError, KeyError, TypeError, SyntaxError):
            return None
        self.used.add(entry.folder)
        return value, entry.digest

    def write(self, stage: Stage, label: str, key: str, inputs: Mapping[str, str], value: Any) -> str:
        """Write a result atomically, and return its digest."""
        files, digests, digest = encoded(value)
        record = {
            "stage": stage.name,
            "object": label,
            "version": stage.version,
            "key": key,
            "digest": digest,
            "inputs": dict(inputs),
            "files": digests,
        }
        folder = stage_folder(self.folder, stage)
        if stage.per_object:
            folder = folder / f"{label}-{key[:KEY_DIGITS]}"
        with staged(folder) as staging:
            write_files(staging, files)
            (staging / ENTRY).write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
        self.used.add(folder)
        return digest

    def prune(self) -> None:
        """Remove the results that were neither written nor read."""
        for stage in STAGES:
            folder = stage_folder(self.folder, stage)
            if stage.per_object and folder.is_dir():
                for path in sorted(folder.iterdir()):
                    if path not in self.used:
                        shutil.rmtree(path, ignore_errors=True)


def encoded(value: Any) -> tuple[dict[str, bytes], dict[str, str], str]:
    """Return the files of a result, their digests, and the digest of the entire result."""
    files = encode(value)
    digests = {name: hashlib.sha256(data).hexdigest() for name, data in sorted(files.items())}
    return files, digests, hashlib.sha256(json.dumps(digests).encode()).hexdigest()


def stage_folder(folder: Path, stage: Stage) -> Path:
    """Return the folder of a stage below the work folder."""
    return folder / f"{stage_index(stage.name) + 1:02}_{stage.name}"
