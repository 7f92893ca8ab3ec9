"""Commands that convert to and from other formats: ``import``, ``export``."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from simfoundry.api.scenes import is_compiled_stage
from simfoundry.cli import output
from simfoundry.cli.options import ANY, FILE, NEW_FILE, pairs
from simfoundry.errors import SimfoundryError
from simfoundry.spec.diagnostics import SpecError

if TYPE_CHECKING:
    from simfoundry.frontends.draft import ImportOptions
    from simfoundry.frontends.importer import ImportReport

HEADINGS = {
    "dropped": ("element was left out", "elements were left out"),
    "changed": ("element is expressed differently", "elements are expressed differently"),
    "assumed": ("value was assumed", "values were assumed"),
}


@output.subcommand()
@click.argument("files", nargs=-1, required=True, type=ANY)
@click.option("-o", "--out", type=click.Path(path_type=Path),
              help="Output document (NAME.scene.yaml or NAME.asset.yaml) or folder. "
                   "Default: named after the input file.")  # fmt: skip
@click.option("--package", "packages", multiple=True, metavar="NAME=PATH", callback=pairs,
              help="Folder in which to resolve `package://NAME/…`; may be repeated.")  # fmt: skip
@click.option("--scene", type=FILE, help="Scene for the imported task.")
@click.option("--onto", type=FILE, help="Apply the edits to a compiled stage to this document, keeping its comments.")
@click.option("--bind", "bound", multiple=True, metavar="NAME=OBJECT", callback=pairs,
              help="Bind a name in a BDDL task to an object in --scene; may be repeated.")  # fmt: skip
@click.option("--density", type=click.FloatRange(min=0, min_open=True), metavar="KG_PER_M3",
              help="Density of links and bodies without a mass, such as 600 for wood or 7800 for steel. "
                   "Default: 1000, as in simulators.")  # fmt: skip
@click.option("--force", is_flag=True, help="Replace existing files, including your edits.")
@click.option("--strict", is_flag=True, help="Exit with code 1 if something was left out, changed or assumed.")
def import_command(
    files: tuple[Path, ...], out: Path | None, packages: dict[str, str], scene: Path | None, onto: Path | None,
    bound: dict[str, str], density: float | None, force: bool, strict: bool, as_json: bool,
) -> int:  # fmt: skip
    """Import URDF, MJCF, USD or BDDL files, or scenes and tasks from the paper's release, as documents.

    If a stage was written by `compile`, its original document is restored and the edits made to the stage are applied
    to it. The edits are applied to the document OUT if it exists, or to the document specified with --onto.

    Meshes are written to the folder NAME_files next to the document. Every difference between the file and the document
    is reported. If a file is rejected, nothing is written for it and the exit code is 2.
    """
    from simfoundry.frontends.draft import ImportOptions
    from simfoundry.frontends.importer import import_file

    if onto is not None or (len(files) == 1 and is_compiled_stage(files[0])):
        if len(files) > 1:
            raise SimfoundryError("--onto accepts only one stage")
        return _import_stage(files[0], out or onto or Path(_default_name(files[0])), onto, force, strict, as_json)
    for name, path in packages.items():
        if not Path(path).is_dir():
            raise SimfoundryError(f"--package {name}={path}: `{path}` is not a folder")
    folders = {name: Path(path) for name, path in packages.items()}
    options = ImportOptions(folders, force, scene, bound, density)
    if len(files) == 1 and files[0].is_file() and not (out is not None and out.is_dir()):
        with output.progress_bar(as_json) as progress:
            progress(files[0].name, 0.0)
            report = import_file(files[0], out or Path(_default_name(files[0])), options)
        output.print_result(as_json, report.to_json(), _described(report))
        return output.FINDINGS if strict and report.notes else output.DONE
    if out is None or out.name.endswith(".yaml"):
        raise SimfoundryError("importing several files requires an output folder; pass `-o FOLDER`")
    return _import_all(files, out, options, strict, as_json)


def _import_stage(path: Path, out: Path, onto: Path | None, force: bool, strict: bool, as_json: bool) -> int:
    from simfoundry.frontends.usd.compiled.loading import import_stage

    before = out.read_bytes() if out.is_file() else None
    imported = import_stage(path, out, onto, force)
    changed = before != out.read_bytes()
    report = {
        "source": str(path),
        "out": str(out),
        "changed": changed,
        "notes": [{"prim": n.prim, "message": n.message, "hint": n.hint} for n in imported.notes],
        "disputed": list(imported.disputed),
        "exceptions": dict(imported.exceptions),
    }
    lines = [f"{out}  from the stage {path}: " + ("written" if changed else "no changes")]
    lines += [f"  not applied: {n.prim}: {n.message}" + (f"; {n.hint}" if n.hint else "") for n in imported.notes]
    edited = "edited in both the stage and the document"
    lines += [f"  {name} has an entry of its own now, separate from {rest}" for name, rest in imported.exceptions]
    lines += [f"  {edited}: {disputed}; the values in the stage were kept" for disputed in imported.disputed]
    output.print_result(as_json, report, "\n".join(lines))
    return output.FINDINGS if strict and (imported.notes or imported.disputed) else output.DONE


def _import_all(files: tuple[Path, ...], out: Path, options: ImportOptions, strict: bool, as_json: bool) -> int:
    from simfoundry.frontends.registry import model_suffixes

    jobs = list(_jobs(files, out))
    if not jobs:
        raise SimfoundryError(
            f"could not find any file to import below {', '.join(map(str, files))}; "
            f"supported extensions: {', '.join(model_suffixes())}"
        )
    reports = []
    with output.progress_bar(as_json) as progress:
        for done, (source, target) in enumerate(jobs):
            progress(source.name, done / len(jobs))
            reports.append(_import_one(source, target, options))
    output.print_result(as_json, {"files": [report.to_json() for report in reports]}, _table(reports))
    if any(report.error for report in reports):
        return output.CANNOT
    return output.FINDINGS if strict and any(report.notes for report in reports) else output.DONE


def _import_one(source: Path, target: Path, options: ImportOptions) -> ImportReport:
    """Import one of several files and return the report. Errors are returned instead of raised."""
    from simfoundry.frontends.draft import ImportNote, ImportNoteKind
    from simfoundry.frontends.importer import ImportReport, import_file
    from simfoundry.frontends.usd.compiled.loading import import_stage

    try:
        if not is_compiled_stage(source):
            return import_file(source, target, options)
        imported = import_stage(source, target, None, options.force)
    except (SimfoundryError, SpecError, OSError) as error:
        return ImportReport(str(source), None, error=str(error))
    notes = tuple(ImportNote(ImportNoteKind.DROPPED, note.prim, note.message, note.hint) for note in imported.notes)
    return ImportReport(str(source), str(target), "a compiled stage", notes=notes)


def _jobs(files: tuple[Path, ...], out: Path) -> Iterable[tuple[Path, Path]]:
    """Yield each file with the path of its output document, preserving the folder structure."""
    from simfoundry.frontends.registry import model_suffixes

    suffixes = model_suffixes()
    for path in files:
        if path.is_file():
            yield path, out / _default_name(path)
            continue
        for source in sorted(p for p in path.rglob("*") if p.suffix.lower() in suffixes and p.is_file()):
            if _is_model(source):
                yield source, out / source.relative_to(path).parent / _default_name(source)


def _is_model(path: Path) -> bool:
    """Return True if a file found in a folder is a model, not a package manifest or a file included by a model."""
    if path.suffix.lower() not in (".xml", ".json"):
        return True
    with path.open("rb") as stream:
        head = stream.read(20_000)
    if path.suffix.lower() == ".json":
        return b"objects_info" in head
    return b"<mujoco" in head.replace(b"<mujocoinclude", b"") or b"<robot" in head


def _default_name(path: Path) -> str:
    from simfoundry.frontends.importer import ASSET, SCENE, TASK
    from simfoundry.frontends.registry import task_readers

    kind = path.suffix.lower()
    return path.stem + (TASK if kind in task_readers() else ASSET if kind == ".urdf" else SCENE)


def _described(report: ImportReport) -> str:
    """Return a description of the imported document and of each difference from the file."""
    lines = [f"{report.out}  from {report.format}: {_counts(report)}", *report.more, *_warned_of_masses(report)]
    for kind, heading in HEADINGS.items():
        notes = [note for note in report.notes if note.kind == kind]
        if not notes:
            continue
        lines.append(f"{len(notes)} {heading[len(notes) > 1]}:")
        reasons: dict[str, list[str]] = {}
        for note in notes:
            reasons.setdefault(note.why, []).append(f"{note.what} ({note.detail})" if note.detail else note.what)
        lines += [f"  {_listed(elements)}: {why}" for why, elements in reasons.items()]
    if report.names:
        shown = [f"{old} -> {new}" for old, new in report.names]
        lines.append(f"{len(shown)} name{'s' if len(shown) > 1 else ''} changed: {_listed(shown)}")
    return "\n".join(lines)


def _warned_of_masses(report: ImportReport) -> list[str]:
    """Return a warning that lists the masses computed from the default density, or an empty list if there are none."""
    masses = sorted(report.assumed_masses.items(), key=lambda entry: -entry[1])
    if not masses:
        return []
    count = f"{len(masses)} link has" if len(masses) == 1 else f"{len(masses)} links have"
    shown = [f"{name} {mass:.3g} kg" for name, mass in masses]
    total = sum(report.assumed_masses.values())
    return [
        f"warning: {count} no mass; solid shapes of 1000 kg/m^3 are assumed, for a total of {total:.3g} kg: "
        f"{_listed(shown)}; set the density with --density (such as 600 for wood), or specify `mass:` for each"
    ]


def _listed(names: list[str], most: int = 4) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _counts(report: ImportReport) -> str:
    nouns, singulars = "bodies links joints cameras lights meshes", {"bodies": "body", "meshes": "mesh"}
    counts = {noun: getattr(report, noun) for noun in nouns.split()}
    text = {noun: noun if count > 1 else singulars.get(noun, noun[:-1]) for noun, count in counts.items()}
    return ", ".join(f"{count} {text[noun]}" for noun, count in counts.items() if count)


def _table(reports: list[ImportReport]) -> str:
    """Return one line per file, followed by the totals."""
    width = max(len(report.source) for report in reports)
    lines = []
    for report in reports:
        if report.error:
            lines.append(f"{report.source:<{width}}  refused: {report.error.removeprefix(report.source).lstrip(': ')}")
        else:
            notes = f"; {output.plural(len(report.notes), 'difference')} from the file" if report.notes else ""
            lines.append(f"{report.source:<{width}}  {_counts(report)}{notes}")
            lines += [f"  {line}" for line in _warned_of_masses(report)]
    refused = sum(bool(report.error) for report in reports)
    lines.append(f"{len(reports) - refused} of {len(reports)} imported")
    return "\n".join(lines)


@output.subcommand(force=True)
@click.argument("task", type=FILE)
@click.option("-f", "--format", "format_", required=True, type=click.Choice(["libero", "behavior", "omnigibson"]),
              help="Output format: BDDL for LIBERO or BEHAVIOR, or the task YAML used in the paper's "
                   "release.")  # fmt: skip
@click.option("-o", "--out", type=NEW_FILE, help="Write to this file. Default: standard output.")
@click.option("--strict", is_flag=True, help="Exit with code 1 if something was left out or assumed.")
def export_command(task: Path, format_: str, out: Path | None, force: bool, strict: bool, as_json: bool) -> int:
    """Write a task as BDDL, or in the format used in the paper's release.

    If the format cannot express the goal, the command fails. Parts of the initial state that the format cannot express
    are reported. `simfoundry import` can read all three formats.
    """
    from simfoundry.assets.cache import Cache
    from simfoundry.frontends.task_export import export_task
    from simfoundry.scene.lower import lower_file
    from simfoundry.spec.load import load_kind
    from simfoundry.spec.models.task import TaskSpec

    loaded = load_kind(task, "task/1")
    spec = loaded.spec
    assert isinstance(spec, TaskSpec)
    if as_json and out is None:
        raise SimfoundryError("--json requires an output file; specify one with `-o FILE`")
    export = export_task(spec, lower_file(task.parent / spec.scene, Cache.default(), fetch=False), format_)
    if out is None:
        output.print_document(export.text)
    else:
        output.protect_output(out, [task, *loaded.files()], force, export.text)
        output.write_text(out, export.text)
    if as_json:
        output.print_json({"source": str(task), "out": str(out), "format": format_, "notes": export.notes})
    for note in export.notes if not as_json else ():
        click.echo(f"differs from the task: {note}", err=True)
    return output.FINDINGS if strict and export.notes else output.DONE
