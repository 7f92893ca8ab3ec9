"""One policy from the same starts in two engines: what is counted, and when they are said to disagree."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simfoundry.evaluate.statistics.comparisons import compare_engines
from simfoundry.evaluate.statistics.results import results
from simfoundry.reports.evaluation import page
from tests.cli.command import run
from tests.evaluate.benches import TASK, write_bench
from tests.evaluate.test_pools import record


def both(of: int, mujoco: Iterable[int], pybullet: Iterable[int]) -> list[dict[str, Any]]:
    """Rollouts of a task in both engines; the numbers are of those that succeed."""
    won = {"mujoco": set(mujoco), "pybullet": set(pybullet)}
    return [record("a", "p", k, won=k in won[engine], engine=engine) for engine in won for k in range(of)]


@pytest.mark.parametrize(
    ("of", "mujoco", "pybullet", "disagrees"),
    [(25, 25, 23, False), (25, 25, 22, True), (25, 0, 3, True), (5, 5, 4, False), (5, 5, 0, True), (1, 1, 0, False)],
)
def test_engines_disagree_where_they_differ_by_more_than_two_of_25(
    of: int, mujoco: int, pybullet: int, disagrees: bool
) -> None:
    (one,) = compare_engines(both(of, range(mujoco), range(pybullet)))
    assert (one.first_done, one.second_done, one.pairs, one.disagrees) == (mujoco, pybullet, of, disagrees)


def test_starts_that_end_differently_are_named() -> None:
    rows = both(25, range(25), [*range(10), 20])
    (one,) = compare_engines(rows)
    assert one.differing == (*range(10, 20), 21, 22, 23, 24) and one.p == pytest.approx(2 / 2**14)
    assert one.sentence.startswith("a with p: mujoco and pybullet disagree: 25 and 11 of the same 25 initial")
    (row,) = results(rows)["engines"]
    assert row["disagrees"] and row["first_only"] == one.differing and row["second_only"] == ()


def test_only_starts_with_a_result_in_both_are_compared() -> None:
    rows = both(4, range(4), range(2))
    rows[4]["end"] = "no answer"  # pybullet's first
    rows[7]["start"] = "another"
    (one,) = compare_engines(rows)
    assert (one.pairs, one.first_done, one.second_done) == (2, 2, 1)
    assert compare_engines([r for r in rows if r["engine"] == "mujoco"]) == []


def test_the_page_shows_where_engines_disagree_first() -> None:
    filled = {"engine_version": "3", "robots": {}, "version": "0", "seed": 0, "instruction": "go", "control_hz": 15.0}
    rows = [{**r, "task": "b"} for r in both(5, range(5), range(5))] + both(5, range(5), [])
    text = page([{**filled, "horizon": 9, "regions": {}, "cells": {}, "grid": [5, 5], **r} for r in rows])
    table = text.partition("The same initial states in two engines")[2].partition("</table>")[0]
    assert table.index("<th>a</th>") < table.index("<th>b</th>")
    assert table.count("the engines disagree") == 1 and "0, 1, 2, 3, 4" in table
    assert "The same initial states" not in page(
        [{**filled, "horizon": 9, "regions": {}, "cells": {}, "grid": [1, 1], **rows[0]}]
    )


def test_eval_runs_two_engines_from_the_same_starts(tmp_path: Path) -> None:
    pytest.importorskip("pybullet", reason="PyBullet has wheels only for Python 3.11 on Linux")
    write_bench(tmp_path, TASK.replace("goal: At(block, 0.45, 0)", "goal: Touching(arm, block)", 1))
    np.save(tmp_path / "still.npy", np.zeros((1, 3)))
    command: list[str | Path] = [
        "eval",
        tmp_path / "push.task.yaml",
        "-p",
        f"still=replay:{tmp_path / 'still.npy'}",
        "-n",
        "2",
    ]
    done = run(*command, "--world", "mujoco", "--world", "pybullet", "--no-video", "-o", tmp_path / "out")
    assert done.code == 0, done.err
    assert "push in mujoco" in done.out and "push in pybullet" in done.out
    found = sorted(p.relative_to(tmp_path / "out" / "rollouts").as_posix() for p in tmp_path.rglob("00?.json"))
    assert found == [f"push/still/{engine}/00{k}.json" for engine in ("mujoco", "pybullet") for k in range(2)]
    assert "disagree:" not in done.out
