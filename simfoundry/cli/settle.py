"""``simfoundry settle``."""

from __future__ import annotations

from pathlib import Path

import click

from simfoundry.cli.options import NEW_FILE, scene_argument
from simfoundry.cli.output import DONE, FINDINGS, CannotError, lower_scene, print_json, progress_bar, subcommand
from simfoundry.cli.worlds import WorldName


@subcommand(force=True)
@scene_argument
@click.option("-o", "--out", type=NEW_FILE, help="Write the settled scene to this file.")
@click.option("--engine", type=WorldName(), default="mujoco", show_default=True)
def command(scene: Path, out: Path | None, engine: str, force: bool, as_json: bool) -> int:
    """Simulate a scene until it is at rest, and report how its objects moved.

    Without -o nothing is written. The output is in canonical form, without the comments of the input. The exit code is
    1 if an object fails: it moved, tilted, topples when nudged, penetrates another, lost its support, fell, or never
    came to rest.
    """
    from simfoundry.runtime.files import ensure_replaceable, write_atomically
    from simfoundry.scene.state import with_state
    from simfoundry.spec.yaml.write import to_yaml
    from simfoundry.worlds import open_world
    from simfoundry.worlds.settle import settle

    if out is not None and out.resolve().parent != scene.resolve().parent:
        raise CannotError(
            "write the settled scene beside the original, because its mesh paths are relative to that folder"
        )
    loaded, spec, lowered = lower_scene(scene, as_json)
    if out is not None:
        ensure_replaceable(out, [scene, *loaded.files()], force)
    with progress_bar(as_json) as progress, open_world(lowered, engine) as world:
        settled = settle(world, progress=progress)
    if out is not None:
        write_atomically(out, to_yaml(with_state(spec, lowered, settled.state)).encode())
    if as_json:
        print_json({**settled.to_json(), "out": None if out is None else str(out)})
    else:
        click.echo(settle_table(settled.to_json()["objects"]))
        if not settled.at_rest:
            click.echo("the scene did not come to rest in time")
        elif out is None and not settled.passed:
            click.echo(f"to keep the settled poses: simfoundry settle {scene} -o {_beside(scene)}")
    return DONE if settled.passed else FINDINGS


def _beside(scene: Path) -> Path:
    """Return a name for the settled scene: ``desk_settled.scene.yaml``."""
    stem, _, rest = scene.name.partition(".")
    return scene.with_name(f"{stem}_settled.{rest}")


def settle_table(objects: list[dict[str, object]]) -> str:
    """Return a table of the effect of settling on each object."""
    rows = [f"{'object':<22}{'penetration':>16}{'drift':>10}{'tilt':>9}  supports"]
    for o in objects:
        depth = f"{_mm(o['penetration_before'])} -> {_mm(o['penetration_after'])} mm"
        on = ", ".join(o["supports"]) if isinstance(o["supports"], list | tuple) else ""
        problems = o["problems"]
        verdict = "; ".join(problems) if isinstance(problems, list | tuple) and problems else "ok"
        rows.append(
            f"{o['name']!s:<22}{depth:>16}{_mm(o['drift']):>7} mm{_float(o['tilt_deg']):>5.1f} deg  {on}  [{verdict}]"
        )
    return "\n".join(rows)


def _mm(value: object) -> str:
    return f"{_float(value) * 1000:.1f}"


def _float(value: object) -> float:
    return float(value) if isinstance(value, int | float) else 0.0
