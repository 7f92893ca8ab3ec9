"""Doors to two servers that do not speak ``bundle/1``: OpenAI's image editing, and Hunyuan3D's mesh generation."""

from __future__ import annotations

import base64
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from simfoundry.models.contract import ConventionError, ModelError
from simfoundry.models.provenance import ModelIdentity, find_licence
from simfoundry.models.tasks.depth import Pixels
from simfoundry.models.tasks.images import ImageEstimate, decoded_image, encoded_image
from simfoundry.models.tasks.meshes import MeshEstimate, parse_glb
from simfoundry.models.transports.http import TIMEOUT_S, refused, request_bytes


def post(url: str, server: str, timeout_s: float = TIMEOUT_S, **content: Any) -> bytes:
    """Send a POST request and return the body of a successful response.

    Raises:
        ModelError: If the server does not respond, or responds with an error status.
    """
    response = request_bytes("POST", url, server, timeout_s, **content)
    if not 200 <= response.status < 300:
        raise refused(response, server, url)
    return response.body


# First bytes of the image formats that servers may return.
PNG = b"\x89PNG\r\n\x1a\n"
JPEG = b"\xff\xd8\xff"

# Environment variables with the URL, name and API key of the image model; the key is not stored anywhere else.
IMAGES_URL, IMAGES_MODEL, IMAGES_KEY = "SIMFOUNDRY_IMAGES_URL", "SIMFOUNDRY_IMAGES_MODEL", "SIMFOUNDRY_IMAGES_KEY"


@dataclass(frozen=True)
class HttpImages:
    """An image editor behind the OpenAI images API, ``POST {url}/images/edits``, which several servers implement.

    See https://platform.openai.com/docs/api-reference/images/createEdit. The request is a multipart form with up to 16
    images as ``image[]``. Setting ``background`` to ``transparent`` requires an ``output_format`` of png or webp. Only
    GPT image models accept these two parameters. They return ``data[0].b64_json`` and reject ``response_format``.
    OpenAI's client documents the same behavior:
    https://www.rubydoc.info/github/openai/openai-ruby/OpenAI/Resources/Images:edit
    """

    url: str
    model: str
    key: str = ""
    timeout_s: float = TIMEOUT_S

    @property
    def identity(self) -> ModelIdentity:
        """The model, as far as it is known: the API does not state a version or a licence."""
        return _identity(self.model)

    def edit_image(self, prompt: str, images: Sequence[Pixels], seed: int = 0) -> ImageEstimate:
        """Edit an image; see :class:`ImageEditingModel`. The API takes no seed."""
        made = self.edit(prompt, [encoded_image(image) for image in images])
        return ImageEstimate(decoded_image(made), self.identity)

    def edit(self, prompt: str, pictures: Sequence[bytes]) -> bytes:
        """Edit the first of ``pictures`` (PNG or JPEG), and return the result with a transparent background.

        Raises:
            ModelError: If the model did not return an image.
        """
        if not pictures:
            raise ModelError("the image model requires an image to edit")
        fields = {"model": self.model, "prompt": prompt, "background": "transparent", "output_format": "png", "n": "1"}
        files = [("image[]", _form_file(k, picture)) for k, picture in enumerate(pictures)]
        headers = {"Accept": "application/json"} | ({"Authorization": f"Bearer {self.key}"} if self.key else {})
        url = f"{self.url.rstrip('/')}/images/edits"
        answer = post(url, "the image model", self.timeout_s, data=fields, files=files, headers=headers)
        return _picture(answer, self.url)


def images_from_environment(environment: Mapping[str, str] | None = None, model: str | None = None) -> HttpImages:
    """Return the image model configured in the environment. If ``model`` is given, it overrides the model name.

    Raises:
        ModelError: If an environment variable is missing.
    """
    env = os.environ if environment is None else environment
    missing = [name for name in (IMAGES_URL, IMAGES_MODEL) if not (env.get(name) or (name == IMAGES_MODEL and model))]
    if missing:
        message = f"no image model is configured: set {' and '.join(missing)}, and {IMAGES_KEY} if a key is required"
        raise ModelError(message)
    return HttpImages(env[IMAGES_URL], model or env[IMAGES_MODEL], env.get(IMAGES_KEY, ""))


def _identity(name: str) -> ModelIdentity:
    entry = find_licence(name)
    return ModelIdentity(name=name, version="unknown", licence="unknown" if entry is None else entry.weights)


def _form_file(k: int, data: bytes) -> tuple[str, bytes, str]:
    """Return the file name, data and media type of an image."""
    if data.startswith(PNG):
        return f"picture_{k}.png", data, "image/png"
    if data.startswith(JPEG):
        return f"picture_{k}.jpg", data, "image/jpeg"
    raise ModelError("images for the image model must be PNG or JPEG")


def _picture(answer: bytes, url: str) -> bytes:
    try:
        data = base64.b64decode(json.loads(answer)["data"][0]["b64_json"], validate=True)
    except (ValueError, KeyError, IndexError, TypeError):
        raise ModelError(f"the image model at {url} did not return an image in data[0].b64_json") from None
    if not data.startswith((PNG, JPEG)):
        raise ModelError(f"the image model at {url} returned data that is neither PNG nor JPEG")
    return data


MESHES_URL = "SIMFOUNDRY_MESHES_URL"  # Environment variable with the URL of the mesh model

GLB = b"glTF"  # first bytes of a binary glTF file

SEEDS = 2**32  # Exclusive upper bound on the seeds that servers accept


# Both versions report every failure, such as exhausted memory, with status 404.
TEXTURE_HINT = (
    "its log states the reason (Hunyuan3D-2 makes textures only if it was started with --enable_tex; Hunyuan3D-2.1 has "
    "no such option and always can); to do without textures, set `texture: false` in the recipe's `models`"
)


@dataclass(frozen=True)
class HttpMeshes:
    """A mesh model behind the API of Hunyuan3D-2's ``api_server.py``, where ``POST {url}/generate`` returns a GLB file.

    The API is defined in https://github.com/Tencent-Hunyuan/Hunyuan3D-2/blob/main/api_server.py for Hunyuan3D-2 and in
    https://github.com/Tencent-Hunyuan/Hunyuan3D-2.1/blob/main/api_models.py for Hunyuan3D-2.1. The fields are ``image``
    in base64, ``seed`` below 2^32, ``texture`` and, only with texture, ``face_count`` from 1,000 to 100,000. Only
    Hunyuan3D-2 accepts ``type``, but both versions return a GLB file by default. Hunyuan3D-2 makes textures only if it
    was started with ``--enable_tex``; Hunyuan3D-2.1 has no such option. All failures are reported with status 404.
    ``faces`` is the number of triangles to keep.
    """

    url: str
    texture: bool = True
    faces: int = 20_000
    timeout_s: float = TIMEOUT_S

    @property
    def identity(self) -> ModelIdentity:
        """The model, as far as it is known: the API does not state its version, 2 or 2.1."""
        return _identity("hunyuan3d-2")

    def make_mesh(self, image: Pixels, texture: bool = True, faces: int = 20_000, seed: int = 0) -> MeshEstimate:
        """Reconstruct an object; see :class:`MeshModel`."""
        glb = replace(self, texture=texture, faces=faces).make(encoded_image(image), seed)
        try:
            return MeshEstimate(glb, parse_glb(glb), self.identity)
        except ConventionError as error:
            raise ModelError(f"the answer of the mesh model at {self.url} {error}") from None

    def make(self, picture: bytes, seed: int) -> bytes:
        """Generate a mesh from a PNG with a transparent background.

        Returns:
            A GLB with y up and arbitrary units.

        Raises:
            ModelError: If the model did not return a usable mesh.
        """
        image = base64.b64encode(picture).decode()
        fields = {
            "image": image,
            "seed": seed % SEEDS,
            "texture": self.texture,
            "face_count": self.faces,
            "type": "glb",
        }
        try:
            url = f"{self.url.rstrip('/')}/generate"
            data = post(url, "the mesh model", self.timeout_s, json=fields)
        except ModelError as error:
            if self.texture and " 404 " in str(error):
                raise ModelError(f"{error}; {TEXTURE_HINT}") from None
            raise
        if not data.startswith(GLB):
            raise ModelError(f"the mesh model at {self.url} returned data that is not a GLB")
        return data


def meshes_from_environment(environment: Mapping[str, str] | None = None, texture: bool = True) -> HttpMeshes:
    """Return the mesh model configured in the environment.

    Raises:
        ModelError: If the environment variable is missing.
    """
    env = os.environ if environment is None else environment
    if not env.get(MESHES_URL):
        raise ModelError(f"no mesh model is configured: set {MESHES_URL} to the URL of a server with Hunyuan3D-2's API")
    return HttpMeshes(env[MESHES_URL], texture)
