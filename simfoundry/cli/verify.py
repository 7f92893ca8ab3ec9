"""Commands that check simulators: ``verify``, ``doctor``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from simfoundry.cli import output
from simfoundry.cli.options import ANY, NEW_FILE, option
from simfoundry.errors import SimfoundryError
from simfoundry.spec.files import files_below

if TYPE_CHECKING:
    from simfoundry.verify.engines import InstalledEngine, VerifyEngine
    from simfoundry.verify.run import BehaviorResult, ReadbackResult, RestResult, SceneBuilds

    Found = Mapping[str, InstalledEngine | None]


class VerifyResults(NamedTuple):
    """The results of a verification: values read back, measured behaviors, and rest poses."""

    readings: Sequence[ReadbackResult]
    results: Sequence[BehaviorResult]
    rested: Sequence[RestResult]

    @property
    def ok(self) -> bool:
        """True if every difference has a known reason."""
        from simfoundry.verify.run import ProofStatus

        outcomes: list[ReadbackResult | BehaviorResult | RestResult] = [*self.readings, *self.results, *self.rested]
        return all(outcome.verdict in (ProofStatus.OK, ProofStatus.KNOWN) for outcome in outcomes)


@output.subcommand(force=True)
@click.argument("specs", nargs=-1, type=ANY)
@click.option("--engine", "engines", multiple=True, metavar="NAME",
              help="Engine in which to verify; may be repeated. Default: all engines that are found.")  # fmt: skip
@option("--behaviors/--no-behaviors", default=True, help="Also measure behaviors.")
@click.option("--build", type=click.Path(path_type=Path, exists=True, file_okay=False),
              help="Verify this existing build instead of compiling the scene.")  # fmt: skip
@click.option("--python", "pythons", multiple=True, metavar="[ENGINE=]PATH",
              help="Also look for engines in this Python interpreter.")  # fmt: skip
@click.option("--require", multiple=True, metavar="NAME", help="Fail if this engine is not found.")
@option("--timeout", type=click.FloatRange(min=1), default=180.0, help="Time limit for each engine and build [s].")
@click.option("--html", type=NEW_FILE, help="Write an HTML report with tables and images to this file.")
@option("-j", "--jobs", type=click.IntRange(min=1), default=1, help="Number of engines to run in parallel.")
def verify_command(
    specs: tuple[Path, ...], engines: tuple[str, ...], behaviors: bool, build: Path | None, pythons: tuple[str, ...],
    require: tuple[str, ...], timeout: float, html: Path | None, force: bool, jobs: int, as_json: bool,
) -> int:  # fmt: skip
    """Load builds of scenes in real simulators and compare the loaded values with the scene.

    SPECS are scenes, or folders that contain scenes. By default, each scene is compiled for the verification; with
    --build, an existing build of one scene is verified instead. Behaviors are measured on test mechanisms with a known
    solution, such as a pendulum, and by simulating each scene for two seconds. Without SPECS, only the test mechanisms
    are measured.

    Engines are looked up in the current Python interpreter, in the interpreters specified with --python, and in those
    listed in the SIMFOUNDRY_ENGINES environment variable (separated by commas). Each engine runs in a separate process:
    if an engine crashes or hangs, this is reported and the other engines continue.

    The exit code is 1 if a value differs from the scene without an entry in the loss report, if a behavior deviates
    without a known reason, or if an engine fails.
    """
    from simfoundry.verify.engines import all_engines, find_engine, find_installed, interpreters

    paths = list(files_below(specs, ".scene.yaml", "scenes"))
    if build is not None and len(paths) != 1:
        raise SimfoundryError("--build requires exactly one scene: the scene from which the build was compiled")
    if not paths and not behaviors:
        raise SimfoundryError("there is nothing to verify: specify a scene, or omit --no-behaviors")
    output.protect_output(html, paths, force)
    required = [find_engine(name) for name in require]
    chosen = [find_engine(name) for name in engines] or all_engines()
    wanted = {engine.name: engine for engine in (*chosen, *required)}
    found = find_installed(wanted, interpreters(pythons, wanted.values()))
    with ExitStack() as stack:
        progress = stack.enter_context(output.progress_bar(as_json))
        subjects = _subjects(stack, paths, build, found, progress)
        if build is not None:
            found = {n: f for n, f in found.items() if f is None or n in subjects[0].builds}
        verified = _verify(subjects, found, behaviors, jobs, timeout, progress)
        if html is not None:
            from simfoundry.reports.verification import page
            from simfoundry.verify.behaviors import BEHAVIORS
            from simfoundry.verify.tables import picture

            pictures = {s.name: picture(s.scene) for s in subjects}
            text = page(verified.readings, verified.results, BEHAVIORS, found, pictures, verified.rested)
            output.write_text(html, text)
    missing = [engine.name for engine in required if found.get(engine.name) is None]
    if as_json:
        output.print_json(_json(verified, found, wanted))
    else:
        _print(verified, found, wanted)
    for name in missing:
        click.echo(f"{name} is required, but it was not found or there is no build for it", err=True)
    return output.DONE if verified.ok and not missing else output.FINDINGS


def _subjects(
    stack: ExitStack, paths: Sequence[Path], build: Path | None, found: Found, progress: Callable[[str, float], None]
) -> list[SceneBuilds]:
    """Lower all scenes, and compile them for the available engines."""
    import tempfile

    from simfoundry.assets.cache import Cache
    from simfoundry.scene.lower import lower_file
    from simfoundry.verify.run import SceneBuilds, built

    here = [f.engine for f in found.values() if f is not None]
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="simfoundry-verify-")))
    subjects = []
    for k, path in enumerate(paths):
        progress(f"compile {path.name}", 0.3 * k / len(paths))
        scene = lower_file(path, Cache.default())
        name = path.name.removesuffix(".scene.yaml")
        is_shared = sum(other.name == path.name for other in paths) > 1
        subject = built(f"{path.parent.name}/{name}" if is_shared else name, scene, here, folder / str(k))
        if build is not None:
            there = {engine.name: place for engine in here if (place := engine.folder_in(build)) is not None}
            if not there:
                targets = ", ".join(dict.fromkeys(engine.build.name for engine in here))
                raise SimfoundryError(f"{build} contains none of {targets}; pass the folder written by `compile -o`")
            subject = SceneBuilds(subject.name, scene, there, subject.losses)
        subjects.append(subject)
    return subjects


def _verify(
    subjects: Sequence[SceneBuilds], found: Found, behaviors: bool, jobs: int, timeout: float,
    progress: Callable[[str, float], None],
) -> VerifyResults:  # fmt: skip
    from simfoundry.verify.behaviors import BEHAVIORS
    from simfoundry.verify.run import measure_behaviors, read_subjects, settle_subjects

    here = [f for f in found.values() if f is not None]
    readable = [f for f in here if all(f.engine.name in s.builds for s in subjects)]
    stepping = sum(f.engine.spec.steps for f in here)
    work = len(subjects) * len(readable) + (stepping * (len(BEHAVIORS) + len(subjects)) if behaviors else 0)
    done = 0

    def report(engine: str, units: int) -> None:
        nonlocal done
        done += units
        progress(engine, 0.3 + 0.7 * done / max(1, work))  # compilation is 30% of the progress

    return VerifyResults(
        read_subjects(subjects, readable, report, jobs, timeout) if subjects else [],
        measure_behaviors(BEHAVIORS, here, report, jobs, timeout) if behaviors else [],
        settle_subjects(subjects, readable, report, jobs, timeout) if behaviors else [],
    )


def _json(verified: VerifyResults, found: Found, wanted: Mapping[str, VerifyEngine]) -> dict[str, Any]:
    engines: dict[str, dict[str, Any]] = {}
    for name, f in found.items():
        engines[name] = {"found": f is not None}
        if f is None:
            engines[name] |= {"install": wanted[name].spec.install}
        else:
            engines[name] |= {"version": f.version, "python": str(f.python), "target": f.engine.build.name}
    return {
        "ok": verified.ok,
        "engines": engines,
        "readings": [r.to_json() for r in verified.readings],
        "behaviors": [asdict(m) for m in verified.results],
        "left_alone": [asdict(r) for r in verified.rested],
    }


def _print(verified: VerifyResults, found: Found, wanted: Mapping[str, VerifyEngine]) -> None:
    from simfoundry.reports.verification import summary
    from simfoundry.verify import tables
    from simfoundry.verify.behaviors import BEHAVIORS

    readings, results, rested = verified
    shown = [tables.readings_table(readings, found)] if readings else []
    shown += [tables.behaviors_table(results, BEHAVIORS, found)] if results else []
    shown += [tables.rested_table(rested, found)] if rested else []
    sections = {
        "differences": tables.details(readings, results, rested),
        "lost as reported": tables.known_lines(readings, results),
        "notes": tables.stale_lines(readings),
        "not found": [tables.absent_line(wanted[n]) for n, f in found.items() if f is None],
    }
    shown += ["\n  ".join([f"{title}:", *lines]) for title, lines in sections.items() if lines]
    click.echo("\n\n".join([*shown, summary(readings, results, rested)]))


@output.subcommand()
def doctor_command(as_json: bool) -> int:
    """Show installed and missing components, and how to install them.

    The list includes packages, extras, known robots, renderers and foundation models. Nothing is downloaded. The exit
    code is 1 if a required component is missing.
    """
    from simfoundry.worlds.doctor import examine

    parts = examine()
    if as_json:
        output.print_json({"parts": [asdict(part) for part in parts]})
    else:
        for section, group in groupby(parts, lambda part: part.section):
            click.echo(f"{'' if section == parts[0].section else chr(10)}{section}")
            for part in group:
                mark = "ok     " if part.version else ("MISSING" if part.required else "absent ")
                click.echo(f"  {mark} {part.name:<22} {part.version:<20} {part.purpose}")
                if not part.version:
                    click.echo(f"          {'':<22} -> {part.remedy}")
    return output.FINDINGS if any(part.required and not part.version for part in parts) else output.DONE
