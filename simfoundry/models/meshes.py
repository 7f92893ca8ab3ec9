"""Models that turn a picture into a mesh, behind a common method."""

from __future__ import annotations

import base64
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from simfoundry.models.web import TIMEOUT_S, ModelError, post

URL = "SIMFOUNDRY_MESHES_URL"
"""Environment variable with the address of the mesh model."""

GLB = b"glTF"

SEEDS = 2**32
"""Exclusive upper bound of the seeds that servers accept."""


class MeshMaker(Protocol):
    """Interface of models that make meshes from pictures."""

    def make(self, picture: bytes, seed: int) -> bytes:
        """Return a GLB, y up, any unit, of a PNG with a transparent background; raises :class:`ModelError`."""
        ...


@dataclass(frozen=True)
class HttpMeshes:
    """A mesh model behind the API of Hunyuan3D-2's ``api_server.py``: ``POST {url}/generate`` answers with a GLB.

    https://github.com/Tencent-Hunyuan/Hunyuan3D-2/blob/main/api_server.py, and Hunyuan3D-2.1 with the fields of
    https://github.com/Tencent-Hunyuan/Hunyuan3D-2.1/blob/main/api_models.py: ``image`` in base64, ``seed`` below 2^32,
    ``texture`` and, only with it, ``face_count`` from 1,000 to 100,000; only the first accepts ``type``, and both
    return a GLB by default. Texturing needs a server started with ``--enable_tex``; all failures are answered with 404.
    ``faces`` is the number of triangles to keep.
    """

    url: str
    texture: bool = True
    faces: int = 20_000
    timeout_s: float = TIMEOUT_S

    def make(self, picture: bytes, seed: int) -> bytes:
        """Return the mesh of a picture."""
        asked = {
            "image": base64.b64encode(picture).decode(),
            "seed": seed % SEEDS,
            "texture": self.texture,
            "face_count": self.faces,
            "type": "glb",
        }
        try:
            url = f"{self.url.rstrip('/')}/generate"
            data = post(url, "the mesh model", json=asked, timeout_s=self.timeout_s)
        except ModelError as error:
            if self.texture and " 404 " in str(error):
                hint = "; was it started with --enable_tex? otherwise set `texture: false` in the recipe's `models`"
                raise ModelError(f"{error}{hint}") from None
            raise
        if not data.startswith(GLB):
            raise ModelError(f"the mesh model at {self.url} answered with data that is not a GLB")
        return data


def meshes_from_environment(environment: Mapping[str, str] | None = None, texture: bool = True) -> HttpMeshes:
    """Return the mesh model that the environment names; raises :class:`ModelError` if the variable is missing."""
    env = os.environ if environment is None else environment
    if not env.get(URL):
        raise ModelError(f"no mesh model: set {URL} to the address of a server with Hunyuan3D-2's API")
    return HttpMeshes(env[URL], texture)
