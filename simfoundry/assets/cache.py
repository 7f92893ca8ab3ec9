"""A content-addressed cache on disk: results that are slow to compute and depend on nothing but their key."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

from simfoundry.files import write_atomically


@dataclass(frozen=True)
class Cache:
    """Bytes by key below ``folder``; entries are written in one step and never change."""

    folder: Path

    @classmethod
    def default(cls) -> Cache:
        """The cache of this user: ``$SIMFOUNDRY_CACHE``, else below ``$XDG_CACHE_HOME``, else below ``~/.cache``."""
        own = os.environ.get("SIMFOUNDRY_CACHE")
        if own:
            return cls(Path(own))
        base = os.environ.get("XDG_CACHE_HOME")
        return cls((Path(base) if base else Path.home() / ".cache") / "simfoundry")

    def get(self, key: str) -> bytes | None:
        """The bytes stored under ``key``, or None."""
        try:
            return self._path(key).read_bytes()
        except OSError:
            return None

    def put(self, key: str, data: bytes) -> None:
        """Store ``data``; a cache that cannot be written is no reason to fail."""
        try:
            write_atomically(self._path(key), data)
        except OSError:
            return

    def _path(self, key: str) -> Path:
        return self.folder / key[:2] / key


def key_of(*parts: bytes | str) -> str:
    """The key of a computation: a hash over what it depends on."""
    h = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        h.update(len(data).to_bytes(8, "little") + data)
    return h.hexdigest()
