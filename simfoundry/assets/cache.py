"""A content-addressed disk cache for expensive results that depend only on their key.

The cache can be deleted at any time. When the cache exceeds its size limit, the least recently read entries are
evicted. Entries are written atomically, so any number of processes can share the cache.
"""

from __future__ import annotations

import hashlib
import os
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from simfoundry.runtime.files import write_atomically

# Maximum cache size [bytes]; enough for the convex parts of about ten thousand meshes.
MAX_BYTES = 2 * 2**30

# Number of folders in a cache, one for each value of a key's first two digits. The size limit is split evenly.
SHELVES = 256

# Minimum age [s] of an entry's access time before another read updates it.
UNREAD_S = 24 * 3600.0


@dataclass(frozen=True)
class Cache:
    """A key-value store of bytes in ``folder``, limited to ``most`` bytes in total.

    Entries are written atomically and never change.
    """

    folder: Path
    most: int = MAX_BYTES

    @classmethod
    def default(cls) -> Cache:
        """Return the user's cache.

        The cache folder is ``$SIMFOUNDRY_CACHE`` if it is set, and otherwise a subfolder of ``$XDG_CACHE_HOME`` or
        ``~/.cache``.
        """
        own = os.environ.get("SIMFOUNDRY_CACHE")
        if own:
            return cls(Path(own))
        base = os.environ.get("XDG_CACHE_HOME")
        return cls((Path(base) if base else Path.home() / ".cache") / "simfoundry")

    def get(self, key: str) -> bytes | None:
        """Return the bytes stored under ``key``, or None if there is no entry."""
        path = self._path(key)
        try:
            data = path.read_bytes()
            if time.time() - path.stat().st_mtime > UNREAD_S:
                os.utime(path)
        except OSError:
            return None
        return data

    def put(self, key: str, data: bytes) -> None:
        """Store ``data`` under ``key`` unless it is too large. Write errors are ignored."""
        path = self._path(key)
        if len(data) > self.most // SHELVES:
            return
        with suppress(OSError):
            write_atomically(path, data)
            _trim(path.parent, self.most // SHELVES)

    def _path(self, key: str) -> Path:
        return self.folder / key[:2] / key


def _trim(shelf: Path, most: int) -> None:
    """Remove leftovers from interrupted writes.

    If more than ``most`` bytes remain, evict the least recently read entries.
    """
    kept = 0
    with os.scandir(shelf) as entries:
        found = [(entry.stat().st_mtime, entry.stat().st_size, entry.path) for entry in entries]
    for changed, size, path in sorted(found, reverse=True):
        kept += size
        half_written = Path(path).name.startswith(".") and time.time() - changed > UNREAD_S
        if kept > most or half_written:
            Path(path).unlink(missing_ok=True)


def key_of(*parts: bytes | str) -> str:
    """Return the cache key of a computation, which is a hash of all inputs."""
    h = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        h.update(len(data).to_bytes(8, "little") + data)
    return h.hexdigest()
