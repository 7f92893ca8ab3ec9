"""Documents as people leave them: any layout that YAML allows, with comments wherever they may stand."""

from __future__ import annotations

import random
from collections.abc import Iterator
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


def with_repeats(data: dict[str, Any], seed: int) -> dict[str, Any]:
    """The data with some values copied over others, so that there is something to write as an alias."""
    rng, values = random.Random(seed), [*_inside(data)]

    def copied(value: Any) -> Any:
        if rng.random() < 0.2:
            return rng.choice(values)
        if isinstance(value, dict):
            return {key: copied(item) for key, item in value.items()}
        return tuple(map(copied, value)) if isinstance(value, tuple) else value

    return {key: copied(value) for key, value in data.items()}


def _inside(value: Any) -> Iterator[Any]:
    for item in value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else ():
        yield item
        yield from _inside(item)


DOCUMENTS = st.builds(with_repeats, st.dictionaries(KEYS, VALUES, max_size=6), st.integers(0, 2**32))
"""Plain data of documents without their first key."""


@dataclass
class Untidy:
    """Writes data in a layout by chance; ``expected`` is the path that each comment belongs to, where that is clear."""

    rng: random.Random
    often: float = 0.25
    expected: dict[str, tuple[str | int, ...]] = field(default_factory=dict)
    count: int = 0
    anchors: dict[str, str] = field(default_factory=dict)  # the value of each anchor, as `repr` writes it

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

    def blank(self) -> str:
        """Blank lines above an entry."""
        return self.rng.choice(["\n", "  \n\n\n"]) if self.chance(0.15) else ""

    def alias(self, value: Any) -> str:
        """An alias of the value, or an empty text."""
        names = [name for name, known in self.anchors.items() if known == repr(value)]
        return f"*{self.rng.choice(names)}" if names and self.chance(0.7) else ""

    def anchor(self) -> str:
        """The name of an anchor, which may be known already, or an empty text."""
        return f"{self.rng.choice('abc')}{self.rng.randrange(3)}" if self.chance(0.3) else ""

    def anchored(self, value: Any, anchor: str, written: str) -> str:
        """What was written for a value, which aliases may repeat from now on."""
        if anchor:
            self.anchors[anchor] = repr(value)
        return written

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
            out += self.blank() + self.lines(() if out == "" and not path else inside, indent) + self.blank()
            written = key if key.isidentifier() and key.lower() not in ("true", "false", "null") else quoted(key)
            head = f"? {written}\n{' ' * indent}:" if len(key) > 1000 or self.chance(0.05) else f"{written}:"
            out += " " * indent + head + self.value(value, indent, inside, True)
        return out

    def sequence(self, data: tuple[Any, ...], indent: int, path: tuple[str | int, ...]) -> str:
        out = ""
        for k, value in enumerate(data):
            out += self.blank() + self.lines((*path, k), indent) + self.blank()
            out += " " * indent + "-" + self.value(value, indent, (*path, k), False)
        return out

    def value(self, value: Any, indent: int, path: tuple[str | int, ...], in_mapping: bool) -> str:
        """A value behind its key or dash, to the end of its last line."""
        container = isinstance(value, dict | tuple) and bool(value)
        if alias := self.alias(value):
            return f" {alias}{self.tail(path)}\n"
        anchor = self.anchor()
        if container and self.chance(0.6):
            more = self.rng.choice([1, 2, 4])
            head = f" &{anchor}" * bool(anchor) + self.tail(path, False) + "\n"
            dash = isinstance(value, tuple) and in_mapping and self.chance(0.4)
            inside = indent if dash else indent + more
            write = self.mapping if isinstance(value, dict) else self.sequence
            body = write(value, inside, path)
            end = "" if dash or not self.chance(self.often) else f"{' ' * inside}{self.comment(path)}\n"
            return self.anchored(value, anchor, head + body + end)
        mark = f"&{anchor} " * bool(anchor)
        if isinstance(value, str) and "\n" in value.strip() and value.isascii() and self.chance(0.7):
            lines = value.removesuffix("\n").split("\n")
            if not value.endswith("\n\n") and all(line == line.strip() and line for line in lines):
                head = "|" if value.endswith("\n") else "|-"
                text = f" {mark}{head}{self.tail(path)}\n" + "".join(f"{' ' * (indent + 3)}{x}\n" for x in lines)
                return self.anchored(value, anchor, text)
        written = self.flow(value, path) if container else self.scalar(value, False)
        if self.chance(0.1):
            before = f"{self.tail(path, False)}\n{self.lines(path, indent + 1)}{' ' * (indent + 1)}"
            return self.anchored(value, anchor, f"{before}{mark}{written}{self.tail(path)}\n")
        return self.anchored(value, anchor, f" {mark}{written}{self.tail(path)}\n")

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
            alias = self.alias(item)
            comma = "," if k < len(value) - 1 or self.chance(0.2) else ""
            anchor = "" if alias else self.anchor()
            written = f"{alias} " if alias else f"&{anchor} " * bool(anchor) + self.flow(item, inside)
            out += (
                key
                + self.anchored(item, anchor, written)
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
