"""Output of commands: findings, JSON, progress, and exit codes for errors."""

from __future__ import annotations

import errno
import json
import os
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TextIO

import click

from simfoundry.errors import SimfoundryError
from simfoundry.spec.diagnostics import Diagnostic, SpecError, nearest

if TYPE_CHECKING:
    from simfoundry.scene.model import Camera, Scene
    from simfoundry.spec.files import Loaded
    from simfoundry.spec.models.scene import SceneSpec

P = ParamSpec("P")

DONE, FINDINGS, CANNOT = 0, 1, 2

json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON for scripts.")
force_option = click.option(
    "--force", is_flag=True, help="Replace the output file even if simfoundry did not write it."
)


class CannotError(click.ClickException):
    """A condition that keeps a command from running, stated in one sentence."""

    exit_code = CANNOT


def reporting(command: Callable[P, int | None]) -> Callable[P, int]:
    """Turn findings and errors into output and an exit code; bad input never shows a traceback."""

    @wraps(command)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> int:
        try:
            return command(*args, **kwargs) or DONE
        except SpecError as error:
            print_findings(error.diagnostics, bool(kwargs.get("as_json")))
            return CANNOT
        except SimfoundryError as error:
            raise CannotError(str(error)) from None
        except ModuleNotFoundError as error:
            from simfoundry.runtime.extras import how_to_install

            name = error.name or "a package"
            raise CannotError(
                f"{name} is not installed; install with `{how_to_install(name)}` (`simfoundry doctor` lists everything)"
            ) from None
        except MemoryError:
            raise CannotError("there is not enough memory for this; use smaller meshes or pictures") from None
        except OSError as error:
            if error.errno == errno.EPIPE:  # the reader closed the pipe; click handles this
                raise
            raise CannotError(f"{error.filename or 'a file'}: {error.strerror or error}") from None

    return wrapped


def subcommand(
    name: str | None = None, *, as_json: bool = True, force: bool = False
) -> Callable[[Callable[..., int | None]], click.Command]:
    """Turn a function into a reporting command, with ``--force`` and ``--json`` after its own options."""

    def decorate(function: Callable[..., int | None]) -> click.Command:
        wrapped: Any = reporting(function)
        own = list(getattr(wrapped, "__click_params__", []))
        wrapped.__click_params__ = []
        for option in [json_option] * as_json + [force_option] * force:
            wrapped = option(wrapped)
        wrapped.__click_params__ += own  # click reverses the list: the first entry comes last in the help
        return click.command(name)(wrapped)

    return decorate


def print_json(data: Any) -> None:
    """Print JSON to standard output."""
    print_json_text(json.dumps(data, indent=2, ensure_ascii=False))


def print_json_text(text: str) -> None:
    """Print JSON text, with escapes if standard output is not encoded as Unicode."""
    escaped = text if _is_unicode(sys.stdout) else re.sub(r"[^\x00-\x7f]", lambda c: json.dumps(c[0])[1:-1], text)
    click.echo(escaped)


def print_document(text: str) -> None:
    """Print a document verbatim.

    Raises :class:`CannotError` if the encoding of standard output lacks one of its characters.
    """
    try:
        text.encode(sys.stdout.encoding or "utf-8")
    except UnicodeEncodeError as error:
        raise CannotError(
            f"the output is encoded as {sys.stdout.encoding}, which has no {text[error.start]!a}; write to a file "
            "with -o, or set PYTHONIOENCODING=utf-8"
        ) from None
    click.echo(text, nl=False)


def allow_any_text() -> None:
    """Replace characters that the terminal cannot encode with question marks instead of failing."""
    for stream in (sys.stdout, sys.stderr):
        if not _is_unicode(stream) and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")


def _is_unicode(stream: TextIO) -> bool:
    return (stream.encoding or "").lower().replace("-", "").startswith("utf")


def print_findings(findings: list[Diagnostic], as_json: bool = False) -> None:
    """Print findings as JSON on standard output, or in compiler style on standard error."""
    if as_json:
        print_json({"findings": [d.to_json() for d in findings]})
    elif findings:
        from simfoundry.spec.check.report import findings_text

        click.echo(findings_text(findings, in_color(sys.stderr)), err=True, color=True)


def in_color(stream: TextIO) -> bool:
    """Return whether to color a stream: a terminal without a request for plain text (https://no-color.org)."""
    return stream.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def lower_scene(path: Path, quiet: bool, fetch: bool = True) -> tuple[Loaded, SceneSpec, Scene]:
    """Load and lower a scene with a progress bar; without ``fetch`` no robot model is downloaded."""
    from simfoundry.assets.cache import Cache
    from simfoundry.scene.lower import lower
    from simfoundry.spec.load import load_scene
    from simfoundry.spec.models.scene import SceneSpec

    loaded = load_scene(path)
    assert isinstance(loaded.spec, SceneSpec)
    with progress_bar(quiet) as progress:
        scene = lower(loaded, Cache.default(), lambda name, done, total: progress(name, done / total), fetch)
    return loaded, loaded.spec, scene


def protect_output(out: Path | None, inputs: Iterable[Path] = (), force: bool = False) -> None:
    """Raise :class:`OutputError` if writing a file, if there is one to write, would destroy user data."""
    if out is not None:
        from simfoundry.runtime.files import ensure_replaceable

        ensure_replaceable(out, inputs, force)


def write_text(path: Path, text: str) -> None:
    """Write a file atomically."""
    from simfoundry.runtime.files import write_atomically

    write_atomically(path, text.encode())


def write_in_place(path: Path, text: str) -> None:
    """Write to the file itself instead of replacing a link to it, and preserve its permissions."""
    target = path.resolve()
    mode = target.stat().st_mode if target.exists() else None
    write_text(target, text)
    if mode is not None:
        target.chmod(mode)


def plural(count: int, noun: str) -> str:
    """Return a count with its noun: ``no conflicts``, ``1 conflict``."""
    return f"{count or 'no'} {noun}{'s' if count != 1 else ''}"


def choose_camera(scene: Scene, spec: SceneSpec, name: str | None) -> Camera:
    """Return the camera called ``name``, by default the scene's viewpoint or its first camera."""
    cameras = {c.name: c for c in scene.cameras}
    if not cameras:
        raise CannotError(f"{scene.name} has no camera; add one under `cameras`")
    viewpoint = spec.viewpoint if spec.viewpoint in cameras else None
    chosen = name or viewpoint or next(iter(cameras))
    if chosen not in cameras:
        raise CannotError(f"no camera is called `{chosen}`; {nearest(chosen, cameras)}")
    return cameras[chosen]


LINE_S = 10.0
"""Longest time without output in a log [s]; people start to suspect a hang after about that long."""


def _line_now_and_then() -> Callable[[str, float], None]:
    """Print the current step if nothing has been printed for :data:`LINE_S`."""
    last = time.monotonic()

    def say(stage: str, _share: float) -> None:
        nonlocal last
        if time.monotonic() - last >= LINE_S:
            last = time.monotonic()
            click.echo(f"{stage} …", err=True)

    return say


@contextmanager
def progress_bar(quiet: bool) -> Iterator[Callable[[str, float], None]]:
    """Show a progress bar for long steps on standard error, or occasional lines if it is not a terminal.

    ``SIMFOUNDRY_PROGRESS=never`` suppresses the lines, for logs that are compared.
    """
    if quiet or (not sys.stderr.isatty() and os.environ.get("SIMFOUNDRY_PROGRESS") == "never"):
        yield lambda stage, share: None
        return
    if not sys.stderr.isatty():  # avoid importing rich, which is slow
        yield _line_now_and_then()
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description:<24}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=1.0)
        yield lambda stage, share: bar.update(task, description=stage, completed=share)
