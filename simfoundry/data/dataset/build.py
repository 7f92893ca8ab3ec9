"""Build a dataset: episodes in parallel, then its files, which appear under their final name at the very end.

Everything is written to ``.NAME.building`` next to the dataset. Finished episodes are kept there, so that an
interrupted build can be resumed. The bytes of a dataset depend only on its plan, and neither on the number of processes
nor on interruptions.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from simfoundry.data.dataset.contents import DatasetContents
from simfoundry.data.dataset.episodes import EpisodeBuilder
from simfoundry.data.dataset.features import DatasetInfo
from simfoundry.data.dataset.formats import StagedEpisode, dataset_format
from simfoundry.data.dataset.manifest import DatasetManifest, read_manifest, write_manifest
from simfoundry.data.dataset.pictures import PictureSource
from simfoundry.data.dataset.plan import DatasetPlan, EpisodePlan
from simfoundry.data.dataset.staging import (
    clear_unfinished,
    dataset_statistics,
    episode_folder,
    episode_statistics,
    write_staged,
)
from simfoundry.errors import OutputError, SimfoundryError
from simfoundry.runtime.executors import LOCAL, JobLimits, Machines, carry_out_jobs, open_executor
from simfoundry.runtime.files import locked_folder, write_file
from simfoundry.runtime.workers import WorkerError, at_worker_exit

# Maximum duration of an episode [s]; rendering a minute with several cameras takes a few minutes.
SILENCE_S = 3600.0

LIMITS = JobLimits(SILENCE_S)


@dataclass(frozen=True)
class EpisodeJob:
    """An episode to stage, with everything that the process that builds it needs to know."""

    planned: EpisodePlan
    info: DatasetInfo
    contents: DatasetContents | None
    pictures: PictureSource | None
    formats: tuple[str, ...]
    staging: Path


# Callback that receives the number of finished episodes.
Built = Callable[[int], None]


def build_dataset(
    plan: DatasetPlan,
    out: Path,
    built: Built = lambda done: None,
    workers: int | None = 1,
    machines: Machines = LOCAL,
) -> list[Path]:
    """Build a dataset, and return its folder; with several formats, a folder in ``out`` for each of them.

    A dataset that is already complete is not built again.

    Raises:
        SimfoundryError: If a source or a format cannot be used, or if ``out`` contains something else.
    """
    folders = [out] if len(plan.formats) == 1 else [out / name for name in plan.formats]
    for name in plan.formats:
        dataset_format(name).check(plan.info)
    if _is_complete(plan, out, folders):
        return folders
    with _staging(out, plan) as staging:
        jobs = [
            EpisodeJob(planned, plan.info, plan.contents, plan.pictures, plan.formats, staging)
            for planned in plan.episodes
            if not episode_folder(staging, planned.header.index).is_dir()
        ]
        done = len(plan.episodes) - len(jobs)
        built(done)
        if jobs:
            todo, stage = iter(jobs), f"{stage_episode.__module__}:stage_episode"
            executor = open_executor(machines, workers, LIMITS)
            with closing(carry_out_jobs(executor, stage, lambda: next(todo, None))) as finished:
                for job, outcome in finished:
                    _raise(job, outcome)
                    done += 1
                    built(done)
        _assemble(plan, staging, out)
    return folders


def _is_complete(plan: DatasetPlan, out: Path, folders: list[Path]) -> bool:
    """Return True if a dataset with the same plan exists.

    Raises:
        OutputError: If the folder contains something else.
    """
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return False
    found = [read_manifest(folder) if folder.is_dir() else None for folder in folders]
    if all(manifest is not None and manifest.plan == plan.digest for manifest in found):
        return True
    what = "contains a different dataset" if any(found) else "exists and is not a dataset of SimFoundry"
    raise OutputError(f"{out} {what}; choose another folder, or delete it")


@contextmanager
def _staging(out: Path, plan: DatasetPlan) -> Iterator[Path]:
    """Yield the locked folder in which a dataset is staged. Episodes of a different plan are removed first."""
    staging = out.parent / f".{out.name}.building"
    staging.mkdir(parents=True, exist_ok=True)
    with locked_folder(staging, "is being written by another build; wait for it, or choose another folder"):
        mark = staging / "plan.json"
        try:
            known = json.loads(mark.read_bytes())["plan"]
        except (OSError, ValueError, KeyError, TypeError):
            known = ""
        if known != plan.digest:
            for path in staging.iterdir():
                shutil.rmtree(path) if path.is_dir() else path.unlink()
            write_file(mark, json.dumps({"plan": plan.digest}).encode())
        clear_unfinished(staging)
        yield staging
        shutil.rmtree(staging)


class _Process:
    """The builder that a process keeps between episodes."""

    builder: EpisodeBuilder | None = None
    key: tuple[DatasetInfo, Path] | None = None


def close() -> None:
    """Close the worlds of this process."""
    if _Process.builder is not None:
        _Process.builder.close()
    _Process.builder = _Process.key = None


def stage_episode(job: EpisodeJob) -> SimfoundryError | OSError | None:
    """Build an episode and write its files.

    Errors are returned, because workers report exceptions without their type.
    """
    at_worker_exit(close)
    try:
        if _Process.builder is None or _Process.key != (job.info, job.staging):
            close()
            _Process.builder = EpisodeBuilder(job.info, job.contents, job.pictures)
            _Process.key = (job.info, job.staging)
        write_staged(_Process.builder.build(job.planned), job.info, job.formats, job.staging)
    except (SimfoundryError, OSError) as error:
        return error
    return None


def _raise(job: EpisodeJob, outcome: object) -> None:
    """Raise the error that prevented an episode from being built, if any."""
    if isinstance(outcome, WorkerError):
        raise SimfoundryError(f"the worker process for episode {job.planned.header.index} {outcome.how}")
    if isinstance(outcome, SimfoundryError | OSError):
        raise outcome


def _assemble(plan: DatasetPlan, staging: Path, out: Path) -> None:
    """Write the dataset from its staged episodes."""
    places = [episode_folder(staging, planned.header.index) for planned in plan.episodes]
    headers = [planned.header for planned in plan.episodes]
    statistics = [episode_statistics(place, plan.info) for place in places]
    total = dataset_statistics(places, plan.info)
    assembled = staging / "assembled"
    shutil.rmtree(assembled, ignore_errors=True)
    for name in plan.formats:
        found = dataset_format(name)
        staged = [StagedEpisode(h, p / name, s) for h, p, s in zip(headers, places, statistics, strict=True)]
        folder = assembled if len(plan.formats) == 1 else assembled / name
        folder.mkdir(parents=True)
        found.assemble(plan.info, staged, total, folder)
        notes = (*plan.notes, *found.losses(plan.info))
        write_manifest(folder, DatasetManifest(name, plan.digest, plan.info, headers, total, notes))
    if out.is_dir():
        out.rmdir()  # it is empty
    assembled.rename(out)
