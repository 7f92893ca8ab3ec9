"""``simfoundry flatten``."""

from __future__ import annotations

from pathlib import Path

import click

from simfoundry.cli.options import FILE, NEW_FILE
from simfoundry.cli.output import DONE, print_document, print_json, subcommand


@subcommand(force=True)
@click.argument("file", type=FILE)
@click.option("-o", "--out", type=NEW_FILE, help="Write to this file instead of the screen.")
@click.option("--hash", "only_hash", is_flag=True, help="Print only the SHA-256 of the text.")
def command(file: Path, out: Path | None, only_hash: bool, force: bool, as_json: bool) -> int:
    """Write a document in full, with everything that it extends merged and every default written out.

    Equivalent documents give the same text, and therefore the same hash. Paths of files become relative to the place
    where the text is written.
    """
    from simfoundry.runtime.files import ensure_replaceable, write_atomically
    from simfoundry.spec.change.flatten import digest, flatten
    from simfoundry.spec.diagnostics import SpecError
    from simfoundry.spec.load import load

    loaded = load(file)
    if out is not None:
        ensure_replaceable(out, [file, *loaded.files()], force)
    if loaded.spec is None or loaded.errors:
        raise SpecError(loaded.errors)
    text = flatten(loaded.spec, file.parent, out.parent if out is not None else file.parent)
    if out is not None:
        write_atomically(out, text.encode())
    if as_json:
        print_json({"file": str(file), "out": str(out) if out else None, "hash": digest(text), "text": text})
    elif only_hash:
        click.echo(digest(text))
    elif out is None:
        print_document(text)
    else:
        click.echo(f"wrote {out}")
    return DONE
