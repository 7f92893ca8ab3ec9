"""Commands that operate on a single scene: ``show``, ``judge``, ``render``, ``settle``, ``synthesize``."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from simfoundry.cli import output
from simfoundry.cli.options import NEW_FILE, NEW_FOLDER, WorldName, camera_option, option, scene_argument, set_option
from simfoundry.cli.studio import serve_studio
from simfoundry.errors import SimfoundryError

if TYPE_CHECKING:
    from simfoundry.worlds.settle import ObjectSettle


@output.subcommand(force=True)
@scene_argument
@set_option
@click.option("--web", is_flag=True, help="Show the scene or task in the browser, and follow changes of the file.")
@option("--port", type=click.IntRange(0, 65535), default=8080, help="Port for --web, or the next free one.")
@click.option("--html", type=NEW_FILE, help="Write the scene to this HTML file, which needs no other files.")
def show_command(
    scene: Path, parameters: dict[str, float], web: bool, port: int, html: Path | None, force: bool, as_json: bool
) -> None:
    """Show a scene as a tree of support relations, with sizes, masses and joints, or in a browser."""
    from simfoundry.scene.summary import summary, tree

    if web:
        if parameters or html is not None:
            raise SimfoundryError("--web shows the document as it is; it cannot be combined with --set or --html")
        serve_studio(scene, as_json, port=port, is_editable=False)
        return
    loaded, spec, lowered = output.lower_scene(scene, as_json, parameters, fetch=False)
    facts = summary(lowered, spec)
    if html is not None:
        from simfoundry.runtime.extras import need_extra
        from simfoundry.studio.export import scene_html

        need_extra("studio", "`show --html`")
        output.protect_output(html, [scene, *loaded.files()], force)
        output.write_text(html, scene_html(lowered))
        output.print_result(as_json, {**facts, "html": str(html)}, str(html))
        return
    output.print_result(as_json, facts, tree(facts))


@output.subcommand()
@scene_argument
@set_option
@click.argument("conditions", nargs=-1)
def judge_command(scene: Path, parameters: dict[str, float], conditions: tuple[str, ...], as_json: bool) -> int:
    """Evaluate predicates in a scene, such as 'Inside(cup, bowl)', and print their values, margins and explanations.

    If no predicates are specified, the relations defined in the scene are evaluated. The exit code is 1 if any
    predicate is false.
    """
    from simfoundry.predicates import Judge, PredicateError
    from simfoundry.scene.state import SceneState
    from simfoundry.spec.models.predicate import ExpressionError, parse_call

    lowered = output.lower_scene(scene, as_json, parameters)[2]
    judge, state = Judge(lowered), SceneState.initial(lowered)
    rows, lines = [], []
    for text in conditions or tuple(str(relation) for relation in lowered.relations):
        try:
            name, verdict = str(parse_call(text)), judge(text, state)
        except (ExpressionError, PredicateError) as error:
            raise SimfoundryError(f"{text}: {error}") from None
        rows.append({"condition": name, "value": verdict.value, "margin": verdict.margin, "why": verdict.why})
        lines.append(f"{'true ' if verdict.value else 'false'}  {verdict.margin:+.4f}  {name}: {verdict.why}")
    if rows or as_json:
        output.print_result(as_json, {"verdicts": rows}, "\n".join(lines))
    return output.DONE if all(row["value"] for row in rows) else output.FINDINGS


@output.subcommand(force=True)
@scene_argument
@set_option
@camera_option
@click.option("-o", "--out", type=NEW_FILE, help="Output file. Default: SCENE-CAMERA.png.")
@option("--engine", type=click.Choice(["auto", "egl", "osmesa", "raycast"]), default="auto",
        help="Renderer: MuJoCo with EGL or OSMesa, or a ray caster that does not need a GL driver.")  # fmt: skip
def render_command(
    scene: Path, parameters: dict[str, float], camera: str | None, out: Path | None, engine: str, force: bool,
    as_json: bool,
) -> None:  # fmt: skip
    """Render a PNG image from a camera in a scene. No display is required."""
    from simfoundry.render.montage import save_png
    from simfoundry.worlds.render import choose_engine, render

    loaded, spec, lowered = output.lower_scene(scene, as_json, parameters)
    view = output.choose_camera(lowered, spec, camera)
    chosen = choose_engine(engine)
    target = out or Path(f"{lowered.name}-{view.name}.png")
    output.protect_output(target, [scene, *loaded.files()], force)
    save_png(target, render(lowered, view, engine=chosen))
    facts = {"out": str(target), "camera": view.name, "engine": chosen.value}
    output.print_result(as_json, facts, f"{target}  ({view.name}, {view.width} x {view.height}, {chosen})")


@output.subcommand(force=True)
@scene_argument
@set_option
@click.option("-o", "--out", type=NEW_FILE, help="Write the settled scene to this file.")
@option("--engine", type=WorldName(), default="mujoco")
def settle_command(
    scene: Path, parameters: dict[str, float], out: Path | None, engine: str, force: bool, as_json: bool
) -> int:
    """Simulate a scene until it is at rest, and report how its objects moved.

    With -o, the settled scene is written in canonical form, without the comments in the input. The exit code is 1 if
    an object moves, tilts, topples when nudged, penetrates another object, loses its support, falls, or never comes to
    rest.
    """
    from simfoundry.scene.state import with_state
    from simfoundry.spec.yaml.write import to_yaml
    from simfoundry.worlds import open_world
    from simfoundry.worlds.settle import settle

    if out is not None and out.resolve().parent != scene.resolve().parent:
        raise SimfoundryError("write the settled scene to the original folder, because mesh paths are relative to it")
    loaded, spec, lowered = output.lower_scene(scene, as_json, parameters)
    with output.progress_bar(as_json) as progress, open_world(lowered, engine) as world:
        settled = settle(world, progress=progress)
    if out is not None:
        document = to_yaml(with_state(spec, lowered, settled.state))
        output.protect_output(out, [scene, *loaded.files()], force, document)
        output.write_text(out, document)
    text = settle_table(settled.objects)
    if not settled.at_rest:
        text += "\nthe scene did not come to rest in time"
    elif out is None and not settled.passed:
        stem, _, rest = scene.name.partition(".")
        settled_file = scene.with_name(f"{stem}_settled.{rest}")
        text += f"\nto keep the settled poses: simfoundry settle {scene} -o {settled_file}"
    output.print_result(as_json, {**settled.to_json(), "out": None if out is None else str(out)}, text)
    return output.DONE if settled.passed else output.FINDINGS


def settle_table(objects: Iterable[ObjectSettle]) -> str:
    """Return a table that shows how settling affected each object."""
    rows = [f"{'object':<22}{'penetration':>16}{'drift':>10}{'tilt':>9}  supports"]
    for o in objects:
        depth = f"{1000 * o.penetration_before:.1f} -> {1000 * o.penetration_after:.1f} mm"
        motion = f"{1000 * o.drift:>7.1f} mm{o.tilt_deg:>5.1f} deg"
        rows.append(f"{o.name:<22}{depth:>16}{motion}  {', '.join(o.supports)}  [{'; '.join(o.problems) or 'ok'}]")
    return "\n".join(rows)


@output.subcommand(force=True)
@scene_argument
@set_option
@camera_option
@click.option("-o", "--out", type=NEW_FOLDER, required=True, help="Write the capture to this folder.")
@option("--seed", type=int, default=0, help="Seed for the sensor noise.")
@click.option("--masks", is_flag=True, help="Also write instance masks.")
def synthesize_command(
    scene: Path, parameters: dict[str, float], camera: str | None, out: Path, seed: int, masks: bool, force: bool,
    as_json: bool,
) -> None:  # fmt: skip
    """Render a scene as a synthetic capture: color and depth images with the noise and holes of a real sensor."""
    from simfoundry.capture.synthesize import CAPTURE_FILES, synthesize

    loaded, spec, lowered = output.lower_scene(scene, as_json, parameters)
    view = output.choose_camera(lowered, spec, camera)
    for name in CAPTURE_FILES:
        output.protect_output(out / name, [scene, *loaded.files()], force)
    path = synthesize(lowered, view, out, seed, masks, truth=scene)
    output.print_result(as_json, {"capture": str(path), "camera": view.name, "seed": seed}, str(path))
