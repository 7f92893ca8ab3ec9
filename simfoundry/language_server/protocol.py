"""The protocol of messages, with answers to requests that are not of the protocol."""

from __future__ import annotations

from typing import Any
from urllib.parse import urlsplit

from lsprotocol import types
from pygls.exceptions import JsonRpcException, JsonRpcInvalidParams, JsonRpcMethodNotFound
from pygls.protocol import LanguageServerProtocol


class Protocol(LanguageServerProtocol):
    """A protocol that also answers requests whose parameters have wrong types, so that no client waits for ever."""

    def structure_message(self, data: dict[str, Any]) -> Any:
        """Convert the data of a message to its type.

        Raises:
            JsonRpcException: If the data is not a message of the protocol.
        """
        try:
            if "method" in data and not _has_valid_uri(data.get("params")):
                raise JsonRpcInvalidParams
            return super().structure_message(data)
        except JsonRpcException as error:
            if "method" in data and isinstance(data.get("id"), int | str):
                self._send_response(data["id"], error=error.to_response_error())
            raise


class RequestFailedError(JsonRpcException):
    """Raised if a request is valid but cannot be met. Editors show the message to the user."""

    CODE = types.LSPErrorCodes.RequestFailed.value
    MESSAGE = "the request cannot be met"


def _has_valid_uri(params: object) -> bool:
    """Return False if parameters name a document by something that cannot be split as a URI."""
    document = params.get("textDocument") if isinstance(params, dict) else None
    uri = document.get("uri") if isinstance(document, dict) else None
    try:
        urlsplit(uri if isinstance(uri, str) else "")
    except ValueError:
        return False
    return True


def is_fault_of_client(error: Exception, source: object) -> bool:
    """Return True for a message that could not be read, or that asks for something that no server has to offer.

    Args:
        error: The error.
        source: What failed, as pygls states it: reading a message, or handling it.
    """
    return source is JsonRpcException or isinstance(error, JsonRpcMethodNotFound | RequestFailedError)
