"""Labels beside what they name in a picture, none over another."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from simfoundry.reports.pictures import Tag

FONT = 0.024
"""The size of the letters as a share of the picture's width: 15 px where two pictures share a wide page."""

LONGEST = 24
"""Longer names end in dots: as wide as a third of a picture."""

_LETTER, _PADDING, _LINE, _GAP = 0.64, 1.0, 1.5, 0.2
"""Width of a letter of the widest usual fonts, room at both sides of a name, height of a label, and least room between
two, all as shares of the size of the letters."""

_ASIDE = (0.0, -0.25, 0.25, -0.45, 0.45)
"""Shifts of a label to the side, as shares of its width; below 0.5, so that the line to its object starts under it."""


@dataclass(frozen=True)
class Label:
    """A label with its middle at ``x`` and its lower edge at ``y``, ``width`` and ``height``; a line goes down to
    ``thing``, where it is (``thing_x``, ``thing_y``). All are shares of the picture."""

    name: str
    x: float
    y: float
    width: float
    height: float
    thing_x: float
    thing_y: float

    @property
    def text(self) -> str:
        """The name, shortened where it is long."""
        return self.name if len(self.name) <= LONGEST else f"{self.name[: LONGEST - 1]}…"

    def meets(self, other: Label) -> bool:
        """Return whether two labels touch."""
        return (
            abs(self.x - other.x) < (self.width + other.width) / 2
            and self.y - self.height < other.y
            and other.y - other.height < self.y
        )


def place_labels(tags: Sequence[Tag], aspect: float) -> list[Label]:
    """A label for each tag, above its thing where there is room; those for which there is none are left out.

    ``aspect`` is the width of the picture over its height.
    """
    placed: list[Label] = []
    for tag in sorted(tags, key=lambda t: (-t.y, t.x, t.name)):  # what is in front keeps its label near
        free = (label for label in _candidates(tag, aspect) if not any(map(label.meets, placed)))
        label = next(free, None)
        if label is not None:
            placed.append(label)
    return placed


def _candidates(tag: Tag, aspect: float) -> Iterator[Label]:
    """Yield places for a label inside the picture, the nearest first: above its object, then below."""
    height = (_LINE + _GAP) * FONT * aspect
    width = (_LETTER * min(len(tag.name), LONGEST) + _PADDING + _GAP) * FONT
    above, below = int(max(tag.y, 0) / height), int(max(1 - tag.y, 0) / height)
    for step in (*range(above), *range(-1, -below, -1)):
        y = tag.y - (step + 0.25) * height
        for aside in _ASIDE:
            x = min(max(tag.x + aside * width, width / 2), 1 - width / 2)
            if height <= y <= 1:
                yield Label(tag.name, x, y, width, height, tag.x, tag.y)
