"""Command output: findings, JSON, progress, and exit codes for errors."""

from __future__ import annotations

import errno
import json
import math
import os
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TextIO

import click

from simfoundry.errors import SimfoundryError
from simfoundry.spec.change.text_diff import unified_diff as unified_diff
from simfoundry.spec.diagnostics import Diagnostic, SpecError, nearest

if TYPE_CHECKING:
    from simfoundry.scene.model import Camera, Scene
    from simfoundry.spec.files import Loaded
    from simfoundry.spec.models.scene import SceneSpec

P = ParamSpec("P")

DONE, FINDINGS, CANNOT = 0, 1, 2

json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON for scripts.")
force_option = click.option("--force", is_flag=True,
                            help="Replace the output file even if simfoundry did not write it.")  # fmt: skip


class CannotError(click.ClickException):
    """Raised if a command cannot run. The message is one sentence that states the reason."""

    exit_code = CANNOT


def reporting(command: Callable[P, int | None]) -> Callable[P, int]:
    """Convert findings and errors to output and an exit code, so that invalid input never causes a traceback."""

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
            raise CannotError("the command ran out of memory; use smaller meshes or images") from None
        except OSError as error:
            if error.errno == errno.EPIPE:  # the reader closed the pipe; click handles this
                raise
            raise CannotError(f"{error.filename or 'a file'}: {error.strerror or error}") from None

    return wrapped


def subcommand(
    name: str | None = None,
    *,
    as_json: bool = True,
    force: bool = False,
    cls: type[click.Command] = click.Command,
) -> Callable[[Callable[..., int | None]], click.Command]:
    """Convert a function to a command that reports errors.

    Args:
        name: Name of the command; defaults to the name of the function.
        as_json: Whether to add the ``--json`` option after the command's own options.
        force: Whether to add the ``--force`` option after the command's own options.
        cls: Class of the command.
    """

    def decorate(function: Callable[..., int | None]) -> click.Command:
        wrapped: Any = reporting(function)
        own = list(getattr(wrapped, "__click_params__", []))
        wrapped.__click_params__ = []
        for option in [json_option] * as_json + [force_option] * force:
            wrapped = option(wrapped)
        wrapped.__click_params__ += own  # click reverses the list, so the first entry is shown last in the help
        return click.command(name, cls=cls)(wrapped)

    return decorate


def print_json(data: Any) -> None:
    """Print data as JSON to standard output, with null for numbers that JSON cannot represent."""
    print_json_text(json.dumps(_finite(data), indent=2, ensure_ascii=False, allow_nan=False))


def _finite(data: Any) -> Any:
    """Replace NaN and infinity with None."""
    if isinstance(data, Mapping):
        return {key: _finite(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_finite(value) for value in data]
    return None if isinstance(data, float) and not math.isfinite(data) else data


def print_result(as_json: bool, data: Any, text: str) -> None:
    """Print ``data`` as JSON if ``as_json`` is set, or print ``text`` otherwise."""
    if as_json:
        print_json(data)
    else:
        click.echo(text)


def print_json_text(text: str) -> None:
    """Print JSON text, escaping non-ASCII characters if standard output does not use a Unicode encoding."""
    click.echo(text if _is_unicode(sys.stdout) else re.sub(r"[^\x00-\x7f]", lambda c: json.dumps(c[0])[1:-1], text))


def print_document(text: str) -> None:
    """Print a document verbatim.

    Raises:
        CannotError: If a character cannot be represented in the encoding of standard output.
    """
    try:
        text.encode(sys.stdout.encoding or "utf-8")
    except UnicodeEncodeError as error:
        raise CannotError(
            f"the output encoding {sys.stdout.encoding} cannot represent {text[error.start]!a}; write to a file "
            "with -o, or set PYTHONIOENCODING=utf-8"
        ) from None
    click.echo(text, nl=False)


def allow_any_text() -> None:
    """Print question marks for characters that the terminal cannot encode, instead of failing."""
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
    """Return True if a stream is a terminal and the user did not request plain text (https://no-color.org)."""
    return stream.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def lower_scene(
    path: Path, quiet: bool, parameters: Mapping[str, float] | None = None, fetch: bool = True
) -> tuple[Loaded, SceneSpec, Scene]:
    """Load and lower a scene, showing a progress bar.

    Args:
        path: The scene document.
        quiet: Whether to hide the progress bar.
        parameters: Values that replace those of the scene's parameters.
        fetch: Whether to download robot models that are not available locally.
    """
    from simfoundry.assets.cache import Cache
    from simfoundry.scene.lower import lower
    from simfoundry.spec.load import load_scene
    from simfoundry.spec.models.scene import SceneSpec

    loaded = load_scene(path, parameters)
    assert isinstance(loaded.spec, SceneSpec)
    with progress_bar(quiet) as progress:
        scene = lower(loaded, Cache.default(), lambda name, done, total: progress(name, done / total), fetch)
    return loaded, loaded.spec, scene


def protect_output(out: Path | None, inputs: Iterable[Path] = (), force: bool = False, text: str | None = None) -> None:
    """Ensure that writing to ``out`` would not destroy user data. If ``out`` is None, do nothing.

    ``text`` is the new content of a document, which may replace an identical file.

    Raises:
        OutputError: If user data would be destroyed.
    """
    if out is not None:
        from simfoundry.runtime.files import ensure_replaceable

        ensure_replaceable(out, inputs, force, text.encode() if text is not None else None)


def write_text(path: Path, text: str) -> None:
    """Write a file atomically."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, data: bytes) -> None:
    """Write a binary file atomically."""
    from simfoundry.runtime.files import write_atomically

    write_atomically(path, data)


def write_in_place(path: Path, text: str) -> None:
    """Write to a file while preserving its permissions. If the file is a symbolic link, write to the link's target."""
    from simfoundry.runtime.files import write_in_place

    write_in_place(path, text.encode())


def plural(count: int, noun: str) -> str:
    """Format a count with its noun, as in ``no conflicts`` or ``1 conflict``."""
    return f"{count or 'no'} {noun}{'s' if count != 1 else ''}"


def choose_camera(scene: Scene, spec: SceneSpec, name: str | None) -> Camera:
    """Return the camera called ``name``.

    By default, this is the scene's viewpoint or, if the viewpoint is not a camera, the first camera.
    """
    cameras = {c.name: c for c in scene.cameras}
    if not cameras:
        raise CannotError(f"{scene.name} has no camera; add one under `cameras`")
    viewpoint = spec.viewpoint if spec.viewpoint in cameras else None
    chosen = name or viewpoint or next(iter(cameras))
    if chosen not in cameras:
        raise CannotError(f"no camera is called `{chosen}`; {nearest(chosen, cameras)}")
    return cameras[chosen]


# Maximum time without output in a log [s]; after about this time, people start to suspect a hang.
LINE_S = 10.0


@contextmanager
def progress_bar(quiet: bool) -> Iterator[Callable[[str, float], None]]:
    """Show the progress of long steps on standard error, as a bar on a terminal and as occasional lines elsewhere.

    The environment variable ``SIMFOUNDRY_PROGRESS=never`` suppresses the lines, which is useful for logs that are
    compared with each other.
    """
    if quiet or (not sys.stderr.isatty() and os.environ.get("SIMFOUNDRY_PROGRESS") == "never"):
        yield lambda stage, share: None
        return
    if not sys.stderr.isatty():  # avoid importing rich, which is slow
        last = time.monotonic()

        def print_occasionally(stage: str, _share: float) -> None:
            nonlocal last
            if time.monotonic() - last >= LINE_S:
                last = time.monotonic()
                click.echo(f"{stage} …", err=True)

        yield print_occasionally
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description:<24}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=1.0)
        yield lambda stage, share: bar.update(task, description=stage, completed=share)
