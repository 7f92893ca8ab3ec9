"""The review of a run by people, who accept or reject each cousin with a reason.

The review is the file ``review.json`` beside the manifest, which a run never writes. `simfoundry eval` and `simfoundry
record` leave the tasks of rejected cousins out of a folder.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from simfoundry.cousins.run.run import MANIFEST
from simfoundry.errors import OutputError
from simfoundry.evaluate.statistics.sensitivity import MANIFEST_VERSION, MAX_MANIFEST
from simfoundry.runtime.files import locked_folder, write_atomically
from simfoundry.spec.files import files_below

REVIEW, VERSION = "review.json", "cousins-review/1"

# Maximum size of a review [bytes]: 100,000 cousins with reasons of some sentences.
MAX_BYTES = 64 * 2**20

# What reading damaged JSON can raise.
_DAMAGE = (ValueError, KeyError, TypeError, AttributeError, RecursionError)

# The index in the name of a cousin's document, such as 000017.task.yaml.
_INDEXED = re.compile(r"([0-9]{6,})\.")


@dataclass(frozen=True)
class CousinReview:
    """The decision of a person about a cousin, with its reason."""

    accepted: bool
    reason: str = ""


@dataclass(frozen=True)
class CousinEntry:
    """A cousin in a manifest.

    Attributes:
        index: The index of the candidate.
        files: The documents by kind, such as ``scene`` and ``task``.
        asked: The predicates that were requested.
        goal: The goal of its own task, or empty.
        vary: The drawn values by path.
    """

    index: int
    files: Mapping[str, Path]
    asked: tuple[str, ...] = ()
    goal: str = ""
    vary: Mapping[str, Any] | None = None


def read_cousins(folder: Path) -> tuple[CousinEntry, ...]:
    """Return the cousins in the manifest of a run.

    Raises:
        OutputError: If the folder has no manifest, or if it is damaged.
    """
    path = folder / MANIFEST
    if not path.is_file():
        raise OutputError(f"{folder} has no {MANIFEST}; choose the output folder of a finished `simfoundry cousins`")
    if path.stat().st_size > MAX_MANIFEST:
        raise OutputError(f"{path} is larger than {MAX_MANIFEST >> 20} MiB, the limit for a manifest")
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data["simfoundry"] != MANIFEST_VERSION:
            raise ValueError
        return tuple(_entry(folder, each) for each in data["cousins"])
    except _DAMAGE:
        raise OutputError(f"{path} is not a manifest of cousins in the format {MANIFEST_VERSION}") from None


def _entry(folder: Path, data: Mapping[str, Any]) -> CousinEntry:
    files = {str(kind): folder / Path(str(name)).name for kind, name in data["files"].items()}  # nothing outside of it
    asked, goal, vary = tuple(map(str, data.get("asked", ()))), str(data.get("goal", "")), data.get("vary")
    return CousinEntry(int(data["index"]), files, asked, goal, None if vary is None else dict(vary))


def read_reviews(folder: Path) -> dict[int, CousinReview]:
    """Return the reviews of a run's cousins by index, which are none if there is no file.

    Raises:
        OutputError: If the file is not a review.
    """
    path = folder / REVIEW
    if not path.is_file():
        return {}
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ValueError
        data = json.loads(path.read_text(encoding="utf-8"))
        if data["simfoundry"] != VERSION:
            raise ValueError
        return {int(index): _review(each) for index, each in data["cousins"].items()}
    except _DAMAGE:
        raise OutputError(f"{path} is not a review of cousins in the format {VERSION}; correct or move it") from None


def _review(data: Mapping[str, Any]) -> CousinReview:
    verdicts = {"accepted": True, "rejected": False}
    return CousinReview(verdicts[data["verdict"]], str(data.get("reason", "")))


def write_review(folder: Path, index: int, review: CousinReview | None) -> None:
    """Write one review atomically, in place of the earlier one of this cousin, or remove it if ``review`` is None.

    Raises:
        OutputError: If the file is not a review, or if a rejection has no reason.
    """
    if review is not None and not review.accepted and not review.reason.strip():
        raise OutputError("a rejection needs a reason, for those who use the cousins")
    with locked_folder(folder, "is being reviewed by another program at this moment; try again"):
        reviews = read_reviews(folder)
        reviews.pop(index, None)
        if review is not None:
            reviews[index] = review
        cousins = {
            str(key): {"verdict": "accepted" if each.accepted else "rejected", "reason": each.reason.strip()}
            for key, each in sorted(reviews.items())
        }
        data = {"simfoundry": VERSION, "cousins": cousins}
        write_atomically(folder / REVIEW, (json.dumps(data, indent=1, ensure_ascii=False) + "\n").encode())


def without_rejected(files: Iterable[Path]) -> tuple[list[Path], list[Path]]:
    """Divide documents into those to use, and those of cousins that were rejected in a review beside them.

    Raises:
        OutputError: If a review is damaged.
    """
    reviews = lru_cache(maxsize=None)(read_reviews)  # one folder contains thousands of documents
    kept: list[Path] = []
    rejected: list[Path] = []
    for file in files:
        match = _INDEXED.match(file.name)
        review = reviews(file.parent).get(int(match.group(1))) if match else None
        (kept if review is None or review.accepted else rejected).append(file)
    return kept, rejected


def usable_tasks(paths: Iterable[Path]) -> tuple[list[Path], list[Path]]:
    """Return the task documents in some paths, and those of rejected cousins, which are left out of folders.

    A document that is named itself is used in any case.

    Raises:
        SimfoundryError: If a folder contains no tasks, if all of them were rejected, or if a review is damaged.
    """
    tasks, left_out = list[Path](), list[Path]()
    for path in paths:
        found = list(files_below([path], ".task.yaml", "tasks"))
        kept, rejected = without_rejected(found) if path.is_dir() else (found, [])
        if not kept:
            raise OutputError(f"all {len(rejected)} tasks in {path} were rejected in a review; see {REVIEW} there")
        tasks += kept
        left_out += rejected
    return tasks, left_out
