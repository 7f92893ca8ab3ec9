"""``simfoundry check``."""

from __future__ import annotations

from pathlib import Path

import click

from simfoundry.cli.documents import documents
from simfoundry.cli.output import DONE, FINDINGS, json_option, print_findings, print_json, reporting


@click.command()
@click.argument("paths", nargs=-1, type=click.Path(path_type=Path))
@json_option
@reporting
def command(paths: tuple[Path, ...], as_json: bool) -> int:
    """Check documents, or every document below folders (default: here).

    Exit code 1 where there is an error or a warning.
    """
    from simfoundry.spec.load import load

    files = documents(paths or (Path(),))
    findings = [d for f in files for d in load(f).all_findings()]
    if as_json:
        print_json({"files": [str(f) for f in files], "findings": [d.to_json() for d in findings]})
    elif findings:
        print_findings(findings)
    if not as_json:
        count = f"{len(files)} document{'s' if len(files) != 1 else ''}"
        click.echo(f"{count}: {len(set(findings)) or 'no'} finding{'s' if len(set(findings)) != 1 else ''}")
    return FINDINGS if findings else DONE
