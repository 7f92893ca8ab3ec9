"""Conversion of names from other formats to unique document names of lower-case letters, digits and `_`."""

from __future__ import annotations

import re
import unicodedata

from simfoundry.spec.models.base import WORLD

LONGEST = 64
"""Largest length of a name in documents."""


def plain_name(text: str, otherwise: str = "thing") -> str:
    """Return the valid document name that is closest to a text."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z][a-z])", "_", text)
    ascii_only = unicodedata.normalize("NFKD", spaced).encode("ascii", "ignore").decode().lower()
    name = re.sub(r"[^a-z0-9]+", "_", ascii_only).strip("_")
    if not name:
        return otherwise
    return (name if name[0].isalpha() else f"{otherwise}_{name}")[:LONGEST].rstrip("_")


class NameTable:
    """Unique names for the elements of one kind; ``renamed`` contains names that had to change.

    The name ``world`` is never used, because formats reserve it for the static world.
    """

    def __init__(self, otherwise: str = "thing") -> None:
        self.otherwise = otherwise
        self.taken: set[str] = {WORLD}
        self.renamed: dict[str, str] = {}

    def name(self, text: str) -> str:
        """Return a unique name for an element called ``text``."""
        plain = plain_name(text, self.otherwise)
        name, count = plain, 1
        while name in self.taken:
            count += 1
            name = f"{plain[: LONGEST - 5]}_{count}"
        self.taken.add(name)
        if name != text:
            self.renamed[text] = name
        return name
