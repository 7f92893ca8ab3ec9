"""JSON files of bounded size."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from simfoundry.frontends.errors import ImportRefusedError

MAX_BYTES = 100_000_000
"""Largest file size [bytes], which bounds memory use; OmniGibson scenes have up to 3 MB."""


def read_json(path: Path) -> Any:
    """Return the content of a JSON file; raises :class:`ImportRefusedError`."""
    try:
        data = path.open("rb").read(MAX_BYTES + 1)
        if len(data) > MAX_BYTES:
            raise ImportRefusedError(path, f"it is larger than {MAX_BYTES // 1_000_000} MB")
        return json.loads(data)
    except OSError as error:
        raise ImportRefusedError(path, f"it cannot be read: {error.strerror}") from None
    except json.JSONDecodeError as error:
        raise ImportRefusedError(path, f"it is not JSON: {error.msg}", error.lineno) from None
    except (UnicodeDecodeError, RecursionError):
        raise ImportRefusedError(path, "it is not JSON") from None
