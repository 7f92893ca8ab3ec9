"""The document from which a scene was lowered."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Source:
    """The document from which a scene was lowered.

    Backends may store the source, but must not base any decisions on it.

    Attributes:
        file: The POSIX path of the document in its project.
        data: The plain data of the document and of everything that it extends, in canonical order. The data consists of
            mappings, tuples, strings and numbers.
    """

    file: str
    data: Mapping[str, Any]
