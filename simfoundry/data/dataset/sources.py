"""The sources of a dataset: folders of demonstrations, and existing datasets."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from simfoundry.data.demonstrations import DemonstrationSet, read_demonstrations
from simfoundry.data.index import INDEX
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.statistics.sensitivity import read_cousins
from simfoundry.spec.diagnostics import nearest
from simfoundry.spec.models.dataset import DatasetSource, DatasetSpec, DemonstrationFilter


@dataclass(frozen=True, eq=False)
class SelectedDemonstrations:
    """The demonstrations that a dataset uses from one folder.

    Attributes:
        name: The name of the source in the document.
        source: The source in the document.
        demonstrations: All demonstrations in the folder.
        positions: The positions of the selected ones.
    """

    name: str
    source: DatasetSource
    demonstrations: DemonstrationSet
    positions: tuple[int, ...]

    def facts(self, position: int) -> Mapping[str, Any]:
        """Return what the shard and the index state about a demonstration."""
        return {**self.demonstrations.facts(position), **self.demonstrations.heads[position]}


@dataclass(frozen=True)
class SelectedDataset:
    """An existing dataset that another one uses.

    Attributes:
        name: The name of the source in the document.
        source: The source in the document.
        folder: The folder of the dataset.
        keys: Its keys, by the keys that they have in the new dataset.
    """

    name: str
    source: DatasetSource
    folder: Path
    keys: Mapping[str, str] = field(default_factory=dict)


def select_demonstrations(spec: DatasetSpec, folder: Path) -> Iterator[SelectedDemonstrations]:
    """Yield the demonstrations of each folder of each source, in order.

    Args:
        spec: The document.
        folder: The folder that paths in the document are relative to.

    Raises:
        SimfoundryError: If a source contains no demonstrations, or none that passes the filter.
    """
    for name, source in spec.sources.items():
        if source.demonstrations is None:
            continue
        left = source.count
        found = 0
        for one in _folders(Path(os.path.normpath(folder / source.demonstrations))):
            demonstrations = read_demonstrations(one)
            positions = [k for k in range(len(demonstrations)) if _passes(spec.filter, demonstrations, k)]
            positions = positions if left is None else positions[:left]
            left = None if left is None else left - len(positions)
            found += len(positions)
            if positions:
                yield SelectedDemonstrations(name, source, demonstrations, tuple(positions))
        if not found:
            raise SimfoundryError(f"no demonstration of source `{name}` passes the filter; relax it, or record more")


def existing_datasets(spec: DatasetSpec, folder: Path) -> Iterator[SelectedDataset]:
    """Yield the existing datasets among the sources, in order."""
    for name, source in spec.sources.items():
        if source.dataset is not None:
            yield SelectedDataset(name, source, (folder / source.dataset).resolve(), dict(source.keys))


def _folders(place: Path) -> list[Path]:
    """Return the folders of demonstrations at a place: itself, or the folders in it."""
    if (place / INDEX).is_file():
        return [place]
    if not place.is_dir():
        raise SimfoundryError(f"there are no demonstrations in {place}; record some with `simfoundry record`")
    inner = sorted(path.parent for path in place.glob(f"*/{INDEX}"))
    if not inner:
        raise SimfoundryError(f"{place} contains neither demonstrations nor folders of demonstrations")
    return inner


def _passes(wanted: DemonstrationFilter, demonstrations: DemonstrationSet, k: int) -> bool:
    """Return True if a demonstration passes the filter.

    Raises:
        SimfoundryError: If the task has no such sub-task.
    """
    head, about = demonstrations.heads[k], demonstrations.facts(k)
    for name in wanted.subtasks:
        if name not in head["subtasks"]:
            hint = nearest(name, head["subtasks"]) or "it has no sub-tasks"
            raise SimfoundryError(f"task `{about['task']}` has no sub-task `{name}`; {hint}")
    if any(head["subtasks"][name] is None for name in wanted.subtasks):
        return False
    duration = int(head["steps"]) / float(about["control_hz"])
    low, high = wanted.duration or (0.0, float("inf"))
    if not low <= duration <= high:
        return False
    return wanted.split is None or wanted.split == split_of((demonstrations.folder / str(about["document"])).resolve())


@lru_cache(maxsize=100_000)  # one entry for each task; a batch of cousins has up to 10,000
def split_of(document: Path) -> str | None:
    """Return the split of the recipe from which a task was drawn, or None if there is none."""
    return _splits(document.parent).get(document.name)


@lru_cache(maxsize=16)
def _splits(folder: Path) -> dict[str, str]:
    """Return the split of each document in a folder of cousins, by file name."""
    try:
        _, manifest = read_cousins(folder)
        cousins = [(one["files"].values(), str(one.get("split", ""))) for one in manifest["cousins"]]
    except (SimfoundryError, KeyError, TypeError, AttributeError):  # there are no cousins in the folder
        return {}
    return {str(name): split for names, split in cousins for name in names if split}
