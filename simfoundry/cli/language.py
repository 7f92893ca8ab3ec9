"""Commands for working with the document language: ``new``, ``schema``, ``flatten``, ``explain``."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import click

from simfoundry.cli import output
from simfoundry.cli.options import FILE, NEW_FILE, NEW_FOLDER, set_option
from simfoundry.errors import SimfoundryError
from simfoundry.spec.models.kinds import KINDS

# Next steps for a new document of each kind.
NEXT = dict.fromkeys(("task", "asset", "cousins", "policy"), ("simfoundry check {path}",)) | {
    "scene": ("simfoundry check {path}", "simfoundry show {path}", "simfoundry studio {path}"),
    "capture": ("put color.png and depth.png into {folder}", "simfoundry check {path}", "simfoundry capture {folder}"),
    "dataset": ("simfoundry check {path}", "simfoundry dataset build {path}"),
}


@output.subcommand()
@click.argument("words", nargs=-1, required=True, metavar="[KIND] PATH")
@click.option("--name", help="Name of the document. Default: the file name without its suffix.")
@click.option("--from", "source", type=FILE, metavar="SCENE",
              help="Scene for a task or a cousins recipe. Default: the only scene in the folder of PATH.")  # fmt: skip
@click.option("--extends", type=FILE, metavar="DOCUMENT",
              help="Create an overlay that contains only the differences from this document.")  # fmt: skip
@click.option("--force", is_flag=True, help="Replace an existing file.")
def new_command(
    words: tuple[str, ...], name: str | None, source: Path | None, extends: Path | None, force: bool, as_json: bool
) -> None:
    """Create a valid document with comments that explain its keys.

    KIND is scene, task, asset, capture, cousins, policy or dataset. It may be omitted if the name of the file implies
    it, as in desk.scene.yaml.

    If PATH is not inside a project (a folder with a simfoundry.yaml or .git), a simfoundry.yaml is written to the
    working folder or to the closest folder that contains all specified files. If the project does not contain schemas
    for editors, they are written to .simfoundry/schemas/.
    """
    from simfoundry.spec.editor.new import kind_and_path, make

    kind, path = kind_and_path(words)
    if path.exists() and not force:
        raise SimfoundryError(f"{path} already exists; use --force to replace it")
    new = make(kind, path, name, source, extends)
    for file, text in {**new.marker, **new.schemas, new.path: new.text}.items():
        output.write_text(file, text)
    written = sorted({str(file.parent) for file in new.schemas})
    steps = [step.format(path=path, folder=path.parent) for step in NEXT[kind]]
    if as_json:
        marker = next((str(file) for file in new.marker), None)
        output.print_json({"file": str(path), "kind": kind, "schemas": written, "project": marker, "next": steps})
        return
    here = f"{Path.cwd()}{os.sep}"  # paths inside the working folder are shown relative to it
    click.echo(f"wrote {path}")
    for file in new.marker:
        click.echo(f"wrote {str(file).removeprefix(here)}, which marks the root of the project")
    for folder in written:
        click.echo(f"wrote {folder.removeprefix(here)}/, which editors use for completion and checks")
    click.echo("\n  ".join(["next:", *steps]))


WORDS = tuple(kind.partition("/")[0] for kind in KINDS)

# Maximum line length [characters] of explanations on a terminal; longer lines are hard to read.
LINE_LENGTH = 100


@output.subcommand(as_json=False, force=True)
@click.argument("kind", type=click.Choice(WORDS), required=False)
@click.option("-o", "--out", type=NEW_FOLDER, help="Write all schemas to this folder.")
def schema_command(kind: str | None, out: Path | None, force: bool) -> None:
    """Print the JSON Schema for one kind of document, or write all schemas to a folder with -o.

    The schemas use only standard keywords. Their part `#/$defs/Editor` is the same schema with snippets and messages
    for editors.
    """
    from simfoundry.spec.editor.schema import schemas

    texts = schemas()
    if out is not None:
        files = {out / name: text for name, text in texts.items()}
        for file, text in files.items():
            output.protect_output(file, force=force, text=text)
        for file, text in files.items():
            output.write_text(file, text)
            click.echo(str(file))
        return
    if kind is None:
        raise click.UsageError(f"specify a kind ({', '.join(WORDS)}), or write all schemas with -o FOLDER")
    output.print_document(texts[f"{kind}.schema.json"])


@output.subcommand(force=True)
@click.argument("file", type=FILE)
@click.option("-o", "--out", type=NEW_FILE, help="Write to this file instead of the screen.")
@click.option("--hash", "only_hash", is_flag=True, help="Print only the SHA-256 of the text.")
@set_option
def flatten_command(
    file: Path, parameters: dict[str, float], out: Path | None, only_hash: bool, force: bool, as_json: bool
) -> None:
    """Write a complete document with everything it extends, includes or repeats, and with all default values.

    Equivalent documents produce the same text and therefore the same hash. File paths are made relative to the location
    of the output.
    """
    from simfoundry.spec.change.flatten import digest, flatten
    from simfoundry.spec.diagnostics import SpecError
    from simfoundry.spec.load import load

    loaded = load(file, parameters=parameters)
    if loaded.spec is None or loaded.errors:
        raise SpecError(loaded.errors)
    text = flatten(loaded.spec, file.parent, out.parent if out is not None else file.parent)
    if out is not None:
        output.protect_output(out, [file, *loaded.files()], force, text)
        output.write_text(out, text)
    if as_json:
        output.print_json({"file": str(file), "out": str(out) if out else None, "hash": digest(text), "text": text})
    elif only_hash:
        click.echo(digest(text))
    elif out is None:
        output.print_document(text)
    else:
        click.echo(f"wrote {out}")


@output.subcommand()
@click.argument("code", required=False)
def explain_command(code: str | None, as_json: bool) -> None:
    """Explain a diagnostic code: its meaning, how to fix it, and examples of incorrect and correct input.

    CODE may be specified with or without the prefix, as SF201 or 201. Without CODE, all codes are listed.
    """
    from simfoundry.spec.check.pages import code_of, grouped, page, titles
    from simfoundry.spec.diagnostics import nearest

    if code is None:
        groups = grouped()
        blocks = ("\n".join((title, *(f"  {c}  {t}" for c, t in codes.items()))) for title, codes in groups.items())
        output.print_result(as_json, {"groups": groups}, "\n\n".join(blocks))
        return
    known = code_of(code)
    if known is None:
        similar = nearest(code if code.lower().startswith("sf") else f"SF{code}", titles())
        hint = similar if similar.startswith("did") else "`simfoundry explain` lists all codes"
        raise SimfoundryError(f"there is no code `{code}`; {hint}")
    found = page(known)
    if as_json:
        output.print_json({"code": found.code, "title": found.title, "markdown": found.markdown})
    elif output.in_color(sys.stdout):
        from rich.console import Console
        from rich.markdown import Markdown

        console = Console()
        console.print(Markdown(found.markdown, code_theme="ansi_dark"), width=min(console.width, LINE_LENGTH))
    else:
        click.echo(found.markdown, nl=False)
