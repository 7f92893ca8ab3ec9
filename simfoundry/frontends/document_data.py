"""Values of imported documents: file paths, rounded numbers, poses, and colors."""

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
"""Significant digits of imported numbers: more than any simulator keeps, but without rounding noise."""

NO_LENGTH_M, NO_TURN = 1e-12, 1e-10
"""Positions [m] and parts of quaternions below these are rounding noise of double precision."""


@dataclass
class BuiltDocuments:
    """Documents by file name, the requested one first, and other files; names are relative to its folder."""

    documents: dict[str, str] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    """Renamed elements: the name in the file, qualified by its body, and the name in the documents."""
    parts: dict[tuple[str, str, str], tuple[LinkDraft, PartDraft]] = field(default_factory=dict)
    """Draft of each part, by the names of asset, link, and part in the documents."""


@dataclass
class FileShelf:
    """Files to be written into ``folder`` (relative to ``base``), except files that are already below ``root``."""

    base: Path
    folder: str
    root: Path | None
    files: dict[str, bytes] = field(default_factory=dict)
    taken: dict[int, str] = field(default_factory=dict)

    def place(self, mesh: MeshDraft) -> str:
        """Return the path of a mesh, relative to ``base``; equal files are stored once."""
        source = None if mesh.source is None else mesh.source.resolve()
        if source is not None and self.root is not None and source.is_relative_to(self.root.resolve()):
            return Path(os.path.relpath(source, self.base.resolve())).as_posix()
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
    """Return plain data with numbers rounded to :data:`DIGITS` significant digits."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") + 0.0
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    return tuple(map(rounded, value)) if isinstance(value, list | tuple) else value


def document_text(spec: Model) -> str:
    """Return the canonical text of a document, with all digits of its numbers."""
    return write_tree(plain_tree(rounded(to_data(spec))), type(spec))


def pose_data(X_AB: Pose) -> dict[str, Any]:
    """Return a pose as document data, with the simplest representation of its rotation."""
    out: dict[str, Any] = {}
    if np.abs(X_AB.p).max() > NO_LENGTH_M:
        out["xyz"] = tuple(X_AB.p.tolist())
    if abs(abs(X_AB.q[0]) - 1) < 1e-15 or np.abs(X_AB.q[1:]).max() < NO_TURN:
        return out
    rpy = tuple(math.degrees(v) for v in rpy_from_quat(X_AB.q))
    if np.abs(X_AB.q[1:3]).max() < NO_TURN:
        out["yaw_deg"] = rpy[2]
    elif all(abs(v - round(v, 3)) < 1e-7 for v in rpy):
        out["rpy_deg"] = rpy
    else:
        out["quat_wxyz"] = tuple(X_AB.q.tolist())
    return out


def color_data(color: Rgba) -> tuple[float, ...]:
    """Return a color rounded to display precision, which removes the noise of single precision."""
    values = tuple(round(v, 4) for v in color)
    return values if values[3] < 1 else values[:3]


def relative_path(file: Path, document: Path) -> str:
    """Return the path of a file relative to a document."""
    return Path(os.path.relpath(file.resolve(), document.resolve().parent)).as_posix()
