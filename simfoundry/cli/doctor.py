"""``simfoundry doctor``."""

from __future__ import annotations

from itertools import groupby

import click

from simfoundry.cli.output import DONE, FINDINGS, print_json, subcommand


@subcommand()
def command(as_json: bool) -> int:
    """Show installed and missing components, and how to install them. The exit code is 1 if a requirement is missing.

    Covers packages, extras, known robots, renderers and foundation models. Nothing is downloaded.
    """
    from simfoundry.worlds.doctor import examine

    parts = examine()
    if as_json:
        print_json({"parts": [part.to_json() for part in parts]})
    else:
        for section, group in groupby(parts, lambda part: part.section):
            click.echo(f"{'' if section == parts[0].section else chr(10)}{section}")
            for part in group:
                mark = "ok     " if part.version else ("MISSING" if part.required else "absent ")
                click.echo(f"  {mark} {part.name:<22} {part.version:<20} {part.purpose}")
                if not part.version:
                    click.echo(f"          {'':<22} -> {part.remedy}")
    return FINDINGS if any(part.required and not part.version for part in parts) else DONE
