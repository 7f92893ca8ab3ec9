"""Documents as people leave them: any layout that YAML allows, with comments wherever they may stand."""

from __future__ import annotations

import random
from dataclasses import dataclass, field
from typing import Any

from hypothesis import strategies as st

from simfoundry.spec.yaml.spelling import quoted
from tests.spec.strategies import NAMES, TEXTS

ODD_TEXTS = [
    "#no",
    "a # no",
    "a#b",
    "x: # y",
    "it's",
    "two\nlines # no\n",
    "OnTop( a,b )",
    "OnTop(a,b, # c",
    "-",
    "[",
    "",
]
SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**20), 10**20),
    st.floats(),
    st.floats(-10, 10),
    TEXTS,
    st.sampled_from(ODD_TEXTS),
    NAMES,
)
KEYS = NAMES | st.sampled_from(["objects", "relations", "materials", "pose", "box", "a b", "#", "x: y", "k" * 1100])
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4).map(tuple) | st.dictionaries(KEYS, inner, max_size=4),
    max_leaves=12,
)
DOCUMENTS = st.dictionaries(KEYS, VALUES, max_size=6)
"""Plain data of documents without their first key."""


@dataclass
class Untidy:
    """Writes data in a layout by chance; ``expected`` is the path that each comment belongs to, where that is clear."""

    rng: random.Random
    often: float = 0.25
    expected: dict[str, tuple[str | int, ...]] = field(default_factory=dict)
    count: int = 0

    def chance(self, share: float = 0.5) -> bool:
        return self.rng.random() < share

    def comment(self, path: tuple[str | int, ...] | None) -> str:
        self.count += 1
        name = f"c{self.count}."
        text = self.rng.choice([f"# {name}", f"#{name}", f"#   {name} # 'two\" {{", f"#! {name}: x", f"# {name} [\t"])
        if path is not None:
            self.expected[name] = path
        return text

    def lines(self, path: tuple[str | int, ...], indent: int) -> str:
        """Comments on lines of their own, blank lines between."""
        out = ""
        while self.chance(self.often):
            out += " " * indent + self.comment(path) + "\n" + "\n" * self.chance(0.2)
        return out

    def tail(self, path: tuple[str | int, ...], tab: bool = True) -> str:
        """The end of a line."""
        return (
            self.rng.choice([" ", "  ", " \t"][: 2 + tab]) + self.comment(path)
            if self.chance(self.often)
            else " " * self.chance(0.1)
        )

    def document(self, data: dict[str, Any]) -> str:
        text = ""
        if self.chance(0.2):
            text += self.rng.choice(["---", "%YAML 1.2\n---"]) + self.tail(()) + "\n"
        if self.chance(0.15):
            text += self.flow(data, ()) + "\n"
        else:
            text += self.mapping(data, 0, ())
            text += self.lines((), 0)
        if self.chance(0.1):
            text += f"...\n{self.lines((), 2)}"
        text = text.rstrip("\n") if self.chance(0.2) and not text.endswith("\n\n") else text
        text = text.replace("\n", "\r\n") if self.chance(0.2) else text
        return "\ufeff" + text if self.chance(0.2) else text

    def mapping(self, data: dict[str, Any], indent: int, path: tuple[str | int, ...]) -> str:
        out = ""
        for key, value in data.items():
            inside = (*path, key)
            out += self.lines(() if out == "" and not path else inside, indent)
            written = key if key.isidentifier() and key.lower() not in ("true", "false", "null") else quoted(key)
            head = f"? {written}\n{' ' * indent}:" if len(key) > 1000 or self.chance(0.05) else f"{written}:"
            out += " " * indent + head + self.value(value, indent, inside, True)
        return out

    def sequence(self, data: tuple[Any, ...], indent: int, path: tuple[str | int, ...]) -> str:
        out = ""
        for k, value in enumerate(data):
            out += self.lines((*path, k), indent) + " " * indent + "-" + self.value(value, indent, (*path, k), False)
        return out

    def value(self, value: Any, indent: int, path: tuple[str | int, ...], in_mapping: bool) -> str:
        """A value behind its key or dash, to the end of its last line."""
        container = isinstance(value, dict | tuple) and bool(value)
        if container and self.chance(0.6):
            more = self.rng.choice([1, 2, 4])
            head = f" &a{self.rng.randrange(10**6)}" if self.chance(0.1) else ""
            head += self.tail(path, False) + "\n"
            dash = isinstance(value, tuple) and in_mapping and self.chance(0.4)
            inside = indent if dash else indent + more
            write = self.mapping if isinstance(value, dict) else self.sequence
            body = write(value, inside, path)
            end = "" if dash or not self.chance(self.often) else f"{' ' * inside}{self.comment(path)}\n"
            return head + body + end
        anchor = f"&b{self.rng.randrange(10**6)} " if self.chance(0.1) else ""
        if isinstance(value, str) and "\n" in value.strip() and value.isascii() and self.chance(0.7):
            lines = value.removesuffix("\n").split("\n")
            if not value.endswith("\n\n") and all(line == line.strip() and line for line in lines):
                head = "|" if value.endswith("\n") else "|-"
                return f" {anchor}{head}{self.tail(path)}\n" + "".join(f"{' ' * (indent + 3)}{x}\n" for x in lines)
        written = self.flow(value, path) if container else self.scalar(value, False)
        if self.chance(0.1):
            before = f"{self.tail(path, False)}\n{self.lines(path, indent + 1)}{' ' * (indent + 1)}"
            return f"{before}{anchor}{written}{self.tail(path)}\n"
        return f" {anchor}{written}{self.tail(path)}\n"

    def flow(self, value: Any, path: tuple[str | int, ...]) -> str:
        """A value in brackets or braces, perhaps over several lines."""
        if not isinstance(value, dict | tuple):
            return self.scalar(value, True)
        opening, closing = "{}" if isinstance(value, dict) else "[]"
        out = opening + self.gap(path)
        entries = value.items() if isinstance(value, dict) else enumerate(value)
        for k, (part, item) in enumerate(entries):
            inside = (*path, part)
            key = (
                f"{'? ' * (len(part) > 1000)}{quoted(part)}{' :' if len(part) > 1000 else ':'} "
                if isinstance(part, str)
                else ""
            )
            comma = "," if k < len(value) - 1 or self.chance(0.2) else ""
            out += (
                key
                + self.flow(item, inside)
                + (self.gap(inside) + comma if self.chance() else comma + self.gap(inside))
            )
        return out + closing

    def gap(self, path: tuple[str | int, ...]) -> str:
        """What may stand between the parts of a flow: a comment beside, comments on lines of their own."""
        if not self.chance(self.often):
            return " " * self.chance()
        out = f" {self.comment(path)}\n" if self.chance() else "\n"
        while self.chance(0.2):
            out += " " * self.rng.randrange(9) + self.comment(None) + "\n"
        return out + "         "

    def scalar(self, value: Any, in_flow: bool) -> str:
        match value:
            case None:
                return self.rng.choice(["null", "~"])
            case bool():
                return "true" if value else "false"
            case int():
                return self.rng.choice([str(value), f"+{value}" if value > 0 else str(value)])
            case float():
                special = {"inf": ".inf", "-inf": "-.inf", "nan": ".nan"}
                return special.get(repr(value), self.rng.choice([repr(value), f"{value:.17e}"]))
            case str() if "'" not in value and value.isprintable() and self.chance(0.3):
                return f"'{value}'"
            case str() if (
                value.isidentifier()
                and value.isascii()
                and value.lower() not in ("true", "false", "null")
                and self.chance(0.8)
            ):
                return value
            case tuple() | dict():
                return "[]" if value == () else "{}"
        return quoted(value)


def untidy(
    data: dict[str, Any], seed: int, kind: str = "scene/1", comments: bool = True
) -> tuple[str, dict[str, tuple[str | int, ...]], int]:
    """A document in a layout by chance, the path of each of its comments where that is clear, and their number."""
    rng = random.Random(seed)
    entries = [*data.items()]
    entries.insert(rng.choice([0, 0, len(entries)]), ("simfoundry", kind))
    writer = Untidy(rng, rng.choice([0.1, 0.25, 0.5]) if comments else 0.0)
    text = writer.document(dict(entries))
    return text, writer.expected, writer.count
