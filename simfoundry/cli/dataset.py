"""Commands for datasets: ``dataset build``, ``dataset show`` and ``dataset check``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from simfoundry.cli import output
from simfoundry.cli.options import ANY, NEW_FILE, NEW_FOLDER, jobs_option, on_option, option, resumable
from simfoundry.runtime.executors import Machines

# Argument for the folder of a dataset.
DATASET = click.Path(path_type=Path, exists=True, file_okay=False)


@click.group()
def dataset_command() -> None:
    """Build, show and check datasets of demonstrations for training libraries."""


@dataset_command.command("build")
@click.argument("source", type=ANY)
@click.option("-f", "--format", "formats", multiple=True, metavar="FORMAT",
              help="File format, such as lerobot-v3 or robomimic. Can be repeated. Default: as in SOURCE.")  # fmt: skip
@click.option("-p", "--profile", metavar="PROFILE",
              help="Conventions of the training library, such as lerobot or gr00t. Default: as in SOURCE.")  # fmt: skip
@click.option("-o", "--out", type=NEW_FOLDER, help="Output folder. Default: build/datasets/NAME.")
@jobs_option(1)
@on_option
@output.json_option
@output.reporting
def build_command(
    source: Path, formats: tuple[str, ...], profile: str | None, out: Path | None, jobs: int | None,
    machines: Machines, as_json: bool,
) -> int:  # fmt: skip
    """Build a dataset from a document, or from a folder of demonstrations.

    SOURCE is a .dataset.yaml document, or a folder that `simfoundry record` wrote. Images are rendered while the
    demonstrations are replayed. With several formats, OUT contains a folder for each of them. The dataset does not
    depend on --jobs and --on.

    Finished episodes are kept next to OUT, so you can repeat the command to resume an interrupted build. OUT appears
    when the dataset is complete.
    """
    from simfoundry.api.datasets import dataset_plan, default_folder, run_build

    plan = dataset_plan(source, formats, profile)
    folder = default_folder(plan) if out is None else out
    with output.progress_bar(as_json) as progress, resumable(folder):
        built = run_build(plan, folder, jobs, machines, progress)
    info, notes = plan.info, _notes(built)
    if as_json:
        counts = {"episodes": info.episodes, "frames": info.frames, "splits": dict(info.splits)}
        output.print_json({"datasets": [str(one) for one in built], **counts, "notes": notes})
    else:
        for name, one in zip(plan.formats, built, strict=True):
            click.echo(f"{one}: {output.plural(info.episodes, 'episode')}, {info.frames} frames, {name}")
        for note in dict.fromkeys(text for texts in notes.values() for text in texts):
            click.echo(f"note: {note}", err=True)
    return output.DONE


def _notes(folders: list[Path]) -> dict[str, list[str]]:
    from simfoundry.data.dataset.manifest import read_manifest

    found = {folder.name: read_manifest(folder) for folder in folders}
    return {name: list(manifest.notes) for name, manifest in found.items() if manifest is not None and manifest.notes}


@dataset_command.command("show")
@click.argument("folder", type=DATASET)
@click.option("--page", type=NEW_FILE, help="Also write a page with videos and plots of the first episodes.")
@option("--episodes", type=click.IntRange(1, 100), default=6, help="Number of episodes on the page.")
@output.json_option
@output.force_option
@output.reporting
def show_command(folder: Path, page: Path | None, episodes: int, as_json: bool, force: bool) -> int:
    """Show the contents and the statistics of a dataset.

    FOLDER is a dataset in any known format, also one that another program wrote. The page is a single file that works
    without a network.
    """
    from simfoundry.api.datasets import dataset_summary

    found = dataset_summary(folder)
    if page is not None:
        from simfoundry.reports.dataset import dataset_page
        from simfoundry.runtime.files import ensure_replaceable, write_atomically

        ensure_replaceable(page, force=force)
        with output.progress_bar(as_json) as progress:
            text = dataset_page(folder, episodes, lambda k, of: progress(f"episode {k + 1} of {of}", k / of))
        write_atomically(page, text.encode())
    output.print_result(as_json, {**found, **({"page": str(page)} if page is not None else {})}, _shown(found))
    if page is not None and not as_json:
        click.echo(f"wrote {page}")
    return output.DONE


@dataset_command.command("check")
@click.argument("folder", type=DATASET)
@click.option("--no-images", is_flag=True, help="Do not decode images and videos, which takes most of the time.")
@output.json_option
@output.reporting
def check_command(folder: Path, no_images: bool, as_json: bool) -> int:
    """Check the files of a dataset.

    Counts, shapes, types and ranges of all values, the number and size of images, and the statistics are checked, and
    that no two episodes are the same or show the same demonstration in different splits. The exit code is 1 if there
    are problems.
    """
    from simfoundry.data.dataset.checking import check_stored

    with output.progress_bar(as_json) as progress:
        found = check_stored(folder, not no_images, lambda k, of: progress(f"{k} of {of} episodes", k / of))
    if as_json:
        output.print_json({"folder": str(folder), "problems": [problem.to_json() for problem in found]})
    else:
        for problem in found:
            click.echo(problem.text, err=True)
        click.echo(f"{folder}: {output.plural(len(found), 'problem')}")
    return output.FINDINGS if found else output.DONE


def _shown(found: Mapping[str, Any]) -> str:
    """Return a summary as text."""
    lines = [f"{found['name']}: {found['episodes']} episodes, {found['frames']} frames, {_minutes(found['seconds'])}"]
    facts = {
        "format": found["format"],
        "profile": found["profile"],
        "license": found["license"],
        "robot": found["robot"],
        "rate": f"{found['fps']:g} Hz",
        "actions": found["action_space"],
        "splits": ", ".join(f"{name} {count}" for name, count in found["splits"].items()),
        "sources": ", ".join(
            f"{name} {entry['episodes']} ({entry['share']:.0%} of draws)" for name, entry in found["sources"].items()
        ),
    }
    lines += [f"  {key:<9} {text}" for key, text in facts.items() if text]
    for text, count in list(found["instructions"].items())[:MAX_INSTRUCTIONS]:
        lines.append(f"  {count:>6} × {text}")
    for name, feature in found["features"].items():
        shape = " × ".join(map(str, feature["shape"])) or "1"
        unit = f" [{feature['unit']}]" if feature["unit"] else ""
        camera = f", camera {feature['camera']}" if feature["camera"] else ""
        lines.append(f"\n{name}  {feature['kind']}, {feature['dtype']}, {shape}{camera}{unit}")
        lines += _table(feature["names"], found["statistics"].get(name))
    lines += [f"\nnote: {note}" for note in found["notes"]]
    return "\n".join(lines)


# Maximum number of instructions in the summary; a recipe may draw hundreds.
MAX_INSTRUCTIONS = 10


def _minutes(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 120 else f"{seconds / 60:.1f} min"


def _table(names: list[str], statistics: Mapping[str, Any] | None) -> list[str]:
    """Return the statistics of a feature as lines, one for each value or channel."""
    if statistics is None:
        return []
    columns = [key for key in ("min", "q01", "mean", "q99", "max", "std") if key in statistics]
    rows = [_flat(statistics[key]) for key in columns]
    labels = names or (["red", "green", "blue"] if len(rows[0]) == 3 else [""] * len(rows[0]))
    width = max([len(label) for label in labels] + [4])
    lines = ["  " + " " * width + "".join(f"{key:>11}" for key in columns)]
    for k, label in enumerate(labels[: len(rows[0])]):
        lines.append(f"  {label:<{width}}" + "".join(f"{row[k]:>11.4g}" for row in rows))
    return lines


def _flat(values: Any) -> list[float]:
    """Return nested numbers as one list."""
    return [number for value in values for number in _flat(value)] if isinstance(values, list) else [float(values)]
