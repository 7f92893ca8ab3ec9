"""The groups of an OBJ file: PyBullet makes a convex hull of each where a URDF collides with it."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np

from simfoundry.assets.mesh import MeshPart
from simfoundry.frontends.draft import MeshDraft
from simfoundry.frontends.meshes import mesh_of_parts
from simfoundry.frontends.names import plain_name

_GROUP = re.compile(rb"^[ \t]*[og][ \t]", re.MULTILINE)
"""Starts of lines at which Bullet's reader (tiny_obj_loader.cpp) starts a shape of its own; a bare `g` is none."""

Groups = list[tuple[str, list[tuple[int, int, int]]]]


def group_drafts(path: Path, scale: tuple[float, float, float]) -> list[tuple[str, MeshDraft]]:
    """A mesh [m] for each group of an OBJ that has several, by the group's name; none where it has one or none.

    None, too, for what is no sound OBJ, which is for the reader of meshes to say.
    """
    data = path.read_bytes() if path.suffix.lower() == ".obj" else b""
    if not _GROUP.search(data):
        return []
    try:
        points, groups = _groups(data.decode("utf-8", "replace"))
    except (ValueError, IndexError):
        return []
    if len(groups) < 2:
        return []
    vertices = np.array(points, dtype=np.float64).reshape(-1, 3) * scale
    out = []
    for k, (name, triangles) in enumerate(groups, 1):
        used, corners = np.unique(np.array(triangles, dtype=np.int64), return_inverse=True)
        faces = corners.reshape(-1, 3).astype(np.int32)
        part = MeshPart(vertices[used], faces if np.prod(scale) > 0 else np.ascontiguousarray(faces[:, ::-1]))
        out.append((name or f"group_{k}", mesh_of_parts([part], plain_name(f"{path.stem}_{k}", "mesh"))))
    return out


def _groups(text: str) -> tuple[list[list[float]], Groups]:
    """Vertices and, by group, triangles of an OBJ; groups without faces are left out."""
    points: list[list[float]] = []
    groups: Groups = [("", [])]
    for line in text.splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == "v":
            points.append([float(word) for word in words[1:4]])
        elif words[0] in ("o", "g") and len(words) > 1:
            groups.append((words[1], []))
        elif words[0] == "f":
            corners = [_vertex(word, len(points)) for word in words[1:]]
            groups[-1][1].extend((corners[0], a, b) for a, b in pairwise(corners[1:]))
    return points, [(name, triangles) for name, triangles in groups if triangles]


def _vertex(word: str, count: int) -> int:
    """The index of the vertex that a corner names, from 1 or, where it is negative, from the last before it."""
    number = int(word.partition("/")[0])
    index = number - 1 if number > 0 else count + number
    if not 0 <= index < count:
        raise IndexError(word)
    return index
