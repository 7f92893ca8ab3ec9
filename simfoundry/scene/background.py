"""Visual surroundings of a scene, read from a file: a mesh or a splat without collisions."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from simfoundry.assets.errors import MeshError
from simfoundry.assets.mesh import read_parts
from simfoundry.assets.splat import read_splat
from simfoundry.geometry.frames import Pose
from simfoundry.geometry.frames import frozen_array as frozen
from simfoundry.geometry.shapes import Mesh
from simfoundry.scene.bodies import GRAY
from simfoundry.scene.model import Background, Visual
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.loaded import Loaded
from simfoundry.spec.models import scene as spec


def lower_background(loaded: Loaded, written: spec.BackgroundSpec, X_WB: Pose) -> Background:
    """Return the background of a scene; raises :class:`SpecError` if its file cannot be used."""
    key = "mesh" if written.mesh is not None else "splat"
    path = loaded.file(written.mesh or written.splat or "")
    try:
        if key == "splat":
            return Background(X_WB, splat=read_splat(path, written.scale))
        return Background(X_WB, visuals=tuple(_visuals(path, written.scale)))
    except MeshError as error:
        raise SpecError([loaded.finding(error.code, ("background", key), str(error), error.hint)]) from None


def _visuals(path: Path, scale: float) -> Iterator[Visual]:
    """Visual pieces of a mesh file: textures are used unchanged, and pieces without a color are gray."""
    pieces = read_parts(path, scale)
    for k, piece in enumerate(pieces):
        faces = np.array(piece.faces, dtype=np.int32)
        faces.setflags(write=False)
        uv = None if piece.uv is None else frozen(piece.uv)
        color = piece.rgba or (GRAY if piece.texture is None else (1.0, 1.0, 1.0, 1.0))
        mesh = Mesh(frozen(piece.vertices), faces, uv, piece.texture)
        yield Visual("mesh" if len(pieces) == 1 else f"mesh_{k}", mesh, frozen(color))
