"""Success rates of policies on tasks, read from a table or from the results of `simfoundry eval`.

A table is CSV with a header: ``task``, ``policy`` and either ``rate`` (0 to 1, or with ``%``) or ``successes`` and
``rollouts``; ``rollouts`` may also be given with a rate. Lines starting with ``#`` are comments.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simfoundry.errors import SimfoundryError

MOST_BYTES = 32 * 2**20
"""Maximum size of a table [bytes]."""


class ScoresError(SimfoundryError):
    """A table of scores that cannot be read; the message names the file, the line and the expected content."""


@dataclass(frozen=True)
class Score:
    """The success of a policy on a task: ``rate`` in [0, 1] over ``rollouts``, None if their number is unknown.

    ``invalid`` of them failed by an invalid answer; ``missing`` further ones have no result.
    """

    task: str
    policy: str
    rate: float
    rollouts: int | None
    engine: str = ""
    invalid: int = 0
    missing: int = 0


def read_scores(path: Path) -> list[Score]:
    """Read the scores of a CSV table, of a ``results.json``, or of a folder with one, in their order.

    Rows of ``results.json`` without any result are skipped.
    """
    file = path / "results.json" if path.is_dir() else path
    if file.stat().st_size > MOST_BYTES:
        raise ScoresError(f"{file} is larger than {MOST_BYTES >> 20} MiB, the limit for a table of success rates")
    try:
        text = file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ScoresError(f"{file} is not UTF-8 text: {error.reason} at byte {error.start}") from None
    rows = _json_rows(file, text) if file.suffix == ".json" else _csv_rows(file, text)
    scores: dict[tuple[str, str, str], Score] = {}
    for place, row in rows:
        if row.get("rollouts") == 0 and row.get("missing"):
            continue
        score = _score(place, row)
        if (score.task, score.policy, score.engine) in scores:
            raise ScoresError(f"{place}: {score.policy} on {score.task} is a duplicate; give each pair once")
        scores[score.task, score.policy, score.engine] = score
    if not scores:
        raise ScoresError(f"{file} holds no scores; give a line with task, policy and rate for each")
    return list(scores.values())


def _csv_rows(file: Path, text: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    lines = [(k, line) for k, line in enumerate(text.splitlines(), start=1) if line.strip() and line.lstrip()[0] != "#"]
    reader = csv.DictReader((line for _, line in lines), skipinitialspace=True)
    header = {name.strip() for name in reader.fieldnames or ()}
    if not {"task", "policy"} <= header or not ("rate" in header or {"successes", "rollouts"} <= header):
        found = ", ".join(sorted(header)) or "nothing"
        raise ScoresError(
            f"{file}:1: the header must name task, policy and rate, or task, policy, successes and rollouts; "
            f"it names {found}"
        )
    for (number, _), row in zip(lines[1:], reader, strict=False):
        yield f"{file}:{number}", {key.strip(): value for key, value in row.items() if isinstance(key, str)}


def _json_rows(file: Path, text: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    try:
        data = json.loads(text)
    except (json.JSONDecodeError, RecursionError) as error:
        raise ScoresError(f"{file} is not JSON: {error}") from None
    rows = data.get("scores") if isinstance(data, dict) else None
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise ScoresError(f"{file} has no list `scores`; `simfoundry eval` writes one into results.json")
    for k, row in enumerate(rows):
        onward = {"task": f"{row.get('task')}+{row['from']}"} if row.get("from") else {}
        yield f"{file}: scores[{k}]", {**row, **onward}


def _score(place: str, row: Mapping[str, Any]) -> Score:
    task, policy = (str(row.get(key) or "").strip() for key in ("task", "policy"))
    if not task or not policy:
        raise ScoresError(f"{place}: task and policy must be named")
    rollouts = _number(place, row, "rollouts")
    successes = _number(place, row, "successes")
    rate = _number(place, row, "rate")
    if rollouts is not None and (rollouts < 1 or rollouts != int(rollouts)):
        raise ScoresError(f"{place}: rollouts must be a whole number above 0, not {rollouts:g}")
    if rate is None:
        if successes is None or rollouts is None:
            raise ScoresError(f"{place}: give a rate, or successes and rollouts")
        rate = successes / rollouts
    if not 0 <= rate <= 1:
        raise ScoresError(
            f"{place}: {rate:g} is not a success rate; give a number between 0 and 1, or a percentage such as 34%"
        )
    counts = {key: int(_number(place, row, key) or 0) for key in ("invalid", "missing")}
    return Score(
        task, policy, rate, None if rollouts is None else int(rollouts), str(row.get("engine") or ""), **counts
    )


def by_engine(scores: list[Score]) -> dict[str, list[Score]]:
    """Group the scores by engine, in their order; a table without engines has one group, named by the empty string."""
    found: dict[str, list[Score]] = {}
    for score in scores:
        found.setdefault(score.engine, []).append(score)
    return found


def _number(place: str, row: Mapping[str, Any], key: str) -> float | None:
    value = row.get(key)
    if value is None or str(value).strip() in ("", "-", "--"):
        return None
    word = str(value).strip()
    try:
        number = float(word.removesuffix("%")) / (100 if word.endswith("%") else 1)
    except ValueError:
        raise ScoresError(f"{place}: {key} is `{word[:40]}`, which is not a number") from None
    if not math.isfinite(number):
        raise ScoresError(f"{place}: {key} is `{word[:40]}`, which is not finite")
    return number
