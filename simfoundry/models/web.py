"""Requests to servers of models: bounded in time and size, and what went wrong in one sentence."""

from __future__ import annotations

import urllib.error
import urllib.request
from collections.abc import Mapping

from simfoundry.errors import SimfoundryError

SECONDS = 300.0
"""A generator of meshes takes a minute or two."""

MOST_BYTES = 256 * 2**20
"""No picture and no mesh that can be used is larger."""


class ModelError(SimfoundryError):
    """A model gave no answer that can be used; the message says which, why, and what to do."""


def post(
    url: str, body: bytes, headers: Mapping[str, str], what: str, seconds: float = SECONDS, most: int = MOST_BYTES
) -> bytes:
    """The body of the answer to a POST. ``what`` names the server in errors, as `the image model`.

    Raises :class:`ModelError` for an address that is none, no answer in ``seconds``, a status other than success, and
    more than ``most`` bytes.
    """
    if not url.startswith(("http://", "https://")):
        raise ModelError(f"{what} needs an address that starts with http:// or https://, not `{url}`")
    request = urllib.request.Request(url, data=body, headers=dict(headers), method="POST")
    try:
        with urllib.request.urlopen(request, timeout=seconds) as answer:
            data: bytes = answer.read(most + 1)
    except urllib.error.HTTPError as error:
        said = " ".join(error.read(300).decode(errors="replace").split())
        raise ModelError(f"{what} at {url} answered {error.code} {error.reason}: {said}") from None
    except (urllib.error.URLError, TimeoutError, OSError, ValueError) as error:
        reason = getattr(error, "reason", None) or error
        raise ModelError(
            f"{what} at {url} does not answer ({reason}); is it running, and is the address right?"
        ) from None
    if len(data) > most:
        raise ModelError(f"{what} at {url} answered with more than {most // 2**20} MiB")
    return data
