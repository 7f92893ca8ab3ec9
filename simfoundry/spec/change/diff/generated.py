"""Names of copies and of included members that follow the name of the repeated object or the include."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

# Sections whose members an included scene may define.
_INCLUDED = ("objects", "robots", "cameras", "lights", "materials", "frames")

# Keys of a member that is complete, as opposed to an entry that changes a copy or a member of an included scene.
_COMPLETE = frozenset(("shape", "asset", "like", "repeat", "model", "size", "type"))

_NAME = re.compile("[a-z][a-z0-9_]*")


def generated_names(
    data: Any, section: tuple[str, ...], old: str, new: str
) -> Iterator[tuple[tuple[str, ...], str, str]]:
    """Yield the section, old name and new name of each generated member in ``data``.

    Members are generated if ``section`` contains a repeated object or an include called ``old``.
    """
    if section not in (("objects",), ("include",)) or not isinstance(data, dict):
        return
    own = data.get(section[0])
    source = own.get(old) if isinstance(own, dict) else None
    repeated = section == ("objects",)
    if not isinstance(source, dict) or (repeated and "repeat" not in source):
        return
    if not repeated and "pose" in source:  # the include is also a frame
        yield ("frames",), old, new
    pattern = re.compile(re.escape(old) + ("(?:_[0-9]+)+" if repeated else "_[a-z0-9_]+"))
    for word in sorted({word for word in _words(data) if pattern.fullmatch(word)}):
        for place in ("objects",) if repeated else _INCLUDED:
            members = data.get(place)
            entry = members.get(word) if isinstance(members, dict) else None
            if not (isinstance(entry, dict) and entry.keys() & _COMPLETE):
                yield (place,), word, new + word.removeprefix(old)


def _words(data: Any) -> Iterator[str]:
    """Yield every word in the keys and strings of a document."""
    if isinstance(data, dict):
        for key, item in data.items():
            yield from _NAME.findall(key)
            yield from _words(item)
    elif isinstance(data, tuple | list):
        for item in data:
            yield from _words(item)
    elif isinstance(data, str):
        yield from _NAME.findall(data)
