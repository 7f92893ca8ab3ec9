"""Convert names in imported files to unique, valid document names."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Container
from itertools import chain, count

from simfoundry.spec.models.base import WORLD

# Maximum length of a name in documents [characters].
LONGEST = 64


def plain_name(text: str, otherwise: str = "thing") -> str:
    """Convert text to a similar, valid document name, or to ``otherwise`` if it contains no letters or digits."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z][a-z])", "_", text)
    ascii_only = unicodedata.normalize("NFKD", spaced).encode("ascii", "ignore").decode().lower()
    name = re.sub(r"[^a-z0-9]+", "_", ascii_only).strip("_") or otherwise
    return (name if name[0].isalpha() else f"{otherwise}_{name}")[:LONGEST].rstrip("_")


def free_name(wish: str, taken: Container[str]) -> str:
    """Return ``wish``, with a number appended if that name is already taken."""
    return next(name for name in chain([wish], (f"{wish}_{k}" for k in count(2))) if name not in taken)


class NameTable:
    """A table that assigns unique document names to elements of one kind.

    ``renamed`` maps each original name that was changed to its new name. The name ``world`` is never assigned because
    other formats reserve it for the static world.
    """

    def __init__(self, otherwise: str = "thing") -> None:
        self.otherwise = otherwise
        self.taken: set[str] = {WORLD}
        self.renamed: dict[str, str] = {}

    def name(self, text: str) -> str:
        """Return and reserve a unique name for an element called ``text``."""
        plain = plain_name(text, self.otherwise)
        numbered = (f"{plain[: LONGEST - 5]}_{k}" for k in count(2))  # room for four digits
        name = next(name for name in chain([plain], numbered) if name not in self.taken)
        self.taken.add(name)
        if name != text:
            self.renamed[text] = name
        return name
