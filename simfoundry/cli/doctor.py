"""``simfoundry doctor``."""

from __future__ import annotations

import click

from simfoundry.cli.output import DONE, FINDINGS, json_option, print_json, reporting


@click.command()
@json_option
@reporting
def command(as_json: bool) -> int:
    """Say what is installed, what is missing and how to get it. Exit code 1 where something required is missing."""
    from simfoundry.worlds.doctor import examine

    facts = examine()
    if as_json:
        print_json({"parts": [f.to_json() for f in facts]})
    else:
        for fact in facts:
            mark = "ok     " if fact.version else ("MISSING" if fact.required else "absent ")
            click.echo(f"{mark} {fact.name:<16} {fact.version:<12} {fact.purpose}")
            if not fact.version:
                click.echo(f"        {'':<16} {'':<12} -> {fact.remedy}")
    return FINDINGS if any(f.required and not f.version for f in facts) else DONE
