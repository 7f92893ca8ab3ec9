"""Content-addressed disk cache for expensive results that depend only on their key.

It can be deleted at any time, and its size is limited: least recently read entries are removed first. Entries are
written atomically, so that any number of processes can share the cache.
"""

from __future__ import annotations

import hashlib
import os
import time
from dataclasses import dataclass
from pathlib import Path

from simfoundry.runtime.files import write_atomically

MAX_BYTES = 2 * 2**30
"""Largest size of a cache [bytes]: the convex parts of about ten thousand meshes."""

SHELVES = 256
"""Number of folders of a cache, by the first two digits of the keys; each may use its share of the bytes."""

UNREAD_S = 24 * 3600.0
"""Interval in which repeated reads of an entry do not update its access time."""


@dataclass(frozen=True)
class Cache:
    """Bytes by key below ``folder``, at most ``most`` in total; entries are written atomically and never change."""

    folder: Path
    most: int = MAX_BYTES

    @classmethod
    def default(cls) -> Cache:
        """Return the user's cache: ``$SIMFOUNDRY_CACHE``, else below ``$XDG_CACHE_HOME``, else below ``~/.cache``."""
        own = os.environ.get("SIMFOUNDRY_CACHE")
        if own:
            return cls(Path(own))
        base = os.environ.get("XDG_CACHE_HOME")
        return cls((Path(base) if base else Path.home() / ".cache") / "simfoundry")

    def get(self, key: str) -> bytes | None:
        """Return the bytes stored under ``key``, or None."""
        path = self._path(key)
        try:
            data = path.read_bytes()
            if time.time() - path.stat().st_mtime > UNREAD_S:
                os.utime(path)
        except OSError:
            return None
        return data

    def put(self, key: str, data: bytes) -> None:
        """Store ``data`` unless it is too large; write errors are ignored."""
        path = self._path(key)
        if len(data) > self.most // SHELVES:
            return
        try:
            write_atomically(path, data)
            _trim(path.parent, self.most // SHELVES)
        except OSError:
            return

    def _path(self, key: str) -> Path:
        return self.folder / key[:2] / key


def _trim(shelf: Path, most: int) -> None:
    """Remove least recently read entries until at most ``most`` bytes remain, and leftovers of killed writes."""
    kept = 0
    with os.scandir(shelf) as entries:
        found = [(entry.stat().st_mtime, entry.stat().st_size, entry.path) for entry in entries]
    for changed, size, path in sorted(found, reverse=True):
        kept += size
        half_written = Path(path).name.startswith(".") and time.time() - changed > UNREAD_S
        if kept > most or half_written:
            Path(path).unlink(missing_ok=True)


def key_of(*parts: bytes | str) -> str:
    """Return the key of a computation: a hash of all its inputs."""
    h = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        h.update(len(data).to_bytes(8, "little") + data)
    return h.hexdigest()
