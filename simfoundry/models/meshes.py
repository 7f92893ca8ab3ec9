"""Models that make a mesh of a picture, behind one method."""

from __future__ import annotations

import base64
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from simfoundry.models.web import SECONDS, ModelError, post

URL = "SIMFOUNDRY_MESHES_URL"
"""The variable of the environment that says where the mesh model is."""

GLB = b"glTF"

SEEDS = 2**32
"""Servers take seeds below this."""


class MeshMaker(Protocol):
    """Makes meshes of pictures."""

    def make(self, picture: bytes, seed: int) -> bytes:
        """A GLB, y up, in any unit, of what a PNG with a transparent background shows; raises :class:`ModelError`."""
        ...


@dataclass(frozen=True)
class HttpMeshes:
    """A mesh model behind the API of Hunyuan3D-2's ``api_server.py``: ``POST {url}/generate`` answers with a GLB.

    https://github.com/Tencent-Hunyuan/Hunyuan3D-2/blob/main/api_server.py, and Hunyuan3D-2.1 with the fields of
    https://github.com/Tencent-Hunyuan/Hunyuan3D-2.1/blob/main/api_models.py: ``image`` in base64, ``seed`` below 2^32,
    ``texture`` and, only with it, ``face_count`` from 1,000 to 100,000; ``type`` is known to the first only, and both
    make a GLB by default. Painting needs a server started with ``--enable_tex``; whatever fails is answered with 404.
    ``faces`` is how many triangles are kept.
    """

    url: str
    texture: bool = True
    faces: int = 20_000
    seconds: float = SECONDS

    def make(self, picture: bytes, seed: int) -> bytes:
        """The mesh of a picture."""
        asked = {
            "image": base64.b64encode(picture).decode(),
            "seed": seed % SEEDS,
            "texture": self.texture,
            "face_count": self.faces,
            "type": "glb",
        }
        headers = {"Content-Type": "application/json"}
        try:
            data = post(
                f"{self.url.rstrip('/')}/generate", json.dumps(asked).encode(), headers, "the mesh model", self.seconds
            )
        except ModelError as error:
            if self.texture and " 404 " in str(error):
                hint = "; was it started with --enable_tex? without it, say `texture: false` of the recipe's `models`"
                raise ModelError(f"{error}{hint}") from None
            raise
        if not data.startswith(GLB):
            raise ModelError(f"the mesh model at {self.url} answered with something that is no GLB")
        return data


def meshes_from_environment(environment: Mapping[str, str] | None = None, texture: bool = True) -> HttpMeshes:
    """The mesh model that the environment names; a :class:`ModelError` says what is missing."""
    env = os.environ if environment is None else environment
    if not env.get(URL):
        raise ModelError(f"no mesh model: set {URL} to the address of a server with Hunyuan3D-2's API")
    return HttpMeshes(env[URL], texture)
