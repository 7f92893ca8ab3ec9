"""HTTP requests to model servers: bounded in time and size; every failure becomes a one-sentence error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from simfoundry.errors import SimfoundryError

TIMEOUT_S = 300.0
"""Response timeout of a server [s]: mesh generators take a minute or two."""

MAX_BYTES = 256 * 2**20
"""Largest answer [bytes]: no usable picture or mesh is larger."""

MAX_QUOTE = 300
"""Length of a server's error text that is quoted [characters]: its first sentences."""

FormFile = tuple[str, tuple[str, bytes, str]]
"""A file of a multipart form: field, then file name, data and media type."""


class ModelError(SimfoundryError):
    """A model without a usable answer; the message states the model, the reason, and the remedy."""


def post(
    url: str,
    server: str,
    json: Mapping[str, Any] | None = None,
    form: Mapping[str, str] | None = None,
    files: Sequence[FormFile] = (),
    headers: Mapping[str, str] | None = None,
    timeout_s: float = TIMEOUT_S,
    max_bytes: int = MAX_BYTES,
) -> bytes:
    """Send a POST with a JSON body or a multipart form and return the body of the answer.

    ``server`` names the server in errors, such as `the image model`. Raises :class:`ModelError` for an address that is
    not HTTP, no answer within ``timeout_s``, an error status, and answers larger than ``max_bytes``.
    """
    import httpx

    if not url.startswith(("http://", "https://")):
        raise ModelError(f"{server} needs an address that starts with http:// or https://, not `{url}`")
    body: dict[str, Any] = {"json": json} if json is not None else {"data": form, "files": list(files)}
    try:
        with httpx.stream("POST", url, **body, headers=headers, timeout=timeout_s, follow_redirects=True) as answer:
            data = b""
            for chunk in answer.iter_bytes():
                data += chunk
                if len(data) > max_bytes:
                    raise ModelError(f"{server} at {url} answered with more than {max_bytes // 2**20} MiB")
    except (httpx.HTTPError, httpx.InvalidURL) as error:
        reason = str(error) or type(error).__name__
        raise ModelError(
            f"{server} at {url} does not answer ({reason}); is it running, and is the address right?"
        ) from None
    if not answer.is_success:
        quote = " ".join(data[:MAX_QUOTE].decode(errors="replace").split())
        raise ModelError(f"{server} at {url} answered {answer.status_code} {answer.reason_phrase}: {quote}")
    return data
