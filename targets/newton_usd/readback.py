"""The Newton session for USD builds, which opens a build with the loader of the ``newton_usd`` target."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom

from simfoundry.geometry.frames import Pose
from simfoundry.runtime.plugins import import_file
from simfoundry.verify import readback as rb

_newton = import_file(Path(__file__).parents[1] / "newton" / "session.py")
_usd = import_file(Path(__file__).parents[1] / "usd" / "readback.py")
"""The session of the ``newton`` target, with the names of links and joints in the stage."""


def open_build(folder: Path, loader: ModuleType) -> rb.Session:
    """Return a session with the surfaces' own coefficients, because Newton does not support combine modes."""
    _newton.quiet()
    session: rb.Session = _newton.NewtonSession(loader.load(), _names(loader.open_stage()))
    return session


def _names(stage: Usd.Stage) -> Any:
    names = {str(prim.GetPath()): name for name, prim in _usd.links(stage).items()}
    cache = UsdGeom.XformCache()
    poses = {name: _pose(prim, cache) for name, prim in _usd.links(stage).items()}

    def collider(label: str) -> tuple[str, str] | None:
        link, _, name = label.partition("/Colliders/")
        return (names[link], name) if name and link in names else None

    def joint(label: str) -> str | None:
        parts = label.split("/")
        return f"{parts[3]}.{parts[5]}" if len(parts) == 6 and parts[5] != "Anchor" else None

    def link(path: str) -> str:
        return str(names.get(path, path))  # a robot in its own file keeps its own names

    return _newton.Names(link, collider, joint, poses, custom=False)


def _pose(prim: Usd.Prim, cache: UsdGeom.XformCache) -> Pose:
    return Pose.from_matrix(np.array(cache.GetLocalToWorldTransform(prim)).T)
