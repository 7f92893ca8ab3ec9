"""The cache keeps what was read last, stays small, and is safe to share."""

from __future__ import annotations

import os
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from simfoundry.assets.cache import SHELVES, UNREAD_S, Cache, key_of
from tests.cli.command import python


def test_what_was_not_read_for_longest_goes_first(tmp_path: Path) -> None:
    cache = Cache(tmp_path, most=SHELVES * 100)
    keys = [f"ab{k}" for k in range(3)]
    for age, key in zip((30, 20, 10), keys, strict=True):
        cache.put(key, b"x" * 30)
        then = time.time() - age * UNREAD_S
        os.utime(tmp_path / "ab" / key, (then, then))
    assert cache.get(keys[0]) == b"x" * 30  # read: it counts as new
    cache.put("ab3", b"y" * 30)
    assert [cache.get(k) is not None for k in (*keys, "ab3")] == [True, False, True, True]
    cache.put("cd0", b"z" * 100)  # on another shelf
    assert cache.get("ab3") is not None


def test_what_is_too_large_is_not_kept(tmp_path: Path) -> None:
    cache = Cache(tmp_path, most=SHELVES * 100)
    cache.put("ab0", b"x" * 100)
    cache.put("ab1", b"x" * 101)
    assert (cache.get("ab0"), cache.get("ab1")) == (b"x" * 100, None)


def test_what_killed_writes_left_goes(tmp_path: Path) -> None:
    left = tmp_path / "ab" / ".ab0.half"
    left.parent.mkdir()
    left.write_bytes(b"half")
    Cache(tmp_path).put("ab1", b"whole")
    assert left.exists()  # it may be in the making
    then = time.time() - 2 * UNREAD_S
    os.utime(left, (then, then))
    Cache(tmp_path).put("ab2", b"whole")
    assert sorted(p.name for p in left.parent.iterdir()) == ["ab1", "ab2"]


SHARE = """
import sys
from pathlib import Path
from simfoundry.assets.cache import Cache
cache, me = Cache(Path(sys.argv[1]), most=256 * 40_000), sys.argv[2]
for k in range(300):
    key = f"ab{k % 7}"
    found = cache.get(key)
    assert found is None or found == key.encode() * 5000, (me, key, len(found))
    cache.put(key, key.encode() * 5000)
"""


def test_processes_share_it(tmp_path: Path) -> None:
    """Two shelves' worth of entries in one, so that each process removes what the others write."""
    with ThreadPoolExecutor(3) as pool:
        for done in pool.map(lambda me: python(SHARE, tmp_path, me), "abc"):
            assert (done.code, done.err) == (0, "")
    assert sum(p.stat().st_size for p in tmp_path.rglob("*") if p.is_file()) <= 40_000


def test_a_cache_that_cannot_be_written_is_none(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    cache = Cache(tmp_path / "file")
    cache.put("ab0", b"x")
    assert cache.get("ab0") is None


def test_keys_differ_where_parts_are_cut_elsewhere() -> None:
    assert len({key_of("ab", "c"), key_of("a", "bc"), key_of("abc"), key_of(b"abc", b"")}) == 4
