"""``simfoundry migrate``."""

from __future__ import annotations

from pathlib import Path

import click

from simfoundry.cli.documents import documents
from simfoundry.cli.output import CANNOT, DONE, FINDINGS, print_findings, print_json, subcommand


@subcommand()
@click.argument("paths", nargs=-1, type=click.Path(path_type=Path))
@click.option("--check", is_flag=True, help="Write nothing, and exit with code 1 if a document is out of date.")
def command(paths: tuple[Path, ...], check: bool, as_json: bool) -> int:
    """Update older documents in place: their version, and keys that were renamed. Comments are kept.

    PATHS are files, or folders with documents below them (default: the working folder). A document's first key states
    its version.
    """
    from simfoundry.runtime.files import write_atomically
    from simfoundry.spec.change.format import migrated
    from simfoundry.spec.diagnostics import Diagnostic, SpecError
    from simfoundry.spec.yaml.nodes import YamlError
    from simfoundry.spec.yaml.text import read

    files = documents(paths or (Path(),))
    newer: dict[Path, str] = {}
    findings: list[Diagnostic] = []
    for path in files:
        try:
            text = read(path).text
            new = migrated(text, str(path))
        except YamlError as error:
            findings.append(error.diagnostic(str(path)))
        except SpecError as error:
            findings += error.diagnostics
        else:
            if new != text:
                newer[path] = new
    for path, text in newer.items() if not check else ():
        write_atomically(path.resolve(), text.encode())
    if as_json:
        listed = {"files": [str(p) for p in files], "older": [str(p) for p in newer]}
        print_json({**listed, "findings": [d.to_json() for d in findings]})
    else:
        for path in newer:
            click.echo(f"{'would update' if check else 'updated'} {path}")
        if findings:
            print_findings(findings)
        count = f"{len(files)} document{'s' if len(files) != 1 else ''}"
        click.echo(f"{count}: {len(newer) or 'none'} out of date")
    return CANNOT if findings else FINDINGS if check and newer else DONE
