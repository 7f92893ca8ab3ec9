"""The command that shows foundation models: ``models``."""

from __future__ import annotations

from pathlib import Path

import click

from simfoundry.cli import output
from simfoundry.cli.options import ANY


@output.subcommand()
@click.argument("path", type=ANY, required=False)
@click.option("--check", is_flag=True, help="Ask each server, command and recording for its model.")
@click.option(
    "--commercial-only", is_flag=True, help="Refuse models that may not be used commercially; implies --check."
)
@click.option("--licences", is_flag=True, help="Show the table of licences instead.")
def models_command(path: Path | None, check: bool, commercial_only: bool, licences: bool, as_json: bool) -> int:
    """Show the foundation models that are configured for the project of PATH, and their licences.

    Models are configured by task under `models: tasks:` in simfoundry.yaml, and by environment variables such as
    SIMFOUNDRY_MODEL_DEPTH, which take precedence. By default, PATH is the working folder. Without --check, no server is
    contacted and no command is started.

    The exit code is 1 if a configured model cannot be used.
    """
    from simfoundry.models.inventory import inventory, lines
    from simfoundry.models.setup import load_setup

    if licences:
        return _print_licences(as_json)
    setup = load_setup(path, commercial_only=commercial_only)
    rows = inventory(setup, check or setup.commercial_only)
    facts = {"commercial_only": setup.commercial_only, "models": [row.to_json() for row in rows]}
    output.print_result(as_json, facts, "\n".join(lines(rows)))
    return output.FINDINGS if any(row.status in ("fails", "refused") for row in rows) else output.DONE


def _print_licences(as_json: bool) -> int:
    from dataclasses import asdict

    from simfoundry.models.provenance import licences

    rows = licences().values()
    if as_json:
        output.print_json({"licences": [asdict(row) for row in rows]})
        return output.DONE
    for row in rows:
        click.echo(f"{row.name:<24} {row.commercial:<12} {row.weights} ({', '.join(row.task)})")
        if row.condition:
            click.echo(f"{'':<24} {row.condition}")
    return output.DONE
