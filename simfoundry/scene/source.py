"""Source document of a scene, stored unread so that a target can embed it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any


@dataclass(frozen=True)
class Source:
    """The document from which a scene was lowered.

    It is opaque to backends, which may store it but must not base decisions on it. ``kind`` is that of the document
    (``scene/1``), ``file`` is its path in its project, with ``/``. ``data`` is its plain data in canonical order,
    including everything that it extends: mappings, tuples, texts, numbers.
    """

    kind: str
    file: str
    data: Mapping[str, Any]

    @classmethod
    def of(cls, file: str, data: Mapping[str, Any]) -> Source:
        """Freeze the data of a document."""
        return cls(str(data["simfoundry"]), file, MappingProxyType(dict(data)))

    @property
    def digest(self) -> str:
        """SHA-256 of the data, in hex: equal documents have equal digests."""
        return hashlib.sha256(json.dumps(dict(self.data), ensure_ascii=False).encode()).hexdigest()
