"""Commands that train policies: ``train``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from simfoundry.api.ranges import RANGES
from simfoundry.cli import output
from simfoundry.cli.options import ANY, NEW_FOLDER, commercial_only_option, jobs_option, on_option, option, resumable
from simfoundry.runtime.executors import Machines

if TYPE_CHECKING:
    from simfoundry.api.training import Trained


@output.subcommand("train")
@click.argument("sources", nargs=-1, required=True, type=ANY)
@click.option("-n", "--count", type=click.IntRange(*RANGES["count"]),
              help="Number of demonstrations. Default: 200, or all that are already recorded.")  # fmt: skip
@click.option("--augment", type=click.IntRange(*RANGES["count"]), metavar="N",
              help="Generate N demonstrations from the recorded ones, and learn from them.")  # fmt: skip
@option("-o", "--out", type=NEW_FOLDER, default=Path("build/train"))
@option("-p", "--policy", metavar="POLICY", default="expert",
        help="Policy that demonstrates, as in `simfoundry record`.")  # fmt: skip
@option("--seed", "seeds", type=click.IntRange(*RANGES["seed"]), multiple=True, default=[0],
        help="Seed of the training; repeat the option to train several policies.")  # fmt: skip
@click.option("--minutes", type=click.FloatRange(0, 10_000, min_open=True),
              help="Time budget of each training, which limits the number of steps.")  # fmt: skip
@option("--steps", type=click.IntRange(*RANGES["steps"]), default=10_000, help="Number of optimization steps.")
@click.option("--camera", "cameras", multiple=True,
              help="Learn from images of this camera instead of true poses; may be repeated.")  # fmt: skip
@option("--image-width", type=click.IntRange(16, 512), default=64, help="Width of these images [px].")
@click.option("--cousins", type=click.IntRange(1, 1_000_000),
              help="Number of cousins of a recipe. Default: the count in the recipe.")  # fmt: skip
@click.option("--eval", "tasks", multiple=True, type=ANY, metavar="TASKS",
              help="Task, or folder of tasks, to evaluate; may be repeated.")  # fmt: skip
@click.option("--rollouts", type=click.IntRange(*RANGES["rollouts"]),
              help="Number of rollouts of each task. Default: 25 in total, but at least one of each.")  # fmt: skip
@option("--record-seed", type=click.IntRange(*RANGES["seed"]), default=0,
        help="Seed for the initial states of the demonstrations.")  # fmt: skip
@option("--eval-seed", type=click.IntRange(*RANGES["seed"]), default=1,
        help="Seed for the initial states of the evaluation.")  # fmt: skip
@click.option("--video/--no-video", default=None,
              help="Record a video of each rollout. Default: only if rendering is possible.")  # fmt: skip
@commercial_only_option
@jobs_option(1)
@on_option
@click.option("--require", type=click.FloatRange(0, 1), help="Exit with code 1 if a success rate is below this value.")
def train_command(
    sources: tuple[Path, ...], count: int | None, augment: int | None, out: Path, policy: str, seeds: tuple[int, ...],
    minutes: float | None, steps: int, cameras: tuple[str, ...], image_width: int, cousins: int | None,
    tasks: tuple[Path, ...], rollouts: int | None, record_seed: int, eval_seed: int, video: bool | None,
    commercial_only: bool, jobs: int | None, machines: Machines, require: float | None, as_json: bool,
) -> int:  # fmt: skip
    """Record demonstrations, train a small policy on them, and evaluate it.

    SOURCES are task documents, folders that contain task documents, a recipe of cousins, or folders of demonstrations.
    The policy is a flow-matching network that reads the true poses of the objects, or images of the cameras that
    --camera names. It is evaluated from initial states that it has not seen: with several tasks, a fifth of them, at
    most 25, is held out, unless --eval names the tasks. With --augment, few demonstrations are recorded, and many are
    generated from them as in `simfoundry augment`.

    OUT contains the cousins, the demonstrations, the augmented ones, the policies, the evaluation, and report.html.
    Finished stages are not repeated, so you can repeat the command to resume an interrupted run; a resumed training
    gives the same weights. To run a policy again, use `simfoundry eval TASK -p baseline:OUT/policies/NAME`.

    The exit code is 1 if rollouts are missing or if a success rate is below --require.
    """
    from simfoundry.api.training import TrainingRun, run_training
    from simfoundry.cli.evaluate import can_film
    from simfoundry.train.fit import FitOptions

    run = TrainingRun(
        sources=sources,
        folder=out,
        options=FitOptions(steps=steps),
        seeds=seeds,
        minutes=minutes,
        count=count,
        augment=augment,
        policy=policy,
        record_seed=record_seed,
        tasks=tasks,
        rollouts=rollouts,
        eval_seed=eval_seed,
        cousins=cousins,
        commercial_only=commercial_only,
        jobs=jobs,
        machines=machines,
        cameras=cameras,
        image_width=image_width,
        video=can_film(("mujoco",)) if video is None else video,
    )
    with output.progress_bar(as_json) as progress, resumable(out):
        trained = run_training(run, progress)
    return _print_trained(trained, require, as_json)


def _print_trained(trained: Trained, require: float | None, as_json: bool) -> int:
    from simfoundry.api.training import PAGE

    evaluation = trained.evaluation
    rates = trained.rates
    low = {label: rate for label, rate in rates.items() if require is not None and rate.of and rate.share < require}
    if as_json:
        output.print_json({**trained.report, "missing": evaluation.missing, "troubles": list(evaluation.troubles)})
    else:
        if trained.report["augmentation"] is not None:
            made = trained.report["augmentation"]
            click.echo(f"{made['demonstrations']} demonstrations generated in {made['attempts']} attempts")
        for label, rate in rates.items():
            facts = trained.summaries[label].spec.training
            learned = f"{output.plural(facts.demonstrations, 'demonstration')}, {facts.steps} steps"
            click.echo(f"{label}: {rate}  ({learned}; baseline:{trained.policies[label]})")
        for trouble in evaluation.troubles:
            click.echo(trouble, err=True)
        if trained.report["seen_starts"]:
            seen = f"{trained.report['seen_starts']} of {len(evaluation.records)} rollouts"
            click.echo(f"{seen} started from the initial state of a demonstration", err=True)
        if evaluation.missing:
            click.echo(f"{evaluation.missing} rollouts are missing; repeat the command to run them", err=True)
        for label, rate in low.items():
            click.echo(f"{label}: {rate.share:.0%} is below {require:.0%}", err=True)
        click.echo(f"{trained.folder / PAGE}")
    return output.FINDINGS if evaluation.missing or low else output.DONE


@output.subcommand("configure", force=True)
@click.argument("dataset", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option("--for", "trainer", required=True, type=click.Choice(["lerobot", "openpi", "gr00t"]),
              help="Trainer to write the configuration for.")  # fmt: skip
@click.option("-o", "--out", type=NEW_FOLDER, help="Output folder. Default: build/training/NAME.")
@click.option("--name", help="Name of the training. Default: the name of the dataset.")
@click.option("--model", default="",
              help="Model to train: act, diffusion, vqbet, smolvla, pi0 or pi05 (LeRobot); pi05 or pi0 (openpi); n1.6 "
                   "or n1.7 (GR00T). Default: the first of them.")  # fmt: skip
@option("--steps", type=click.IntRange(1, 100_000_000), default=20_000, help="Number of optimization steps.")
@option("--batch", type=click.IntRange(1, 100_000), default=32, help="Number of examples in a step.")
@option("--seed", type=click.IntRange(*RANGES["seed"]), default=0, help="Seed of the training.")
def configure_command(
    dataset: Path, trainer: str, out: Path | None, name: str | None, model: str, steps: int, batch: int, seed: int,
    force: bool, as_json: bool,
) -> None:  # fmt: skip
    """Write a training configuration for LeRobot, openpi or GR00T.

    DATASET is a folder that `simfoundry dataset build` wrote: with the profile lerobot for LeRobot, openpi-droid for
    openpi, and gr00t for GR00T. OUT contains the configuration, and the command prints how to start the training in the
    trainer's own environment.
    """
    from simfoundry.train.trainers.configuration import TrainerOptions, configure, read_built, training_name

    built = read_built(dataset)
    options = TrainerOptions(training_name(name or built.info.name), model, steps, batch, seed)
    folder = out or Path("build/training") / f"{options.name}_{trainer}"
    found = configure(built, trainer, options, folder)
    for file, text in found.files.items():
        output.protect_output(folder / file, [], force, text)
        output.write_text(folder / file, text)
    if as_json:
        commands = [list(command) for command in found.commands]
        facts = {"files": [str(folder / file) for file in found.files], "environment": dict(found.environment)}
        output.print_json({**facts, "commands": commands, "notes": list(found.notes)})
        return
    for note in found.notes:
        click.echo(note, err=True)
    for line in found.shell_lines():
        click.echo(line)
