"""Image editing models behind a common method: a prompt and pictures in, one picture out."""

from __future__ import annotations

import base64
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from simfoundry.models.web import TIMEOUT_S, ModelError, post

PNG = b"\x89PNG\r\n\x1a\n"
JPEG = b"\xff\xd8\xff"

URL, MODEL, KEY = "SIMFOUNDRY_IMAGES_URL", "SIMFOUNDRY_IMAGES_MODEL", "SIMFOUNDRY_IMAGES_KEY"
"""Environment variables with the address, the name and the key of the image model; the key is stored nowhere else."""


class ImageEditor(Protocol):
    """Interface of models that edit pictures."""

    def edit(self, prompt: str, pictures: Sequence[bytes]) -> bytes:
        """Return a PNG edited from the first of ``pictures`` (PNG or JPEG); raises :class:`ModelError`."""
        ...


@dataclass(frozen=True)
class HttpImages:
    """Editor behind the OpenAI images API: ``POST {url}/images/edits``, which several servers implement.

    https://platform.openai.com/docs/api-reference/images/createEdit: multipart, up to 16 pictures as ``image[]``;
    ``background: transparent`` requires ``output_format`` png or webp, and only GPT image models accept these two; they
    answer with ``data[0].b64_json`` and reject ``response_format``. OpenAI's own client documents the same:
    https://www.rubydoc.info/github/openai/openai-ruby/OpenAI/Resources/Images:edit
    """

    url: str
    model: str
    key: str = ""
    timeout_s: float = TIMEOUT_S

    def edit(self, prompt: str, pictures: Sequence[bytes]) -> bytes:
        """Return the edited picture, with a transparent background."""
        if not pictures:
            raise ModelError("the image model needs a picture to edit")
        fields = {"model": self.model, "prompt": prompt, "background": "transparent", "output_format": "png", "n": "1"}
        files = [("image[]", _form_file(k, picture)) for k, picture in enumerate(pictures)]
        headers = {"Accept": "application/json"} | ({"Authorization": f"Bearer {self.key}"} if self.key else {})
        url = f"{self.url.rstrip('/')}/images/edits"
        answer = post(url, "the image model", form=fields, files=files, headers=headers, timeout_s=self.timeout_s)
        return _picture(answer, self.url)


def images_from_environment(environment: Mapping[str, str] | None = None, model: str | None = None) -> HttpImages:
    """Return the image model that the environment names, or ``model`` on its server.

    Raises :class:`ModelError` if a variable is missing.
    """
    env = os.environ if environment is None else environment
    missing = [name for name in (URL, MODEL) if not (env.get(name) or (name == MODEL and model))]
    if missing:
        message = f"no image model: set {' and '.join(missing)}, and {KEY} where the server wants a key"
        raise ModelError(message)
    return HttpImages(env[URL], model or env[MODEL], env.get(KEY, ""))


def _form_file(k: int, data: bytes) -> tuple[str, bytes, str]:
    """Return the file name, data and media type of a picture."""
    if data.startswith(PNG):
        return f"picture_{k}.png", data, "image/png"
    if data.startswith(JPEG):
        return f"picture_{k}.jpg", data, "image/jpeg"
    raise ModelError("pictures for the image model must be PNG or JPEG")


def _picture(answer: bytes, url: str) -> bytes:
    try:
        data = base64.b64decode(json.loads(answer)["data"][0]["b64_json"], validate=True)
    except (ValueError, KeyError, IndexError, TypeError):
        raise ModelError(f"the image model at {url} answered without a picture in data[0].b64_json") from None
    if not data.startswith((PNG, JPEG)):
        raise ModelError(f"the image model at {url} answered with data that is neither PNG nor JPEG")
    return data
