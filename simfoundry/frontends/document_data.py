"""What documents are written with: where their files go, digits of their numbers, poses and colours."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.frontends.draft import LinkDraft, MeshDraft, PartDraft, Rgba
from simfoundry.frontends.names import plain_name
from simfoundry.geometry.frames import Pose, rpy_from_quat
from simfoundry.spec.models.base import Model
from simfoundry.spec.yaml.tree import plain_tree
from simfoundry.spec.yaml.write import to_data, write_tree

DIGITS = 9
"""Significant digits of imported numbers: more than any simulator keeps, and no rounding noise."""


@dataclass
class Built:
    """Documents by file name, the asked-for one first, and other files; names are relative to the folder of it."""

    documents: dict[str, str] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    """What had to be renamed: the name in the file, qualified by its body, and the name in the documents."""
    parts: dict[tuple[str, str, str], tuple[LinkDraft, PartDraft]] = field(default_factory=dict)
    """By asset, link and part as the documents call them: what they were made from."""


@dataclass
class Shelf:
    """Where files go: into ``folder`` (relative to ``base``), or nowhere if they lie below ``root`` already."""

    base: Path
    folder: str
    root: Path | None
    files: dict[str, bytes] = field(default_factory=dict)
    taken: dict[int, str] = field(default_factory=dict)

    def place(self, mesh: MeshDraft) -> str:
        """The path of a mesh, relative to ``base``; equal files are stored once."""
        if (
            mesh.source is not None
            and self.root is not None
            and mesh.source.resolve().is_relative_to(self.root.resolve())
        ):
            return Path(os.path.relpath(mesh.source.resolve(), self.base.resolve())).as_posix()
        if id(mesh) not in self.taken:
            self.taken[id(mesh)] = self._store(mesh.files)
        return self.taken[id(mesh)].removeprefix("./")

    def _store(self, files: dict[str, bytes]) -> str:
        main = next(iter(files))
        for count in range(1, 100_000):
            place = self.folder if count == 1 else f"{self.folder}/{plain_name(Path(main).stem, 'mesh')}_{count}"
            wanted = {f"{place}/{name}": data for name, data in files.items()}
            if all(self.files.get(name, data) == data for name, data in wanted.items()):
                self.files |= wanted
                return f"{place}/{main}"
        raise AssertionError("no free name")


def rounded(value: Any) -> Any:
    """Plain data with its numbers at :data:`DIGITS` significant digits."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") + 0.0
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return tuple(rounded(item) for item in value)
    return value


def text_of(spec: Model, comment: str = "") -> str:
    """The canonical text of a document, with all digits of its numbers."""
    tree = plain_tree(rounded(to_data(spec)))
    lines = "".join(f"# {line}".rstrip() + "\n" for line in comment.splitlines())
    return lines + write_tree(tree, type(spec))


def pose_data(X_AB: Pose) -> dict[str, Any]:
    """A pose as a document writes it: the plainest of the rotations that say it."""
    out: dict[str, Any] = {}
    if np.abs(X_AB.p).max() > 1e-12:
        out["xyz"] = tuple(float(v) for v in X_AB.p)
    if abs(abs(X_AB.q[0]) - 1) < 1e-15 or np.abs(X_AB.q[1:]).max() < 1e-10:
        return out
    roll, pitch, yaw = (math.degrees(v) for v in rpy_from_quat(X_AB.q))
    if np.abs(X_AB.q[1:3]).max() < 1e-10:
        out["yaw_deg"] = yaw
    elif all(abs(v - round(v, 3)) < 1e-7 for v in (roll, pitch, yaw)):
        out["rpy_deg"] = (roll, pitch, yaw)
    else:
        out["quat_wxyz"] = tuple(float(v) for v in X_AB.q)
    return out


def color_data(color: Rgba) -> tuple[float, ...]:
    """A colour at the precision of a screen; single precision leaves noise behind that."""
    values = tuple(round(v, 4) for v in color)
    return values if values[3] < 1 else values[:3]
