"""``simfoundry compile``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import click

from simfoundry.cli.output import DONE, FINDINGS, json_option, print_json, progress_bar, reporting

TARGETS = ("mjcf", "urdf", "pybullet", "usd")


@click.command()
@click.argument("scene", type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.option("-t", "--target", "targets", type=click.Choice(TARGETS), multiple=True, help="Default: all four.")
@click.option("-o", "--out", type=click.Path(path_type=Path, file_okay=False), default=Path("build"), show_default=True)
@click.option("--strict", is_flag=True, help="Exit with 1 where a target cannot keep everything.")
@click.option("--force", is_flag=True, help="Replace target folders even where they hold files of your own.")
@json_option
@reporting
def command(scene: Path, targets: tuple[str, ...], out: Path, strict: bool, force: bool, as_json: bool) -> int:
    """Compile a scene for simulators, each into a folder of its own, with a report of what was lost."""
    from simfoundry.assets.cache import Cache
    from simfoundry.scene.lower import lower_file
    from simfoundry.worlds.build import build, losses_by_target

    with progress_bar(as_json) as progress:
        lowered = lower_file(scene, Cache.default(), lambda name, done, total: progress(name, done / total))
        artifacts = build(lowered, targets or TARGETS, out, force)
    losses = losses_by_target(artifacts)
    if as_json:
        entries = {a.target: str(out / a.target / a.entry) for a in artifacts}
        print_json({"out": str(out), "targets": entries, "losses": losses})
    else:
        for artifact in artifacts:
            count = len(artifact.losses)
            lost = f"{count} loss{'es' if count != 1 else ''}" if count else "nothing lost"
            click.echo(f"{artifact.target:<9} {out / artifact.target / artifact.entry}  ({lost})")
            for line in dropped(losses[artifact.target]):
                click.echo(f"{'':<9} {line}")
        if any(losses.values()):
            click.echo(f"what each target cannot keep: {out / 'loss.json'}")
    return FINDINGS if strict and any(losses.values()) else DONE


def dropped(losses: Sequence[Mapping[str, str]]) -> list[str]:
    """A line for each reason for which something is not there at all: ``no robots.arm: robots are ...``."""
    by_reason: dict[str, list[str]] = {}
    for loss in losses:
        if loss["fidelity"] == "dropped":
            by_reason.setdefault(loss["reason"], []).append(loss["path"])
    lines = []
    for reason, paths in by_reason.items():
        more = f" and {len(paths) - 3} more" if len(paths) > 3 else ""
        lines.append(f"no {', '.join(paths[:3])}{more}: {reason}")
    return lines
