"""``simfoundry check``."""

from __future__ import annotations

from pathlib import Path

import click

from simfoundry.cli.output import DONE, FINDINGS, CannotError, json_option, print_findings, print_json, reporting


@click.command()
@click.argument("paths", nargs=-1, type=click.Path(path_type=Path))
@json_option
@reporting
def command(paths: tuple[Path, ...], as_json: bool) -> int:
    """Check documents, or every document below folders (default: here).

    Exit code 1 where there is an error or a warning.
    """
    from simfoundry.spec.load import load

    files = _documents(paths or (Path(),))
    findings = [d for f in files for d in load(f).all_findings()]
    if as_json:
        print_json({"files": [str(f) for f in files], "findings": [d.to_json() for d in findings]})
    elif findings:
        print_findings(findings)
    if not as_json:
        count = f"{len(files)} document{'s' if len(files) != 1 else ''}"
        click.echo(f"{count}: {len(set(findings)) or 'no'} finding{'s' if len(set(findings)) != 1 else ''}")
    return FINDINGS if findings else DONE


def _documents(paths: tuple[Path, ...]) -> list[Path]:
    """The files themselves, and the documents below the folders."""
    suffixes = (".scene.yaml", ".asset.yaml", ".capture.yaml")
    files: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = (p for p in sorted(path.rglob("*.yaml")) if not any(part.startswith(".") for part in p.parts))
            files += [p for p in inside if p.name.endswith(suffixes) or p.name == "capture.yaml"]
        elif path.exists():
            files.append(path)
        else:
            raise CannotError(f"there is no file {path}")
    if not files:
        raise CannotError(f"there is no document below {', '.join(map(str, paths))}")
    return files
