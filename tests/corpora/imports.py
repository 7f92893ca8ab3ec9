"""Public models imported, compiled and read back, against what their engines say of the original.

``python -m tests.corpora.imports [FOLDER ...]`` takes what the folders hold, one corpus for each folder in them (or
those that SIMFOUNDRY_CORPUS names), or else ``../shared/data`` and pybullet_data. Of each file it asks its own engine:
PyBullet for URDF, MuJoCo for MJCF, OpenUSD for USD. What that loads has to come back from a compiled import with its
masses, joints, poses and, by MuJoCo at random joint states, its mass matrix. Refusals are counted by their reasons.
Then ``--mutations`` corrupted files are imported: each has to give documents or a sentence, in bounded time.

Files belong to two halves by the hash of their path: `tuned`, which may be looked at while mending, and `held`.
Exit code 1 where anything breaks, or where less than 90% of what the engines load comes back equal.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import random
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue

from simfoundry.runtime.workers import Limits, Worker, WorkerError
from tests.corpora.importing.files import OBTAIN, Job, jobs_below, sampled
from tests.corpora.importing.mutants import mutant
from tests.corpora.importing.outcome import Outcome

DATA = Path(__file__).parents[3] / "shared/data"
BAR = 0.9
"""Share of what its own engine loads that has to come back equal."""

LIMITS = Limits(180, 12 * 2**30)
"""Seconds and bytes for one file: the largest take a minute where nothing else runs."""

MUTANT_LIMITS = Limits(120, 8 * 2**30)


def usual_jobs() -> Iterator[Job]:
    """The shared data and what comes with PyBullet."""
    for corpus in ("scenes", "articulated", "robots"):
        for job in jobs_below(DATA / corpus) if (DATA / corpus).is_dir() else ():
            if job.path.parent.name != "common" and job.path.name != "geometry.usda":
                yield Job(corpus, job.path, f"{corpus}/{job.key}")
    spec = importlib.util.find_spec("pybullet_data")
    if spec is not None and spec.origin is not None:
        for job in jobs_below(Path(spec.origin).parent):
            yield Job("pybullet_data", job.path, f"pybullet_data/{job.path.relative_to(Path(spec.origin).parent)}")


class Pool:
    """Workers that measure, each file in the process of one of them."""

    def __init__(self, count: int, limits: Limits) -> None:
        self.count, self.free = count, SimpleQueue[Worker]()
        for _ in range(count):
            self.free.put(Worker(limits))

    def outcome(self, function: str, job: Job, file: Path) -> Outcome:
        """What a function of :mod:`tests.corpora.importing.measure` gives, or how its process ended."""
        worker = self.free.get()
        try:
            made: Outcome = worker.call(f"tests.corpora.importing.measure:{function}", job.corpus, str(file))
        except WorkerError as error:
            made = Outcome(job.corpus, str(file), broke=error.how)
        finally:
            self.free.put(worker)
        made.file = job.key
        return made

    def close(self) -> None:
        for _ in range(self.count):
            self.free.get().close()


def measured(jobs: list[Job], workers: int) -> list[Outcome]:
    """The outcome of each file."""
    pool = Pool(workers, LIMITS)
    try:
        with ThreadPoolExecutor(workers) as threads:
            return list(threads.map(lambda job: pool.outcome("measure", job, job.path), jobs))
    finally:
        pool.close()


def corrupted(jobs: list[Job], count: int, seed: int, workers: int) -> list[Outcome]:
    """The outcomes of ``count`` corrupted files, which lie beside the originals while they are imported."""
    pool = Pool(workers, MUTANT_LIMITS)

    def one(k: int) -> Outcome:
        rng = random.Random(f"{seed} {k}")
        job = jobs[k % len(jobs)]
        done, data = mutant(job.path.read_bytes(), job.path.suffix.lower(), rng)
        place = job.path.with_name(f".mutant_{seed}_{k}{job.path.suffix}")
        place.write_bytes(data)
        try:
            outcome = pool.outcome("corrupt", job, place)
            outcome.file = f"{job.key} (mutant {k}: {done})"
            if outcome.is_fault and KEEP is not None:
                KEEP.mkdir(parents=True, exist_ok=True)
                (KEEP / f"{seed}_{k}_{job.path.name}").write_bytes(data)
            return outcome
        finally:
            place.unlink()

    try:
        with ThreadPoolExecutor(workers) as threads:
            return list(threads.map(one, range(count)))
    finally:
        pool.close()


KEEP: Path | None = Path(os.environ["SIMFOUNDRY_KEEP_MUTANTS"]) if "SIMFOUNDRY_KEEP_MUTANTS" in os.environ else None
"""Where mutants go that broke something."""


def print_table(outcomes: list[Outcome], show: int) -> tuple[int, int, int]:
    """Print a row a format, refusals by reason, and what differs; faults, files that load, and those that are equal."""
    print("| format | files | its engine loads | imported | equal | equal but for what is told | faults |")
    print("|---|---|---|---|---|---|---|")
    loaded = [o for o in outcomes if o.loads]
    for name in (*dict.fromkeys(o.format for o in outcomes if o.format), ""):
        every = [o for o in outcomes if name in ("", o.format)]
        mine = [o for o in every if o.loads]
        come = [o for o in mine if not o.refused and not o.broke]
        equal, told = (sum(test(o) for o in mine) for test in (lambda o: o.is_equal, _is_equal_but_for_told))
        faults = sum(o.is_fault for o in every)
        print(
            f"| {name or 'all'} | {len(every)} | {len(mine)} | {len(come)} ({len(come) / max(1, len(mine)):.1%}) "
            f"| {equal} ({equal / max(1, len(mine)):.1%}) | {told} ({told / max(1, len(mine)):.1%}) | {faults} |"
        )
    counts: Counter[str] = sum((o.compared for o in loaded), Counter())
    worst = {q: max(o.worst.get(q, 0.0) for o in loaded) for q in counts}
    print("compared: " + ", ".join(f"{counts[q]} x {q} within {worst[q]:.1e}" for q in counts))
    _print_reasons("refused, though their engine loads them", [o for o in loaded if o.refused], show)
    _print_reasons("refused, as their engine does", [o for o in outcomes if o.refused and not o.loads], show)
    for o in outcomes:
        for word, texts in (("DIFFERS", o.differing), ("told", o.told)):
            for text in texts[:3] if show else ():
                print(f"  {word} {o.file}: {text[:300]}")
        if o.is_fault:
            print(f"  FAULT {o.file}: {(o.broke or o.refused)[:700]}")
    slow = sorted(outcomes, key=lambda o: -o.seconds)[:3]
    print("slowest: " + ", ".join(f"{o.seconds:.1f} s {o.file}" for o in slow))
    return sum(o.is_fault for o in outcomes), len(loaded), sum(o.is_equal for o in loaded)


def _is_equal_but_for_told(outcome: Outcome) -> bool:
    return not (outcome.refused or outcome.broke or outcome.differing)


def _print_reasons(heading: str, outcomes: list[Outcome], show: int) -> None:
    reasons: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        reasons.setdefault(outcome.reason, []).append(outcome)
    print(f"{heading}: {len(outcomes)}")
    for reason, those in sorted(reasons.items(), key=lambda entry: -len(entry[1])):
        print(f"  {len(those):>4} {reason}")
        for outcome in those[:show]:
            print(f"         {outcome.file}: {outcome.refused[:300]}")


def chosen_jobs(folders: Iterable[Path], half: str, count: int, only: str) -> list[Job]:
    """The files to run."""
    found = list(folders)
    jobs = [job for folder in found for job in jobs_below(folder)] if found else list(usual_jobs())
    if found and importlib.util.find_spec("pybullet_data"):
        jobs += list(usual_jobs())
    jobs = sampled(jobs, count)
    halves = {"tuned": (False,), "held": (True,), "both": (False, True)}[half]
    return [job for job in jobs if job.is_held_out in halves and only in job.key]


def main() -> int:
    """Print what came of the files and of their corruptions."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    named = [Path(p) for p in os.environ.get("SIMFOUNDRY_CORPUS", "").split(os.pathsep) if p]
    parser.add_argument("folders", nargs="*", type=Path, default=named, help="Folders of unpacked packages.")
    parser.add_argument("--count", type=int, default=500, help="How many files.")
    parser.add_argument("--half", choices=("tuned", "held", "both"), default="both")
    parser.add_argument("--mutations", type=int, default=0, help="How many corrupted files.")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="Only files whose path in the corpus holds this text.")
    parser.add_argument("--show", type=int, default=1, help="How many files to name a reason.")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    if not options.folders:
        print(OBTAIN)
    jobs = chosen_jobs(options.folders, options.half, options.count, options.only)
    bad, started = 0, time.perf_counter()
    for half in ("tuned", "held"):
        mine = [job for job in jobs if job.is_held_out is (half == "held")]
        if not mine or options.mutations < 0:
            continue
        print(f"\n{len(mine)} files, half `{half}`", flush=True)
        faults, loads, equal = print_table(measured(mine, options.workers), options.show)
        bad += faults + (equal < BAR * loads)
    if options.mutations:
        own = [job for job in jobs if any(job.path.is_relative_to(folder) for folder in options.folders)]
        if not own:
            parser.error("corrupted files lie beside the originals for a moment: name a folder that may be written to")
        done = corrupted(own, abs(options.mutations), options.seed, options.workers)
        broken = [o for o in done if o.is_fault]
        print(f"\n{len(done)} corrupted files: {sum(not o.refused for o in done)} imported, {len(broken)} faults")
        _print_reasons("refused", [o for o in done if o.refused and not o.is_fault], 0)
        for o in broken:
            print(f"  FAULT {o.file}: {(o.broke or o.refused)[:700]}")
        bad += len(broken)
    print(f"{time.perf_counter() - started:.0f} s")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
