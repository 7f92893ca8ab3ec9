"""Compilation of many scenes in parallel processes, so that a crash or hang does not affect other scenes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from simfoundry.backends.artifact import Artifact
from simfoundry.runtime.workers import Limits, WorkerError, WorkerPool, report_progress
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.files import Loaded
from simfoundry.spec.models.scene import SceneSpec

# Maximum time without a progress report from a worker [s]; the slowest measured decomposition took 300 s.
SILENCE_S = 900.0

# The function that the workers call.
FUNCTION = "simfoundry.targets.batch:compile_job"

COMPILED, CURRENT, FAILED = "compiled", "up to date", "failed"


@dataclass(frozen=True)
class CompileJob:
    """A scene document to compile, with its targets and its build folder."""

    scene: Path
    targets: tuple[str, ...]
    out: Path
    force: bool = False


@dataclass(frozen=True)
class CompileOutcome:
    """The outcome of a job.

    Attributes:
        scene: The path of the scene document.
        out: The build folder.
        state: Either ``compiled``, ``up to date`` or ``failed``.
        targets: The entry file for each target.
        losses: The number of losses for each target.
        error: A sentence that explains the failure, or an empty string.
        findings: The diagnostics reported for the documents.
    """

    scene: str
    out: str
    state: str
    targets: dict[str, str] = field(default_factory=dict)
    losses: dict[str, int] = field(default_factory=dict)
    error: str = ""
    findings: tuple[Diagnostic, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the outcome as plain data for JSON."""
        data = asdict(self) | {"findings": [finding.to_json() for finding in self.findings]}
        return {key: value for key, value in data.items() if value or key in ("targets", "losses")}


def compile_all(
    jobs: Sequence[CompileJob],
    workers: int,
    report: Callable[[str, int], object] = lambda doing, done: None,
    limits: Limits | None = None,
    function: str = FUNCTION,
) -> list[CompileOutcome]:
    """Compile all jobs in ``workers`` processes that call ``function``, and return the outcomes in job order.

    ``report`` may be called from any thread, with the current activity and the number of completed jobs. If a process
    crashes, hangs or runs out of memory, its job fails with an error that names the last activity, and a new process
    replaces the failed one.
    """
    outcomes: dict[int, CompileOutcome] = {}

    def started(k: int, activity: str) -> None:
        report(f"{jobs[k].scene.name}: {activity}", len(outcomes))

    pool = WorkerPool(min(workers, len(jobs)), limits or Limits.shared(SILENCE_S, workers), started)
    try:
        for k, job in enumerate(jobs):
            pool.submit(k, function, job)
        for _ in jobs:
            k, result = pool.next()
            if isinstance(result, WorkerError):
                during = f", while processing {result.doing}" if result.doing else ""
                result = _failure(jobs[k], f"its process {result.how}{during}")
            outcomes[k] = result
            report(jobs[k].scene.name, len(outcomes))
    finally:
        pool.close()
    return [outcomes[k] for k in range(len(jobs))]


def _failure(job: CompileJob, error: str = "", findings: Sequence[Diagnostic] = ()) -> CompileOutcome:
    return CompileOutcome(str(job.scene), str(job.out), FAILED, error=error, findings=tuple(findings))


def compile_job(job: CompileJob) -> CompileOutcome:
    """Compile one scene in this process, unless its build is up to date. Errors are reported in the outcome."""
    from simfoundry.assets.cache import Cache
    from simfoundry.errors import SimfoundryError
    from simfoundry.scene.lower import lower
    from simfoundry.spec.diagnostics import SpecError
    from simfoundry.spec.load import load_scene
    from simfoundry.targets import inputs
    from simfoundry.targets.build import TargetsError, build, is_current
    from simfoundry.targets.find import find_targets

    try:
        report_progress("its documents")
        loaded = load_scene(job.scene)
        found, broken = find_targets(job.targets)
        record = inputs.record(loaded, found)
        if not job.force and not broken and is_current(job.out, record):
            return _read_back(job)
        scene = lower(loaded, Cache.default(), lambda name, done, total: report_progress(_object(loaded, name)))
        report_progress(f"its targets ({', '.join(job.targets)})")
        artifacts = build(scene, job.targets, job.out, job.force, record)
    except TargetsError as error:
        return replace(_outcome(job, FAILED, error.artifacts), error=str(error))
    except SpecError as error:
        return _failure(job, findings=error.diagnostics)
    except SimfoundryError as error:
        return _failure(job, str(error))
    except OSError as error:
        return _failure(job, f"{error.filename or 'a file'}: {error.strerror or error}")
    return _outcome(job, COMPILED, artifacts)


def _outcome(job: CompileJob, state: str, artifacts: Sequence[Artifact]) -> CompileOutcome:
    """Return the outcome for a job that wrote ``artifacts``."""
    entries = {a.target: str(job.out / a.target / a.entry) for a in artifacts}
    return CompileOutcome(str(job.scene), str(job.out), state, entries, {a.target: len(a.losses) for a in artifacts})


def _object(loaded: Loaded, name: str) -> str:
    """Return a description of the current activity, including the name of the object and its asset file."""
    name, colon, doing = name.partition(":")
    asset = loaded.spec.objects[name].asset if isinstance(loaded.spec, SceneSpec) else None
    return f"object `{name}`" + (f" ({asset})" if asset is not None else "") + colon + doing


def _read_back(job: CompileJob) -> CompileOutcome:
    """Return the outcome for a build that is up to date."""
    import json

    from simfoundry.targets.build import LOSSES, MANIFEST

    losses = json.loads((job.out / LOSSES).read_bytes())
    folders = {target: job.out / target for target in losses}
    entries = {t: str(f / json.loads((f / MANIFEST).read_bytes())["entry"]) for t, f in folders.items()}
    counts = {target: len(found["losses"]) for target, found in losses.items()}
    return CompileOutcome(str(job.scene), str(job.out), CURRENT, entries, counts)


def jobs_of(paths: Sequence[Path], targets: tuple[str, ...], out: Path, force: bool) -> Iterator[CompileJob]:
    """Yield a job for each document in ``paths``, and for each scene document below a folder in ``paths``.

    The folder structure is preserved in the build folder. The contents of ``out`` are skipped, as are files and folders
    whose names start with a dot.
    """
    for path in paths:
        if not path.is_dir():
            yield CompileJob(path, targets, out / _stem(path), force)
            continue
        for found in sorted(path.rglob("*.scene.yaml")):
            inside = found.relative_to(path)
            hidden = any(part.startswith(".") for part in inside.parts)
            if not hidden and not found.resolve().is_relative_to(out.resolve()):
                yield CompileJob(found, targets, out / inside.parent / _stem(found), force)


def _stem(path: Path) -> str:
    return path.name.removesuffix(".yaml").removesuffix(".scene")
