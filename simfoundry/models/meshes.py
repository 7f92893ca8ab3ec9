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


class MeshMaker(Protocol):
    """Makes meshes of pictures."""

    def make(self, picture: bytes, seed: int) -> bytes:
        """A GLB, y up, in any unit, of what a PNG with a transparent background shows; raises :class:`ModelError`."""
        ...


@dataclass(frozen=True)
class HttpMeshes:
    """A mesh model behind the API of Hunyuan3D-2's ``api_server.py``: ``POST {url}/generate`` answers with a GLB.

    https://github.com/Tencent-Hunyuan/Hunyuan3D-2; ``faces`` is how many triangles are kept.
    """

    url: str
    texture: bool = True
    faces: int = 20_000
    seconds: float = SECONDS

    def make(self, picture: bytes, seed: int) -> bytes:
        """The mesh of a picture."""
        asked = {
            "image": base64.b64encode(picture).decode(),
            "seed": seed,
            "texture": self.texture,
            "face_count": self.faces,
            "type": "glb",
        }
        headers = {"Content-Type": "application/json"}
        data = post(
            f"{self.url.rstrip('/')}/generate", json.dumps(asked).encode(), headers, "the mesh model", self.seconds
        )
        if not data.startswith(GLB):
            raise ModelError(f"the mesh model at {self.url} answered with something that is no GLB")
        return data


def meshes_from_environment(environment: Mapping[str, str] | None = None) -> HttpMeshes:
    """The mesh model that the environment names; a :class:`ModelError` says what is missing."""
    env = os.environ if environment is None else environment
    if not env.get(URL):
        raise ModelError(f"no mesh model: set {URL} to the address of a server with Hunyuan3D-2's API")
    return HttpMeshes(env[URL])
