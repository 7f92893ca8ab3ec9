"""Packages of other people, as tests write them: modules and entry points on a folder of the import path."""

from __future__ import annotations

import re
import textwrap
import tomllib
from collections.abc import Mapping
from pathlib import Path

PAGES = sorted((Path(__file__).parents[1] / "docs" / "extend").glob("*.md"))
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.DOTALL | re.MULTILINE)
FILE = re.compile(r"\A(?:# |<!-- )(my_package/\S+)")


def write_package(
    folder: Path,
    name: str,
    entry_points: Mapping[str, Mapping[str, str]],
    files: Mapping[str, str],
    version: str = "0.1",
) -> None:
    """Write what installing a package leaves on ``folder``: its files, and its metadata with entry points by group."""
    for path, text in files.items():
        target = folder / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(textwrap.dedent(text), encoding="utf-8")
    info = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    groups = (
        f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in entries.items())
        for group, entries in entry_points.items()
    )
    (info / "entry_points.txt").write_text("\n".join(groups))


def documented_package() -> tuple[dict[str, dict[str, str]], dict[str, str]]:
    """Return the package that the pages of ``docs/extend`` write: its entry points by group, and its files by path."""
    entries: dict[str, dict[str, str]] = {}
    files = {f"my_package/{name}__init__.py": "" for name in ("", "my_sim/", "robots/")}
    for page in PAGES:
        for language, text in BLOCK.findall(page.read_text(encoding="utf-8")):
            named = FILE.match(text)
            if language == "toml":
                entries |= tomllib.loads(text)["project"]["entry-points"]
            elif named is not None:
                files[named[1]] = text
    return entries, files
