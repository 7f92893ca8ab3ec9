"""``simfoundry schema``."""

from __future__ import annotations

from pathlib import Path

import click

from simfoundry.cli.options import NEW_FOLDER
from simfoundry.cli.output import print_document, subcommand
from simfoundry.spec.models.kinds import KINDS

WORDS = tuple(kind.partition("/")[0] for kind in KINDS)


@subcommand(as_json=False, force=True)
@click.argument("kind", type=click.Choice(WORDS), required=False)
@click.option("-o", "--out", type=NEW_FOLDER, help="Write all schemas into this folder.")
@click.option("--standard", is_flag=True, help="Use only keywords of JSON Schema, for strict validators such as ajv.")
def command(kind: str | None, out: Path | None, standard: bool, force: bool) -> None:
    """Print the JSON Schema of a kind of document, or write all of them with -o.

    The schemas include editor extensions of JSON Schema: snippets, Markdown and messages. For validators that reject
    unknown keywords, use --standard.
    """
    from simfoundry.runtime.files import ensure_replaceable, write_atomically
    from simfoundry.spec.editor.schema import schemas

    texts = schemas(standard)
    if out is not None:
        for name, text in texts.items():
            if not (out / name).is_file() or (out / name).read_bytes() != text.encode():
                ensure_replaceable(out / name, force=force)
        for name, text in texts.items():
            write_atomically(out / name, text.encode())
            click.echo(str(out / name))
        return
    if kind is None:
        raise click.UsageError(f"name a kind ({', '.join(WORDS)}), or write all schemas with -o FOLDER")
    print_document(texts[f"{kind}.schema.json"])
