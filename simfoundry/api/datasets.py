"""Building, reading and checking of datasets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simfoundry.api.ranges import check_ranges
from simfoundry.runtime.executors import Machines, worker_count

if TYPE_CHECKING:
    from simfoundry.data.dataset.formats import StoredDataset
    from simfoundry.data.dataset.plan import DatasetPlan

# Callback that receives a text with the current counts, and the fraction of the episodes that are complete.
BuildProgress = Callable[[str, float], None]


def build_dataset(
    source: str | Path,
    out: str | Path | None = None,
    *,
    formats: Sequence[str] = (),
    profile: str | None = None,
    jobs: int | None = None,
    on: str = "local",
) -> list[StoredDataset]:
    """Build a dataset from a document, or directly from a folder of demonstrations.

    Example: ``build_dataset("demos", "build/cup", formats=["lerobot-v3"])``.

    To resume an interrupted build, make the same call again. A dataset that is already complete is not built again.

    Args:
        source: A dataset document, or a folder of demonstrations.
        out: Output folder; by default, ``build/datasets/NAME``. With several formats, it has a folder for each of them.
        formats: File formats; by default, those of the document or its profile.
        profile: Name of the profile; by default, that of the document, or ``lerobot`` for a folder.
        jobs: Number of parallel processes; by default, one on this machine, and one per CPU of a Ray cluster.
        on: Where to run: ``local``, ``ray`` or ``ray:ADDRESS``.

    Returns:
        The datasets, one for each format.

    Raises:
        SpecError: If the document has errors.
        SimfoundryError: If a source, a format or an option cannot be used.
    """
    from simfoundry.data.dataset.reading import open_dataset

    check_ranges([("jobs", jobs)])
    plan = dataset_plan(Path(source), formats, profile)
    folders = run_build(plan, default_folder(plan) if out is None else Path(out), jobs, Machines.parse(on))
    return [open_dataset(folder)[1] for folder in folders]


def dataset_plan(source: Path, formats: Sequence[str] = (), profile: str | None = None) -> DatasetPlan:
    """Return the plan of a dataset, from a document or from a folder of demonstrations.

    Raises:
        SpecError: If the document has errors.
        SimfoundryError: If a source or a format cannot be used.
    """
    from simfoundry.data.dataset.plan import plan_dataset
    from simfoundry.spec.load import load_kind
    from simfoundry.spec.models.dataset import DatasetSource, DatasetSpec

    if source.is_dir():
        spec = DatasetSpec(
            simfoundry="dataset/1",
            name=_name_of(source),
            profile=profile or "lerobot",
            sources={"demonstrations": DatasetSource(demonstrations=str(source.resolve()))},
        )
        return plan_dataset(spec, Path.cwd(), formats)
    found = load_kind(source, "dataset/1").spec
    assert isinstance(found, DatasetSpec)
    chosen = found if profile is None else found.model_copy(update={"profile": profile})
    return plan_dataset(chosen, source.parent, formats)


def _name_of(folder: Path) -> str:
    """Return a valid name of a dataset that is built from a folder."""
    name = "".join(c if c.isalnum() and c.isascii() else "_" for c in folder.resolve().name.lower())
    return name[:64] if name[:1].isalpha() else f"dataset_{name}"[:64]


def default_folder(plan: DatasetPlan) -> Path:
    """Return the default output folder of a dataset."""
    return Path("build") / "datasets" / plan.info.name


def run_build(
    plan: DatasetPlan,
    out: Path,
    jobs: int | None,
    machines: Machines,
    progress: BuildProgress = lambda text, share: None,
) -> list[Path]:
    """Execute a plan, and return the folders of the datasets."""
    from simfoundry.data.dataset.build import build_dataset as run

    count = plan.info.episodes
    workers = worker_count(machines, jobs)
    return run(plan, out, lambda done: progress(f"{done} of {count} episodes", done / count), workers, machines)


def dataset(folder: str | Path) -> StoredDataset:
    """Open a dataset in any known format, also one that another program wrote.

    Example: ``for k in range(len(dataset("build/cup"))): print(dataset("build/cup").header(k).instruction)``.

    Raises:
        SimfoundryError: If the folder does not contain a dataset.
    """
    from simfoundry.data.dataset.reading import open_dataset

    return open_dataset(Path(folder))[1]


def check_dataset(folder: str | Path) -> list[str]:
    """Check the files of a dataset, and return a sentence for each problem.

    Raises:
        SimfoundryError: If the folder does not contain a dataset.
    """
    from simfoundry.data.dataset.checking import check_stored

    return [problem.text for problem in check_stored(Path(folder))]


def dataset_summary(folder: str | Path) -> dict[str, Any]:
    """Return the counts, features, splits and statistics of a dataset as plain data.

    Raises:
        SimfoundryError: If the folder does not contain a dataset.
    """
    from simfoundry.data.dataset.summary import summary

    return summary(Path(folder))
