"""A Markdown report of the changes to documents, for a comment on a pull request.

Names and texts from documents may come from anyone. Text that could be read as markup, a mention or a link is written
as code, in which GitHub interprets nothing. The length is limited, because GitHub rejects longer comments.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import quote

from simfoundry.reports.comparison import COLORS, described_document, mark_of
from simfoundry.reports.pictures import labelled_png
from simfoundry.runtime.files import MARK
from simfoundry.spec.change.compare import DocumentComparison
from simfoundry.spec.change.diff.words import MemberChange, summary
from simfoundry.spec.diagnostics import Diagnostic, printable

# First line of every report, which is not displayed. Programs use it to find and update an earlier comment.
MARKER = f"<!-- {MARK}: changes to documents -->"

# Maximum length of a report [characters]. GitHub rejects comments above 65,536; the rest is left for additions, such as
# a link to the pictures.
MAX_LENGTH = 60_000

# Number of changes to a document that are shown at once, and number that are listed at all.
SHOWN, LISTED = 12, 200

# Maximum length of one change [characters]; a whole goal or description fits, and twelve of them leave room for others.
MAX_LINE = 600

# Text without any meaning in Markdown or on GitHub: no markup, and no way to write a link, a mention or an emoji.
_PLAIN = re.compile(
    r"(?:[A-Za-z]|\d+ (?=[a-z]))"
    r"(?:[A-Za-z0-9 ,;()→×·°…%²³≈±–/=']|[.+-](?![.+-])|:(?= )|(?<=[A-Za-z0-9])_(?=[A-Za-z0-9]))*"
)

# Words of plain text that GitHub turns into links.
_LINKED = re.compile(r"www\.|\bgh-\d", re.IGNORECASE)

# Names of the colors in the images, for people who read the list of changes beside them.
_LEGEND = {"moved": "orange: moved or turned", "changed": "blue: changed or renamed", "added": "green: added",
           "removed": "red: removed"}  # fmt: skip


@dataclass
class PictureFiles:
    """The images of a report.

    Attributes:
        address: The address or the relative path of the folder in which readers of the report find the images.
        files: The images as PNG bytes, by file name. They are added while the report is written.
    """

    address: str
    files: dict[str, bytes] = field(default_factory=dict)

    def add(self, name: str, png: bytes) -> str:
        """Add an image and return its address."""
        self.files[name] = png
        folder = self.address.rstrip("/")
        return f"{folder}/{name}" if folder else name


def markdown_report(comparisons: Sequence[DocumentComparison], pictures: PictureFiles | None = None) -> str:
    """Return the report for the given documents, with images before and after if ``pictures`` is given."""
    blocks = [f"{MARKER}\n"]
    if len(comparisons) != 1:
        blocks.append(f"**{len(comparisons)} documents differ**\n" if comparisons else "**No document differs.**\n")
    left = MAX_LENGTH - sum(map(len, blocks))
    omitted: list[DocumentComparison] = []
    for k, comparison in enumerate(comparisons, 1):
        block = next((b for b in _blocks(comparison, k, pictures) if len(b) + 1 <= left), None) if not omitted else None
        if block is None:
            omitted.append(comparison)
        else:
            blocks.append(block)
            left -= len(block) + 1
    if omitted:
        count = "one more document differs" if len(omitted) == 1 else f"{len(omitted)} more documents differ"
        blocks.append(f"The report is limited to what a comment can contain: {count}. `simfoundry diff` shows all.\n")
    return "\n".join(blocks)


def _blocks(comparison: DocumentComparison, number: int, pictures: PictureFiles | None) -> Iterator[str]:
    """Yield the description of a document, complete at first and then without the list of changes."""
    head = [f"### {_heading(comparison)}", ""]
    images: list[str] = []
    if pictures is None:
        entries, lines = comparison.entries, comparison.lines()
        along = [] if comparison.obstacle else lines[len(entry_lines(entries)) : -1] if entries else []
    else:
        about = described_document(comparison, f"d{number}")
        entries, lines, along = about["entries"], about["lines"], []
        images = list(_images(about["sides"], entries, f"{number:02d}-{_slug(comparison.name)}", pictures))
    if entries:
        head += [f"**{inline(summary(entries))}**", ""]
    items = [*(_item(entry) for entry in entries), *map(inline, along)] or [inline(line) for line in lines]
    findings = [_finding(d) for d in comparison.findings]
    errors = _details(f"{len(findings)} error{'s' * (len(findings) != 1)}", findings[:LISTED]) if findings else []
    yield "\n".join([*head, *images, *_list(items), *errors])
    yield "\n".join([*head, *images, f"{len(items)} changes, which are too long for this report", ""])


def entry_lines(entries: Sequence[MemberChange]) -> list[str]:
    """Return the lines that the text form of a comparison has for the entries."""
    return [line for entry in entries for line in entry.lines()]


def _heading(comparison: DocumentComparison) -> str:
    name = code(comparison.name)
    if comparison.old is None:
        return f"{name} added"
    if comparison.new is None:
        return f"{name} removed"
    return f"{name} renamed from {code(comparison.was)}" if comparison.was else name


def _item(entry: MemberChange) -> str:
    """Return the changes to a member on one line, as in the text form, with its name as code."""
    facts = "; ".join(entry.facts)
    if not entry.name:
        return inline(facts)
    verbs = ", ".join(entry.verbs)
    words = f" {inline(verbs)}" if verbs else ":"
    return f"{code(entry.subject)}{words}{';' if verbs and facts else ''}{f' {inline(facts)}' if facts else ''}"


def _finding(d: Diagnostic) -> str:
    place = f"{d.file}:{d.line}:{d.column}" if d.line else d.file
    return f"{code(place)} {d.code} {inline(d.message)}"


def _list(items: Sequence[str]) -> list[str]:
    """Return a list of which the first items are visible and the others can be unfolded."""
    rest = items[SHOWN:LISTED]
    lines = [*(f"- {item}" for item in items[:SHOWN]), ""]
    if rest:
        lines += _details(f"{len(items) - SHOWN} more", rest)
    if len(items) > LISTED:
        lines += [f"The first {LISTED} changes are listed; `simfoundry diff` shows all.", ""]
    return lines


def _details(title: str, items: Sequence[str]) -> list[str]:
    return ["<details>", f"<summary>{title}</summary>", "", *(f"- {item}" for item in items), "", "</details>", ""]


def _images(
    sides: Sequence[Mapping[str, Any]], entries: Sequence[MemberChange], name: str, pictures: PictureFiles
) -> Iterator[str]:
    """Yield a table with the images of both scenes, or with the reasons why there are none."""
    if not sides:
        return
    cells = []
    for side in sides:
        caption = str(side["caption"])
        if side["picture"] is None:
            cells.append(inline(str(side["reason"])).replace("|", "\\|"))
            continue
        address = pictures.add(f"{name}-{caption}.png", labelled_png(side["picture"], side["labels"], _colors(side)))
        cells.append(f"![{caption}]({quote(address, safe='/:.-_~?=&%')})")
    yield f"| {' | '.join(str(side['caption']) for side in sides)} |"
    yield f"|{' --- |' * len(sides)}"
    yield f"| {' | '.join(cells)} |"
    yield ""
    marks = {mark_of(entry) for entry in entries if entry.section == "objects"}
    if marks and any(side["picture"] is not None for side in sides):
        yield f"<sub>{'; '.join(words for mark, words in _LEGEND.items() if mark in marks)}</sub>"
        yield ""


def _colors(side: Mapping[str, Any]) -> Callable[[str], tuple[int, int, int]]:
    return lambda name: COLORS[mark_of(side["changes"][name][1])]


def _slug(name: str) -> str:
    """Return a part of a file name that is valid everywhere."""
    stem = re.sub(r"\.yaml$", "", name.rpartition("/")[2])
    return re.sub(r"[^a-z0-9]+", "-", stem.lower()).strip("-")[:40] or "document"


# -- text from documents --------------------------------------------------------------------------------------------


def inline(text: str) -> str:
    """Return a text on one line. Text that Markdown could interpret is formatted as code."""
    line = _line(text)
    return line if _PLAIN.fullmatch(line) and not _LINKED.search(line) else code(line)


def code(text: str) -> str:
    """Return a text as code on one line, in which neither Markdown nor GitHub interprets anything."""
    line = _line(text) or " "
    fence = "`" * (max(map(len, re.findall("`+", line)), default=0) + 1)
    padding = " " if line.startswith("`") or line.endswith("`") else ""
    return f"{fence}{padding}{line}{padding}{fence}"


def _line(text: str) -> str:
    line = printable(" ".join(text.split()))
    return line if len(line) <= MAX_LINE else f"{line[: MAX_LINE - 1]}…"
