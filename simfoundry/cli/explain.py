"""``simfoundry explain``."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import click

from simfoundry.cli.output import CannotError, in_color, print_json, subcommand

if TYPE_CHECKING:
    from simfoundry.spec.check.pages import Page


@subcommand()
@click.argument("code", required=False)
def command(code: str | None, as_json: bool) -> None:
    """Explain a diagnostic code: its meaning, its fix, and examples of wrong and right input.

    CODE is written as in a finding, SF201, or without the prefix, 201. Without CODE, all codes are listed.
    """
    from simfoundry.spec.check.pages import code_of, grouped, page, titles
    from simfoundry.spec.diagnostics import nearest

    if code is None:
        if as_json:
            print_json({"groups": grouped()})
        else:
            click.echo(_listed(grouped()))
        return
    known = code_of(code)
    if known is None:
        similar = nearest(code if code.lower().startswith("sf") else f"SF{code}", titles())
        hint = similar if similar.startswith("did") else "`simfoundry explain` lists all"
        raise CannotError(f"there is no code `{code}`; {hint}")
    found = page(known)
    if as_json:
        print_json({"code": found.code, "title": found.title, "markdown": found.markdown})
    elif in_color(sys.stdout):
        _render(found)
    else:
        click.echo(found.markdown, nl=False)


def _listed(groups: dict[str, dict[str, str]]) -> str:
    blocks = ("\n".join((title, *(f"  {c}  {t}" for c, t in codes.items()))) for title, codes in groups.items())
    return "\n\n".join(blocks)


def _render(page: Page) -> None:
    """Print the page to a terminal with a readable line length."""
    from rich.console import Console
    from rich.markdown import Markdown

    console = Console()
    console.print(Markdown(page.markdown, code_theme="ansi_dark"), width=min(console.width, 100))
