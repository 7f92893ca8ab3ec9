"""Counts of triangles and points that a mesh file states in its head or its lines, before it is read."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from simfoundry.assets.errors import MAX_BYTES, MAX_FACES, MeshError, too_large

MAX_POINTS = 3 * MAX_FACES
"""Three to a triangle are the most that it needs."""

STL_HEAD, STL_FACE = 84, 50
"""Bytes of a binary STL before its triangles, and of each (the format has 80 of comment, 4 of count, 50 a facet)."""

PLY_HEAD = 100_000
"""Bytes in which the head of a PLY ends: splats with all harmonics need 2 kB."""
PLY_ELEMENT = re.compile(rb"^element[ \t]+(vertex|face)[ \t]+(\S+)", re.MULTILINE)
GLB_TRIANGLES = 4
"""The mode of a primitive that is a list of triangles; it is also the default (glTF 2.0, 3.7.2.1)."""


def check_counts(path: Path) -> None:
    """Raise :class:`MeshError` for a mesh file with more bytes, triangles or points than are read.

    Damaged files pass: whoever reads them says what is wrong.
    """
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise too_large(path.name, size)
    triangles, points = _COUNTERS.get(path.suffix.lower(), _unknown)(path)
    if triangles > MAX_FACES:
        raise MeshError("SF301", f"{path.name} has {triangles} triangles; at most {MAX_FACES} are read", "decimate it")
    if points > MAX_POINTS:
        raise MeshError("SF301", f"{path.name} has {points} points; at most {MAX_POINTS} are read", "decimate it")


def _unknown(_path: Path) -> tuple[int, int]:
    return 0, 0


def _stl(path: Path) -> tuple[int, int]:
    with path.open("rb") as stream:
        head = stream.read(STL_HEAD)
        count = int.from_bytes(head[80:], "little")
        if STL_HEAD + STL_FACE * count == path.stat().st_size:
            return count, 0
        return _lines(path, b"facet normal"), 0


def _obj(path: Path) -> tuple[int, int]:
    return _lines(path, b"\nf "), _lines(path, b"\nv ")


def _lines(path: Path, start: bytes) -> int:
    """The count of lines with this start; those at the seam of two blocks are missed."""
    count = 0
    with path.open("rb") as stream:
        while block := stream.read(2**24):
            count += block.count(start)
    return count


def _ply(path: Path) -> tuple[int, int]:
    with path.open("rb") as stream:
        head = stream.read(PLY_HEAD).partition(b"end_header")[0]
    said = {name: int(count) for name, count in PLY_ELEMENT.findall(head) if count.isdigit() and len(count) < 40}
    return said.get(b"face", 0), said.get(b"vertex", 0)


def _glb(path: Path) -> tuple[int, int]:
    """The triangles and the points of all primitives, as often as nodes show them."""
    try:
        with path.open("rb") as stream:
            head = stream.read(20)
            binary = head[:4] == b"glTF"
            text = stream.read(int.from_bytes(head[12:16], "little")) if binary else head + stream.read()
        tree = json.loads(text)
        counts = [int(accessor["count"]) for accessor in tree["accessors"]]
        meshes = [[_primitive(part, counts) for part in mesh["primitives"]] for mesh in tree["meshes"]]
        shown = [meshes[node["mesh"]] for node in tree.get("nodes", []) if "mesh" in node] or meshes
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, RecursionError):
        return 0, 0
    return sum(n for mesh in shown for n, _ in mesh), sum(n for mesh in shown for _, n in mesh)


def _primitive(part: Any, counts: list[int]) -> tuple[int, int]:
    points = counts[part["attributes"]["POSITION"]]
    corners = counts[part["indices"]] if "indices" in part else points
    return corners // 3 if part.get("mode", GLB_TRIANGLES) == GLB_TRIANGLES else 0, points


_COUNTERS: dict[str, Callable[[Path], Any]] = {".stl": _stl, ".obj": _obj, ".ply": _ply, ".glb": _glb, ".gltf": _glb}
