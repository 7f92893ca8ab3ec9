"""Labels beside their objects in a picture, without overlaps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from simfoundry.reports.pictures import Tag

FONT = 0.024
"""Font size as a fraction of the image width: 15 px if two images share a wide page."""

LONGEST = 24
"""Length from which names are truncated with dots: a third of a picture's width."""

_LETTER, _PADDING, _LINE, _GAP = 0.64, 1.0, 1.5, 0.2
"""Character width of the widest common fonts, padding of a name on both sides, height of a label, and least gap between
two, all as shares of the font size."""

_ASIDE = (0.0, -0.25, 0.25, -0.45, 0.45)
"""Sideways shifts of a label, as shares of its width; below 0.5, so that the line to its object starts under it."""


@dataclass(frozen=True)
class Label:
    """Label with its middle at ``x`` and its lower edge at ``y``, of size ``width`` and ``height``.

    A line goes down to the object ``thing`` at (``thing_x``, ``thing_y``). All values are shares of the picture.
    """

    name: str
    x: float
    y: float
    width: float
    height: float
    thing_x: float
    thing_y: float

    @property
    def text(self) -> str:
        """Name, shortened if it is long."""
        return self.name if len(self.name) <= LONGEST else f"{self.name[: LONGEST - 1]}…"

    def meets(self, other: Label) -> bool:
        """Return whether two labels overlap."""
        return (
            abs(self.x - other.x) < (self.width + other.width) / 2
            and self.y - self.height < other.y
            and other.y - other.height < self.y
        )


def place_labels(tags: Sequence[Tag], aspect: float) -> list[Label]:
    """Return a label for each tag, above its object if there is space; tags without space are left out.

    ``aspect`` is the width of the picture divided by its height.
    """
    placed: list[Label] = []
    for tag in sorted(tags, key=lambda t: (-t.y, t.x, t.name)):  # objects in front keep their labels close
        free = (label for label in _candidates(tag, aspect) if not any(map(label.meets, placed)))
        label = next(free, None)
        if label is not None:
            placed.append(label)
    return placed


def _candidates(tag: Tag, aspect: float) -> Iterator[Label]:
    """Yield positions of a label inside the picture, nearest first: above its object, then below."""
    height = (_LINE + _GAP) * FONT * aspect
    width = (_LETTER * min(len(tag.name), LONGEST) + _PADDING + _GAP) * FONT
    above, below = int(max(tag.y, 0) / height), int(max(1 - tag.y, 0) / height)
    for step in (*range(above), *range(-1, -below, -1)):
        y = tag.y - (step + 0.25) * height
        for aside in _ASIDE:
            x = min(max(tag.x + aside * width, width / 2), 1 - width / 2)
            if height <= y <= 1:
                yield Label(tag.name, x, y, width, height, tag.x, tag.y)
