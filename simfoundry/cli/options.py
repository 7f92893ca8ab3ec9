"""Arguments and options shared by several commands."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import click

from simfoundry.errors import SimfoundryError
from simfoundry.runtime.executors import JOBS, Machines

FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])

# An option whose help shows its default.
option = partial(click.option, show_default=True)

ANY = click.Path(path_type=Path, exists=True)
FILE = click.Path(path_type=Path, exists=True, dir_okay=False)
FOLDER = click.Path(path_type=Path, exists=True, file_okay=False)
NEW_FILE = click.Path(path_type=Path, dir_okay=False)
NEW_FOLDER = click.Path(path_type=Path, file_okay=False)

scene_argument = click.argument("scene", type=FILE)
commercial_only_option = click.option(
    "--commercial-only", is_flag=True, help="Refuse models that may not be used commercially."
)
camera_option = click.option("-c", "--camera", help="Camera to use. Default: the scene's viewpoint or first camera.")


def shard(_context: click.Context, _option: click.Parameter, value: str | None) -> tuple[int, int] | None:
    """Parse an option of the form ``I/N``, with I from 1 to N."""
    if value is None:
        return None
    match = re.fullmatch(r"(\d{1,6})/(\d{1,6})", value)
    if match is None or not 1 <= int(match[1]) <= int(match[2]):
        raise click.BadParameter(f"expected I/N with I from 1 to N, such as 2/4, but got `{value}`")
    return int(match[1]), int(match[2])


def pairs(_context: click.Context, option: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    """Parse options of the form ``NAME=VALUE``."""
    found = {name: value for name, _, value in (text.partition("=") for text in values)}
    for name, value in found.items():
        if not name or not value:
            raise click.BadParameter(f"expected {option.metavar}, but got `{name}`")
    return found


def numbers(_context: click.Context, option: click.Parameter, values: tuple[str, ...]) -> dict[str, float]:
    """Parse options of the form ``NAME=NUMBER``."""
    found: dict[str, float] = {}
    for name, value in (text.partition("=")[::2] for text in values):
        try:
            found[name] = int(value) if re.fullmatch("[-+]?[0-9]{1,15}", value) else float(value)
        except ValueError:
            raise click.BadParameter(f"expected {option.metavar}, but got `{name}={value}`") from None
        if not name or not math.isfinite(found[name]):
            raise click.BadParameter(f"expected {option.metavar}, but got `{name}={value}`")
    return found


def _machines(_context: click.Context, _option: click.Parameter, value: str) -> Machines:
    try:
        return Machines.parse(value)
    except SimfoundryError as error:
        raise click.BadParameter(str(error)) from None


on_option = option(
    "--on", "machines", metavar="local|ray[:ADDRESS]", default="local", callback=_machines,
    help="Where to run: on this machine, or on a Ray cluster.",
)  # fmt: skip


def jobs_option(default: int | None) -> Callable[[FunctionT], FunctionT]:
    """Return the option for the number of parallel processes, with its default on this machine."""
    number = "one per core" if default is None else str(default)
    text = f"Number of parallel processes. Default: {number}; on a Ray cluster, one per CPU."
    return click.option("-j", "--jobs", type=click.IntRange(*JOBS), help=text)


set_option = click.option(
    "--set", "parameters", multiple=True, metavar="NAME=NUMBER", callback=numbers,
    help="Value of a parameter of the scene, such as gap=0.1. Can be repeated.",
)  # fmt: skip


@contextmanager
def resumable(out: Path) -> Iterator[None]:
    """Print how to resume a run if the user interrupts it."""
    try:
        yield
    except KeyboardInterrupt:
        click.echo(f"stopped; the results so far are in {out}; repeat the command to resume", err=True)
        sys.exit(130)


class WorldName(click.ParamType):  # type: ignore[type-arg]  # generic only from click 8.4 on; 8.1 is supported
    """The name of a simulator that can run scenes. Names are looked up on use, so ``--help`` loads no simulators."""

    name = "simulator"

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return the name if the target can run scenes."""
        from simfoundry.worlds import UnknownWorldError, find_world

        try:
            find_world(value)
        except UnknownWorldError as error:
            self.fail(str(error), param, ctx)
        return value


def task_documents(paths: Iterable[Path]) -> list[Path]:
    """Return the task documents in some paths, and say how many were left out because a review rejected them.

    Raises:
        SimfoundryError: If there are none.
    """
    from simfoundry.cousins.run.review import usable_tasks

    tasks, left_out = usable_tasks(paths)
    if left_out:
        folders = ", ".join(dict.fromkeys(str(path.parent) for path in left_out))
        count = f"{len(left_out)} cousin{'s' * (len(left_out) != 1)}"
        click.echo(f"{count} in {folders} left out, because a review rejected them", err=True)
    return tasks
