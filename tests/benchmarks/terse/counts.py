"""Lines and tokens of the files of each scene, and the form in which they are counted."""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from simfoundry.spec.change.format import format_text

FOLDER = Path(__file__).parent
SCENES = ("eight", "shelf", "workstations", "cabinet", "desk")
WIDTH = 100

# File suffixes of each format, ours first.
FORMATS = {
    "ours": (".scene.yaml", ".asset.yaml"),
    "MJCF": (".xml",),
    "Drake + SDF": (".dmd.yaml", ".sdf"),
    "OmniGibson": (".json",),
}

# A word, a number, or a punctuation mark; the same for all formats.
TOKEN = re.compile(r"[A-Za-z_][A-Za-z0-9_]*|[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|[^\sA-Za-z0-9_]")


@dataclass(frozen=True)
class Count:
    """The size of the files of one scene in one format."""

    lines: int
    tokens: int


def files(scene: str, form: str) -> list[Path]:
    """The files of a scene in a format."""
    return sorted(p for p in (FOLDER / scene).iterdir() if p.name.endswith(FORMATS[form]))


def count(scene: str, form: str) -> Count:
    """The lines and tokens of a scene in a format, without comments and empty lines."""
    lines = [line for path in files(scene, form) for line in formatted(path).splitlines()]
    told = [line for line in lines if line.strip() and not line.lstrip().startswith("#")]
    return Count(len(told), sum(len(TOKEN.findall(line)) for line in told))


def formatted(path: Path) -> str:
    """The text of a file in the form of its formatter."""
    text = path.read_text()
    if path.name.endswith(FORMATS["ours"]):
        return format_text(text, str(path))
    if path.suffix in (".xml", ".sdf"):
        return "".join(f"{line}\n" for line in _element(ElementTree.fromstring(text), 0))
    return json.dumps(json.loads(text), indent=2) + "\n" if path.suffix == ".json" else text


def _element(element: ElementTree.Element, depth: int) -> Iterator[str]:
    """The lines of an XML element: one per element, wrapped between attributes."""
    indent = "  " * depth
    tag = element.tag.replace("{drake.mit.edu}", "drake:")
    words = [f'{key}="{value}"' for key, value in element.attrib.items()]
    if depth == 0 and any(child.tag.startswith("{drake") for child in element.iter()):
        words.append('xmlns:drake="drake.mit.edu"')
    text = (element.text or "").strip()
    end = ">" if len(element) or text else "/>"
    line = f"{indent}<{tag}"
    for k, word in enumerate(words):
        last = end if k == len(words) - 1 else ""
        if len(f"{line} {word}{last}") > WIDTH:
            yield line
            line = " " * (len(indent) + len(tag) + 1)
        line += f" {word}"
    if text:
        yield f"{line}>{text}</{tag}>"
        return
    yield line + end
    if len(element):
        for child in element:
            yield from _element(child, depth + 1)
        yield f"{indent}</{tag}>"


def fewest(counts: dict[str, Count]) -> bool:
    """Whether our format needs the fewest lines and the fewest tokens."""
    others = [c for form, c in counts.items() if form != "ours"]
    ours = counts["ours"]
    return all(ours.lines < c.lines and ours.tokens < c.tokens for c in others)


def main() -> int:
    """Print the table; 1 if ours is not the shortest in four of the five scenes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="Write the files in the form in which they are counted.")
    if parser.parse_args().write:
        for path in (path for scene in SCENES for form in FORMATS for path in files(scene, form)):
            path.write_text(formatted(path))
    table = {scene: {form: count(scene, form) for form in FORMATS} for scene in SCENES}
    print("| scene | " + " | ".join(f"{form}: lines | tokens" for form in FORMATS) + " |")
    print("|---" * (1 + 2 * len(FORMATS)) + "|")
    for scene, counts in table.items():
        print(f"| {scene} | " + " | ".join(f"{c.lines} | {c.tokens}" for c in counts.values()) + " |")
    won = sum(map(fewest, table.values()))
    print(f"ours has the fewest lines and the fewest tokens in {won} of {len(SCENES)} scenes")
    return int(won < 4)
