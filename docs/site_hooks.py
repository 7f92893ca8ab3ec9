"""Pages of the site that are not in this folder: the commands, from their own help, and the repository's own pages."""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

import click
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)")


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that are made here."""
    files.append(File.generated(config, "commands.md", content=commands()))
    for name in ("CONTRIBUTING", "CHANGELOG"):
        files.append(File.generated(config, f"{name.lower()}.md", content=(ROOT / f"{name}.md").read_text()))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Point links to the repository's pages at the site's; what only the repository has is named by its path."""
    source = page.file.src_uri
    here = "" if source in ("contributing.md", "changelog.md") else posixpath.join("docs", posixpath.dirname(source))

    def turned(match: re.Match[str]) -> str:
        image, text, target = match.groups()
        path, _, anchor = target.partition("#")
        if image or "://" in target or not path:
            return match[0]
        path = posixpath.normpath(posixpath.join(here, path))
        folder = posixpath.dirname(source) or "."
        if path in ("CONTRIBUTING.md", "CHANGELOG.md"):
            path = f"docs/{path.lower()}"
        if path == "README.md":
            path = "docs/index.md"
        if path.startswith("docs/"):
            there = posixpath.relpath(path, posixpath.join("docs", folder))
            return f"[{text}]({there}{'#' + anchor if anchor else ''})"
        return f"{text} (`{path}`)" if path not in text else f"`{path}`"

    return LINK.sub(turned, markdown)


def commands() -> str:
    """Every command with its arguments and options, as its own help says them."""
    from simfoundry.cli.main import COMMANDS, app

    root = click.Context(app, info_name="simfoundry")
    parts = [
        "# Commands",
        "Each command prints this with `--help`; most print JSON with `--json`. The exit code is 0 when done, 1 with "
        "findings, 2 when it cannot.",
    ]
    for name in COMMANDS:
        command = app.get_command(root, name)
        assert command is not None
        parts += _described(command, click.Context(command, info_name=name, parent=root), 2)
    return "\n\n".join(parts) + "\n"


def _described(command: click.Command, context: click.Context, level: int) -> list[str]:
    parts = [f"{'#' * level} `{context.command_path}`", (command.help or "").replace("\b", ""),
             f"```text\n{command.get_usage(context).removeprefix('Usage: ')}\n```"]  # fmt: skip
    options = [record for p in command.get_params(context) if (record := p.get_help_record(context)) is not None]
    if options:
        rows = [
            f"| `{name.replace('|', chr(92) + '|')}` | {text.replace('|', chr(92) + '|')} |" for name, text in options
        ]
        parts.append("\n".join(["| option | |", "|---|---|", *rows]))
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            inner = command.get_command(context, name)
            assert inner is not None
            parts += _described(inner, click.Context(inner, info_name=name, parent=context), level + 1)
    return parts
