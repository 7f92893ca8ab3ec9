"""Markdown pages for diagnostic codes, with an explanation, a fix, and examples of wrong and right documents."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

# Folder of the Markdown pages, one for each code.
FOLDER = Path(__file__).parent / "findings"

# Titles of the groups of codes by prefix, in the order in which a document is checked.
GROUPS = {
    "SF0": "Files and their text",
    "SF1": "Keys and values",
    "SF2": "Names, files and parts that belong together",
    "SF3": "Meshes",
    "SF4": "Lints: warnings, most of which can be silenced with a reason",
    "SF5": "Captures",
    "SF6": "Reconstructions: doubts about a scene, which `simfoundry capture --accept CODE` accepts",
}

_CODE = re.compile(r"(?:(?:error|warning)?\[)?(?:sf)?([0-9]{1,3})\]?", re.IGNORECASE)
_FENCE = re.compile(r"^```(\w+)\n# (\S+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


@dataclass(frozen=True)
class Snippet:
    """A file shown under one of the headings of a page (`Wrong`, `Right`, `Supporting files`)."""

    lead: str
    name: str
    text: str


@dataclass(frozen=True)
class Page:
    """The explanation of one diagnostic code. ``body`` is Markdown without the title."""

    code: str
    title: str
    body: str

    @property
    def markdown(self) -> str:
        """Return the whole page as Markdown."""
        return f"# {self.code} {self.title}\n\n{self.body}"

    @property
    def snippets(self) -> list[Snippet]:
        """Return the files that the page shows: complete documents or meshes whose first line is their file name."""
        leads = re.split(r"^\*\*([^*]+?)\.?\*\*", self.body, flags=re.MULTILINE)
        return [
            Snippet(lead, name, text)
            for lead, part in zip(leads[1::2], leads[2::2], strict=True)
            for _, name, text in _FENCE.findall(part)
        ]


def page(code: str) -> Page:
    """Return the page for a code.

    Raises:
        FileNotFoundError: If the code is unknown.
    """
    title, _, body = (FOLDER / f"{code}.md").read_text(encoding="utf-8").partition("\n\n")
    return Page(code, title.removeprefix(f"# {code} "), body)


@cache
def pages() -> tuple[Page, ...]:
    """Return all pages, ordered by code."""
    return tuple(page(path.stem) for path in sorted(FOLDER.glob("SF*.md")))


def titles() -> dict[str, str]:
    """Return the title of each code."""
    return {found.code: found.title for found in pages()}


def code_of(text: str) -> str | None:
    """Parse a code from ``SF201``, ``sf201``, ``201`` or ``error[SF201]``, or return None if the code is unknown."""
    match = _CODE.fullmatch(text.strip())
    code = f"SF{int(match[1]):03}" if match else ""
    return code if code in titles() else None


def grouped() -> dict[str, dict[str, str]]:
    """Return the codes and their titles, keyed by the title of their group."""
    return {title: {c: t for c, t in titles().items() if c.startswith(start)} for start, title in GROUPS.items()}


_INTRODUCTION = """\
# Findings

<!-- Written by `make schemas` from simfoundry/spec/check/findings; edit those pages, not this one. -->

Every kind of finding that SimFoundry can report has a stable code. Codes that start with `SF4` are warnings, most of
which can be silenced with a reason. Codes that start with `SF6` are doubts about a reconstructed scene. All others are
errors. `simfoundry explain SF201` prints one of these pages, and [checking.md](checking.md) explains how to run the
checks before each commit and in CI.
"""


def findings_page() -> str:
    """Return the text of ``docs/findings.md``, which contains all pages and a table of contents."""
    lines = [_INTRODUCTION]
    for title, codes in grouped().items():
        lines += [f"{title}:\n", *(f"- [{c} {t}](#{_slug(f'{c} {t}')})" for c, t in codes.items()), ""]
    for found in pages():
        lines += [f'<a id="{found.code.lower()}"></a>\n', f"## {found.code} {found.title}\n", found.body]
    return "\n".join(lines).rstrip() + "\n"


def _slug(heading: str) -> str:
    """Return the anchor that GitHub generates for a heading."""
    return re.sub(r"[^\w -]", "", heading).lower().replace(" ", "-")
