"""Cousins of a recipe, made as a stage of a larger run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from simfoundry.errors import SimfoundryError
from simfoundry.runtime.executors import Machines


def make_cousins(
    recipe: Path,
    out: Path,
    count: int | None,
    jobs: int | None,
    machines: Machines,
    progress: Callable[[str, float], None],
    seed: int | None = None,
    commercial_only: bool = False,
) -> list[Path]:
    """Make the cousins of a recipe, or those that are missing, and return their task documents.

    Args:
        recipe: The recipe.
        out: The output folder, which must be inside the twin's project.
        count: The number of cousins; None for the number in the recipe.
        jobs: The number of parallel processes; None for one per core.
        machines: The machines to use.
        progress: Callback that receives a text and the fraction of cousins that are complete.
        seed: The seed; None for that of the recipe.
        commercial_only: Whether to refuse models that may not be used commercially.

    Raises:
        SimfoundryError: If there are fewer cousins than requested.
    """
    from simfoundry.cousins.recipe.document import claim_project, read_recipe
    from simfoundry.cousins.recipe.variant_pool import ASSETS, counts
    from simfoundry.cousins.run.candidates import FUNCTION, CandidateSampler
    from simfoundry.cousins.run.report import examples, told, write_manifest
    from simfoundry.cousins.run.run import Ledger, RunPlan, begin, finish, run
    from simfoundry.cousins.run.worker_pools import Work, open_pool
    from simfoundry.spec.files import files_below

    read, folder = read_recipe(recipe, seed), out.absolute()
    if claim_project(read, folder) is not None:
        read = read_recipe(recipe, seed)  # the marker may have added documents to the project
    setup = recipe.absolute(), folder, read.seed, "", "", commercial_only
    plan = RunPlan(folder, count or read.spec.count, read.about(), None)
    progress("cousins: the twin", 0.0)
    begin(plan)
    sampler = CandidateSampler.load(*setup)
    sampler.require_possible()
    made = counts(read.spec.object, folder / ASSETS / "objects")
    plan = replace(plan, most=sampler.pool.most, variants=made, varied=read.varied_summary)

    def report(ledger: Ledger) -> None:
        progress(f"cousins: {told(ledger)}", len(ledger.accepted) / ledger.wanted)

    ledger = run(plan, lambda: open_pool(Work(FUNCTION, setup), machines, jobs), report)
    write_manifest(plan, ledger)
    finish(plan, ledger)
    if len(ledger.accepted) < ledger.wanted:
        reasons = "; ".join(examples(ledger).values())
        raise SimfoundryError(
            f"only {len(ledger.accepted)} of {ledger.wanted} cousins could be made"
            f"{f' ({reasons})' if reasons else ''}; make fewer, or relax {recipe}"
        )
    return list(files_below([folder], ".task.yaml", "tasks"))
