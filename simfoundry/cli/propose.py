"""``simfoundry propose``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from simfoundry.cli.options import NEW_FOLDER, scene_argument
from simfoundry.cli.output import DONE, FINDINGS, CannotError, print_json, progress_bar, subcommand
from simfoundry.cli.worlds import WorldName

if TYPE_CHECKING:
    from simfoundry.cousins.tasks.context import TaskContext
    from simfoundry.cousins.tasks.enumeration import Proposal


@subcommand()
@scene_argument
@click.option(
    "-n", "count", type=click.IntRange(1, 1000), default=20, show_default=True, help="Number of tasks to propose."
)
@click.option("-o", "--out", type=NEW_FOLDER, help="Write the task documents into this folder.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the order of proposals.")
@click.option("--about", multiple=True, metavar="OBJECT", help="Propose only tasks with this object; may be repeated.")
@click.option(
    "--payload", type=click.FloatRange(0, min_open=True),
    help="Payload of the robot [kg]. Default: its known payload.",
)  # fmt: skip
@click.option("--vlm", metavar="MODEL", help="Ask this model, e.g. `openai:gpt-5`, instead of enumerating affordances.")
@click.option("--base-url", metavar="URL", help="Address of a server with an OpenAI-compatible API.")
@click.option("--form", type=click.Choice(["typed", "paper"]), default="typed", show_default=True,
              help="Format of the model's answer: typed, or the text of the paper's prompt.")  # fmt: skip
@click.option("-c", "--camera", help="Camera whose picture the model sees. Default: the scene's first.")
@click.option("--engine", "engines", type=WorldName(), multiple=True, default=("mujoco",),
              help="Engine that checks that a reached goal persists; may be repeated. Default: MuJoCo.")  # fmt: skip
@click.option("--rejected", is_flag=True, help="Also list the rejected tasks, with the reasons.")
def command(
    scene: Path,
    count: int,
    out: Path | None,
    seed: int,
    about: tuple[str, ...],
    payload: float | None,
    vlm: str | None,
    base_url: str | None,
    form: str,
    camera: str | None,
    engines: tuple[str, ...],
    rejected: bool,
    as_json: bool,
) -> int:
    """Propose tasks for a scene, from its affordances or a model's suggestions, each verified to be feasible.

    A task is accepted if its names exist, its goal does not hold already, physics finds a state in which the goal
    holds, a robot can grasp and reach the objects, and no other accepted task is equivalent. The exit code is 1 if
    there are fewer tasks than requested.
    """
    from simfoundry.assets.cache import Cache
    from simfoundry.cousins.tasks.context import TaskContext
    from simfoundry.cousins.tasks.enumeration import checked, scene_reference, write
    from simfoundry.cousins.tasks.enumeration import to_json as row

    folder = out or scene.parent
    setting = TaskContext.load(scene, Cache.default(), payload, engines)
    _known(about, [o.name for o in setting.twin.scene.objects])
    reference = scene_reference(scene, folder)
    if vlm is None:
        found = _enumerated(setting, count, seed, reference, about, as_json)
    else:
        found = _asked(setting, scene, vlm, base_url, count, form, camera, reference, about)
    found = checked(found, folder)
    accepted = [proposal for proposal in found if proposal.accepted]
    files = write(found, out) if out is not None else []
    if as_json:
        print_json({"accepted": len(accepted), "seen": len(found), "proposals": [row(p, folder) for p in found]})
    else:
        _print(found, accepted, rejected)
        click.echo(f"{len(accepted)} tasks, {len(found) - len(accepted)} not accepted")
        if files:
            click.echo(f"wrote {len(files)} documents to {out}")
    return DONE if len(accepted) >= min(count, len(found)) and accepted else FINDINGS


def _known(about: tuple[str, ...], names: list[str]) -> None:
    from simfoundry.spec.diagnostics import nearest

    for name in about:
        if name not in names:
            raise CannotError(f"no object is called `{name}`; {nearest(name, names)}")


def _enumerated(
    setting: TaskContext, count: int, seed: int, reference: str, about: tuple[str, ...], quiet: bool
) -> list[Proposal]:
    from simfoundry.cousins.tasks.enumeration import enumerate_tasks

    with progress_bar(quiet) as progress:
        return enumerate_tasks(
            setting, count, seed, reference, about, progress=lambda n, seen: progress(f"{seen} tried", n / count)
        )


def _asked(
    setting: TaskContext,
    scene: Path,
    model: str,
    base_url: str | None,
    count: int,
    form: str,
    camera: str | None,
    reference: str,
    about: tuple[str, ...],
) -> list[Proposal]:
    from simfoundry.cousins.tasks.proposals import propose_tasks
    from simfoundry.models.vlm import Vlm

    asked: Any = Vlm(model, base_url)
    picture = _picture(setting, scene, camera)
    return propose_tasks(asked, setting, picture, count, "paper" if form == "paper" else "typed", reference, about)


def _picture(setting: TaskContext, scene: Path, name: str | None) -> bytes:
    """Render the scene from a camera as PNG."""
    import tempfile

    from simfoundry.cli.output import choose_camera
    from simfoundry.render.montage import save_png
    from simfoundry.spec.load import load_scene
    from simfoundry.spec.models.scene import SceneSpec
    from simfoundry.worlds.render import choose_engine, render

    spec = load_scene(scene).spec
    assert isinstance(spec, SceneSpec)
    camera = choose_camera(setting.twin.scene, spec, name)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.png"
        save_png(file, render(setting.twin.scene, camera, engine=choose_engine("auto")))
        return file.read_bytes()


def _print(found: list[Proposal], accepted: list[Proposal], rejected: bool) -> None:
    wide = max((len(p.name) for p in (found if rejected else accepted)), default=0)
    for proposal in found if rejected else accepted:
        said = proposal.task.instruction if proposal.task is not None else proposal.goal
        click.echo(f"{'+' if proposal.accepted else '-'} {proposal.name:<{wide}}  {proposal.goal}  {said}")
        for reason in proposal.reasons:
            click.echo(f"    {reason.code}: {reason.text}")
