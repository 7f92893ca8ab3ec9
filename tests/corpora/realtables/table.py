"""One row a capture, one cell a bar, and the totals below."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Cell:
    """A figure and whether it meets its bar, with the reason if not; ``passed`` is None where totals have the bar."""

    figure: str
    passed: bool | None = None
    why: str = ""

    def __str__(self) -> str:
        return self.figure if self.passed is None else f"{self.figure} {'ok' if self.passed else 'FAIL'}".strip()


@dataclass(frozen=True)
class Measures:
    """Numbers of one capture that the totals need; None where there is no truth or the capture failed."""

    seconds: float | None = None
    megabytes: float | None = None
    objects_true: int | None = None
    objects_found: int | None = None
    overlaps: tuple[float, ...] = ()


@dataclass(frozen=True)
class Row:
    """One capture: its cells by column, its numbers, and the load of the machine when it began."""

    name: str
    cells: dict[str, Cell]
    measures: Measures = field(default=Measures())
    load: float = 0.0

    @property
    def failures(self) -> list[str]:
        """A line for every cell that fails."""
        return [f"{self.name}, {column}: {c.why or c.figure}" for column, c in self.cells.items() if c.passed is False]


@dataclass(frozen=True)
class Bar:
    """A bar over all captures, what was measured, and whether that meets it."""

    bar: str
    figure: str
    passed: bool


def text_table(rows: Sequence[Row], columns: Sequence[str]) -> str:
    """The rows below a line of headings; a cell that a capture lacks is ``-``."""
    lines = [["capture", *columns]]
    lines += [[row.name, *(str(row.cells.get(column, "-")) for column in columns)] for row in rows]
    widths = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    return "\n".join("  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip() for line in lines)


def totals_table(bars: Sequence[Bar]) -> str:
    """One line a bar."""
    widths = max(len(b.bar) for b in bars), max(len(b.figure) for b in bars)
    return "\n".join(f"{b.bar:<{widths[0]}}  {b.figure:>{widths[1]}}  {'ok' if b.passed else 'FAIL'}" for b in bars)
