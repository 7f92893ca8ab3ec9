"""Models that edit pictures, behind one method: a prompt and pictures in, one picture out."""

from __future__ import annotations

import base64
import json
import os
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from simfoundry.models.web import SECONDS, ModelError, post

PNG = b"\x89PNG\r\n\x1a\n"
JPEG = b"\xff\xd8\xff"

URL, MODEL, KEY = "SIMFOUNDRY_IMAGES_URL", "SIMFOUNDRY_IMAGES_MODEL", "SIMFOUNDRY_IMAGES_KEY"
"""Variables of the environment that say where the image model is, which, and the key, which is nowhere else."""


class ImageEditor(Protocol):
    """Edits pictures."""

    def edit(self, prompt: str, pictures: Sequence[bytes]) -> bytes:
        """A new PNG made of ``pictures``, PNG or JPEG, the first the one to change; raises :class:`ModelError`."""
        ...


@dataclass(frozen=True)
class HttpImages:
    """An editor behind the OpenAI images API: ``POST {url}/images/edits``, which several servers speak.

    https://platform.openai.com/docs/api-reference/images/createEdit: multipart, up to 16 pictures as ``image[]``;
    ``background: transparent`` wants ``output_format`` png or webp, and only GPT image models know these two; they
    answer with ``data[0].b64_json`` and refuse ``response_format``. As of its official client, which says the same:
    https://www.rubydoc.info/github/openai/openai-ruby/OpenAI/Resources/Images:edit
    """

    url: str
    model: str
    key: str = ""
    seconds: float = SECONDS

    def edit(self, prompt: str, pictures: Sequence[bytes]) -> bytes:
        """The edited picture, with a transparent background."""
        if not pictures:
            raise ModelError("the image model needs a picture to change")
        fields = {"model": self.model, "prompt": prompt, "background": "transparent", "output_format": "png", "n": "1"}
        body, kind = multipart(fields, [("image[]", *_file(k, p), p) for k, p in enumerate(pictures)])
        headers = {"Content-Type": kind, "Accept": "application/json"}
        if self.key:
            headers["Authorization"] = f"Bearer {self.key}"
        answer = post(f"{self.url.rstrip('/')}/images/edits", body, headers, "the image model", self.seconds)
        return _picture(answer, self.url)


def images_from_environment(environment: Mapping[str, str] | None = None, model: str | None = None) -> HttpImages:
    """The image model that the environment names, or ``model`` on its server; a :class:`ModelError` says what is
    missing.
    """
    env = os.environ if environment is None else environment
    missing = [name for name in (URL, MODEL) if not (env.get(name) or (name == MODEL and model))]
    if missing:
        message = f"no image model: set {' and '.join(missing)}, and {KEY} where the server wants a key"
        raise ModelError(message)
    return HttpImages(env[URL], model or env[MODEL], env.get(KEY, ""))


def multipart(fields: Mapping[str, str], files: Sequence[tuple[str, str, str, bytes]]) -> tuple[bytes, str]:
    """A multipart/form-data body (RFC 7578) and its content type; ``files`` are (field, file name, type, data)."""
    mark = uuid.uuid5(uuid.NAMESPACE_OID, json.dumps([dict(fields), [len(f[3]) for f in files]])).hex
    rows = []
    for name, value in fields.items():
        rows.append(f'--{mark}\r\nContent-Disposition: form-data; name="{name}"\r\n\r\n{value}\r\n'.encode())
    for name, file, kind, data in files:
        head = f'--{mark}\r\nContent-Disposition: form-data; name="{name}"; filename="{file}"\r\n'
        rows += [f"{head}Content-Type: {kind}\r\n\r\n".encode(), data, b"\r\n"]
    return b"".join([*rows, f"--{mark}--\r\n".encode()]), f"multipart/form-data; boundary={mark}"


def _file(k: int, data: bytes) -> tuple[str, str]:
    """A file name and the media type of a picture."""
    if data.startswith(PNG):
        return f"picture_{k}.png", "image/png"
    if data.startswith(JPEG):
        return f"picture_{k}.jpg", "image/jpeg"
    raise ModelError("pictures for the image model are PNG or JPEG")


def _picture(answer: bytes, url: str) -> bytes:
    try:
        data = base64.b64decode(json.loads(answer)["data"][0]["b64_json"], validate=True)
    except (ValueError, KeyError, IndexError, TypeError):
        raise ModelError(f"the image model at {url} answered without a picture in data[0].b64_json") from None
    if not data.startswith((PNG, JPEG)):
        raise ModelError(f"the image model at {url} answered with something that is no PNG and no JPEG")
    return data
