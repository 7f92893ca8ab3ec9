"""Diagnostics: findings with a code, a location, a message, and a hint."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Any

from simfoundry.errors import PicklableError

# Maximum displayed length of a source line [columns], which is the width of a wide terminal.
SHOWN = 160


class Severity(StrEnum):
    """The severity of a finding."""

    ERROR = "error"
    WARNING = "warning"


@dataclass(frozen=True)
class Fix:
    """A correction of a finding: the text to write in place of the finding's ``word``.

    Attributes:
        text: The text to write.
        certain: True if nothing else is likely to be meant, so that a program may apply the correction unasked.
    """

    text: str
    certain: bool = False


@dataclass(frozen=True)
class Diagnostic:
    """A finding at a location.

    ``line`` and ``column`` count from 1, and 0 means the whole file. ``about`` contains names that the finding concerns
    in addition to those in ``path``. Like the names in ``path``, they can be used in ``allow`` to silence the finding.
    ``word`` is the text at the location that is wrong, such as a key, a value, or an argument of a predicate, as it is
    spelled there; it is empty if the text is not known. ``fixes`` contains what can be written instead.
    """

    code: str
    severity: Severity
    message: str
    file: str
    line: int = 0
    column: int = 0
    path: str = ""
    hint: str = ""
    about: tuple[str, ...] = ()
    word: str = ""
    fixes: tuple[Fix, ...] = ()

    @property
    def end_column(self) -> int:
        """Return the column after the wrong word, or 0 if the word is not known."""
        return self.column + len(self.word) if self.word else 0

    @property
    def document(self) -> str:
        """Return the file without a location inside it: ``a.usda`` for ``a.usda</World/cup>``."""
        return self.file.partition("</")[0]

    def to_json(self) -> dict[str, Any]:
        """Return the finding as a plain mapping for ``--json``."""
        data = {key: value for key, value in asdict(self).items() if key != "about"}
        return data | {"fixes": [asdict(fix) for fix in self.fixes]}


class SpecError(PicklableError):
    """Raised if findings prevent further processing. The message contains all of the findings."""

    def __init__(self, diagnostics: Iterable[Diagnostic]) -> None:
        self.diagnostics = ordered(diagnostics)
        super().__init__("\n".join(f"{d.file}:{d.line}:{d.column}: {d.code} {d.message}" for d in self.diagnostics))


def ordered(diagnostics: Iterable[Diagnostic]) -> list[Diagnostic]:
    """Return the findings in reading order, without duplicates."""
    return sorted(set(diagnostics), key=lambda d: (d.file, d.line, d.column, d.code, d.message, d.path, d.hint, d.word))


@cache
def _synonyms() -> dict[str, str]:
    """Return a mapping from synonyms to keys and values of the document language.

    The synonyms include terms from other formats.
    """
    from simfoundry.spec.yaml.text import read

    ours: dict[str, tuple[str, ...]] = read(Path(__file__).with_name("synonyms.yaml")).data
    return {other: word for word, others in ours.items() for other in others}


def nearest(word: str, choices: Iterable[str]) -> str:
    """Return a hint with the most similar choice, or with all valid choices if none is similar."""
    names = sorted(choices)
    similar = most_similar(word, names)
    if similar is not None:
        return f"did you mean `{similar.text}`?"
    if not names:
        return ""
    shown = ", ".join(f"`{n}`" for n in names[:12])
    return f"valid: {shown}" + (f" and {len(names) - 12} more" if len(names) > 12 else "")


# Least similarity of a word and the choice that was meant, as the share of characters that match. With 0.6, the words
# of both "plate" and "late", and of "mug" and "mgu", are similar.
SIMILAR = 0.6

# Least difference to the similarity of the second choice at which the first choice is certain.
_AHEAD = 0.1

# Least similarity at which a choice is certain even if more than one letter differs.
_CERTAIN = 0.85


def most_similar(word: str, choices: Iterable[str]) -> Fix | None:
    """Return the correction of a misspelled word to the most similar choice, or None if none is similar.

    The correction is certain if hardly more than one letter is wrong in each part of the name, if no other choice is
    almost as similar, and if both contain the same numbers: `cup_3` may be a name that is still to be defined, and not
    a misspelling of `cup_2`.
    """
    names = sorted(choices)
    plain = {_plain(name): name for name in reversed(names)}
    sought = _plain(word)
    meant = _plain(_synonyms().get(sought, ""))
    if meant in plain:
        return Fix(plain[meant])  # the word may have another unit or form, such as an angle in radians
    import difflib

    similar = [n for n in plain if len(plain) <= 1000 or n[:3] == sought[:3]]  # comparison is slow for many names
    found = difflib.get_close_matches(sought, similar[:1000], n=2, cutoff=SIMILAR)
    if not found:
        return None
    ratios = [difflib.SequenceMatcher(None, name, sought).ratio() for name in found]
    ahead = len(found) == 1 or ratios[0] - ratios[1] >= _AHEAD
    choice = plain[found[0]]
    ahead = ahead and sum(_plain(name) == found[0] for name in names) == 1  # as `cup_1_11` and `cup_11_1` are not
    return Fix(choice, certain=ahead and _is_slip(word, choice) and _numbers(word) == _numbers(choice))


def similar_fixes(word: str, choices: Iterable[str]) -> tuple[Fix, ...]:
    """Return the correction of a misspelled word, if there is one."""
    found = most_similar(word, choices)
    return () if found is None else (found,)


def _is_slip(word: str, choice: str) -> bool:
    """Return True if a word is hardly more than one letter away from a choice, in each part between underscores.

    A part with another meaning makes another name, even if the rest is long: `kitchen_cabinet_upper_drawer` is no slip
    for `kitchen_cabinet_lower_drawer`, and `arm_l` none for `arm_r`.
    """
    a, b = word.casefold().split("_"), choice.casefold().split("_")
    if len(a) != len(b):  # an underscore is missing, or there is one too many
        a, b = [_plain(word)], [_plain(choice)]
    import difflib

    return all(
        one == other
        or (_is_one_edit(one, other) and max(len(one), len(other)) > 1)
        or difflib.SequenceMatcher(None, one, other).ratio() >= _CERTAIN
        for one, other in zip(a, b, strict=True)
    )


def _is_one_edit(a: str, b: str) -> bool:
    """Return True if two words differ by one letter that is added, missing, or another one, or by two swapped ones."""
    start = next((k for k, (one, other) in enumerate(zip(a, b, strict=False)) if one != other), min(len(a), len(b)))
    a, b = a[start:], b[start:]
    return a[1:] == b or a == b[1:] or a[1:] == b[1:] or (a[:2] == b[:2][::-1] and a[2:] == b[2:])


def _numbers(name: str) -> list[str]:
    return re.findall(r"[0-9]+", name)


def _plain(name: str) -> str:
    """Normalize a name by converting it to lower case and removing underscores."""
    return name.casefold().replace("_", "")


def render(diagnostics: Iterable[Diagnostic], color: bool = False, texts: Mapping[str, str] | None = None) -> str:
    """Format findings like a compiler: location, message, source line with a caret, and hint.

    Source lines are read from the file of the finding unless ``texts`` contains its content. With ``color``, the
    output contains terminal escape sequences.
    """
    sources = {file: _lines(text) for file, text in (texts or {}).items()}

    def paint(text: str, style: str) -> str:
        return f"\x1b[{_STYLES[style]}m{text}\x1b[0m" if color else text

    blocks = []
    for d in ordered(diagnostics):
        place = printable(f"{d.file}:{d.line}:{d.column}" if d.line else d.file)
        label = paint(f"{d.severity}[{d.code}]", d.severity)
        lines = [f"{paint(place, 'place')}: {label} {paint(printable(d.message), 'message')}"]
        if d.line and d.file not in sources:  # a file that could not be read may be a pipe or a device
            try:
                sources[d.file] = _lines(Path(d.file).read_text(encoding="utf-8", errors="replace"))
            except OSError:
                sources[d.file] = []
        if 0 < d.line <= len(sources.get(d.file, ())):
            # Every character must occupy one column, so that the caret is aligned.
            text = "".join(c if c.isprintable() else " " for c in sources[d.file][d.line - 1])
            start = max(0, d.column - SHOWN)
            caret = " " * (d.column - 1 - start) + paint("^" * _underlined(d, start), d.severity)
            lines += [
                f"{paint(f'  {d.line:>5} |', 'margin')} {text[start : start + SHOWN]}",
                f"{paint('        |', 'margin')} {caret}",
            ]
        if d.hint:
            lines.append(f"{paint('        =', 'margin')} {printable(d.hint)}")
        blocks.append("\n".join(lines))
    return "\n".join(blocks)


def _underlined(d: Diagnostic, start: int) -> int:
    """Return the number of characters to underline in a source line that is shown from ``start``."""
    return max(1, min(len(d.word), start + SHOWN - d.column + 1))


# ECMA-48 "Select Graphic Rendition" codes for bold text in red, yellow or blue.
_STYLES = {"error": "1;31", "warning": "1;33", "place": "1", "message": "1", "margin": "34"}


def printable(line: str) -> str:
    """Escape the control characters of a line."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)


def _lines(text: str) -> list[str]:
    return text.removeprefix("\ufeff").splitlines()
