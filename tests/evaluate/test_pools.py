"""Rates over many tasks, and policies compared from the same starts."""

from __future__ import annotations

import json
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from simfoundry.evaluate.statistics.comparisons import compare_policies
from simfoundry.evaluate.statistics.metrics import (
    DRAWN_FLIPS,
    EXACT_FLIPS,
    holm,
    mcnemar,
    sign_flip,
    stratified,
    wilson,
)
from simfoundry.evaluate.statistics.results import pools, results
from tests.cli.command import run
from tests.evaluate.benches import TASK, write_bench


def record(task: str, policy: str, index: int = 0, won: bool = True, **more: Any) -> dict[str, Any]:
    """A rollout of a task with two sub-tasks, of which a lost one has done the first."""
    head = {"task": task, "part": "whole", "step": "", "engine": "mujoco", "policy": policy, "index": index}
    done = {"pick": 5, "place": 9 if won else None}
    rest = {"success": won, "end": "success" if won else "horizon", "start": f"{task}{index}", "subtasks": done}
    return {**head, **rest, "steps": 9, "reason": "", "asked_rollouts": 1, **more}


def cousin(recipe: str, *axes: str) -> dict[str, Any]:
    return {"cousin": {"recipe": recipe, "seed": 0, "index": 1, "axes": list(axes)}}


def test_a_folder_of_cousins_has_a_rate_of_all_and_of_each_stratum() -> None:
    near = [record(f"near{k}", "p", won=k < 6, **cousin("near", "scene")) for k in range(8)]
    full = [record(f"full{k}", "p", won=k < 1, **cousin("full", "distractors", "scene")) for k in range(2)]
    found = {pool.stratum: pool for pool in pools(near + full)}
    assert list(found) == ["all", "near: scene", "full: distractors + scene"]
    assert str(found["all"].rate) == "7/10  70% (40% to 89%)" and len(found["all"].counts) == 10
    assert (found["near: scene"].rate.done, found["full: distractors + scene"].rate.of) == (6, 2)
    json = results(near + full)["pooled"][0]
    assert json["interval"] == pytest.approx(wilson(7, 10), abs=1e-6) == json["stratified_interval"]


def test_a_task_alone_is_not_pooled_and_engines_and_parts_are_kept_apart() -> None:
    assert pools([record("a", "p", k) for k in range(5)]) == []
    both = [record(t, "p", engine=e, won=e == "mujoco") for t, e in product("ab", ("mujoco", "pybullet"))]
    steps = [record(t, "p", part="alone", step="pick") for t in "ab"]
    rates = {(p.part, p.engine): (p.rate.done, p.rate.of) for p in pools(both + steps)}
    assert rates == {("whole", "mujoco"): (2, 2), ("whole", "pybullet"): (0, 2), ("alone", "mujoco"): (2, 2)}


def test_what_is_invalid_counts_in_the_pool_and_what_is_missing_does_not() -> None:
    rows = [record("a", "p"), record("b", "p", won=False, end="invalid answer"), record("c", "p", end="no answer")]
    (pool,) = pools(rows)
    assert (pool.rate.done, pool.rate.of, pool.invalid) == (1, 2, 1)


def test_every_task_weighs_the_same_in_the_stratified_rate() -> None:
    rate, low, high = stratified([(20, 20), (0, 5)])
    assert rate == 0.5
    assert (low, high) == pytest.approx(wilson(8, 16), abs=1e-12)  # 4 / (1/20 + 1/5) rollouts
    assert stratified([(3, 7)])[1:] == wilson(3, 7)
    with pytest.raises(ValueError, match="each stratum needs at least one rollout"):
        stratified([(0, 0)])


@pytest.mark.parametrize(("tasks", "of"), [(13, 1), (13, 5), (4, 25)])
def test_the_stratified_interval_holds_the_rate_of_tasks_that_differ(tasks: int, of: int) -> None:
    rng = np.random.default_rng(tasks + of)
    truth = rng.uniform(0.5, 1.0, tasks)
    held = 0
    for _ in range(1000):
        _, low, high = stratified([(int(k), of) for k in rng.binomial(of, truth)])
        held += low <= truth.mean() <= high
    assert held >= 930


def test_paired_successes_are_scipys_binomial_test() -> None:
    for a, b in product(range(7), repeat=2):
        expected = stats.binomtest(min(a, b), a + b).pvalue if a + b else 1.0
        assert mcnemar(a, b) == pytest.approx(expected, abs=1e-12)
        assert sign_flip([1.0] * a + [-1.0] * b) == pytest.approx(expected, abs=1e-12)  # of yes and no it is the same


def test_permutations_are_scipys_exact_and_drawn() -> None:
    rng = np.random.default_rng(1)
    few = rng.normal(0.3, 1.0, 9)
    expected = stats.permutation_test((few,), np.mean, permutation_type="samples", n_resamples=np.inf).pvalue
    assert sign_flip(list(few)) == pytest.approx(expected, abs=1e-12)
    many = list(rng.normal(0.35, 1.0, EXACT_FLIPS + 14))
    assert sign_flip(many) == sign_flip(many)
    expected = stats.ttest_1samp(many, 0.0).pvalue
    assert sign_flip(many) == pytest.approx(expected, abs=4 * np.sqrt(expected / DRAWN_FLIPS) + 0.01)
    assert sign_flip([0.0, 0.0]) == 1.0


def test_policies_are_paired_by_start_and_corrected_for_their_number() -> None:
    rows = [record("a", "good", k) for k in range(6)] + [record("a", "bad", k, won=False) for k in range(6)]
    rows += [record("a", "late", 9)]  # from no start of the others
    (one,) = compare_policies(rows)
    assert (one.first, one.second, one.pairs, one.both, one.first_only, one.second_only) == ("good", "bad", 6, 0, 6, 0)
    assert one.p == pytest.approx(2 / 2**6) and one.progress == pytest.approx(0.5)
    assert (
        "good alone succeeds in 6, bad alone succeeds in 0; p = 0.0312 (exact McNemar test, Holm-corrected)"
        in one.sentence
    )
    rows += [record("a", "third", k, won=k < 3) for k in range(6)]
    assert [c.p_holm for c in compare_policies(rows)] == pytest.approx([3 * 2 / 2**6, 0.5, 0.5])
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    other = compare_policies(
        [*rows, record("a", "good", 0, engine="pybullet"), record("a", "bad", 0, engine="pybullet")]
    )
    assert [c.engine for c in other].count("pybullet") == 1
    missing = [{**r, "end": "no answer"} if r["policy"] == "bad" and r["index"] else r for r in rows]
    assert next(c for c in compare_policies(missing) if c.second == "bad").pairs == 1


COUSIN = "\norigin:\n  cousin: {recipe: benches, seed: 0, index: %d}\n"
MOVED = "  block:\n    place: null\n    pose: {xyz: [0.31, 0, 0.025]}\n"
MORE = "  ball: {shape: {sphere: 0.02}, material: wood, pose: {xyz: [0.6, -0.3, 0.02]}}\n"


def test_a_folder_of_cousins_is_one_evaluation_stratified_by_axes(tmp_path: Path) -> None:
    write_bench(tmp_path, TASK.replace("goal: At(block, 0.45, 0)", "goal: Touching(arm, block)", 1))
    folder = tmp_path / "cousins"
    folder.mkdir()
    (tmp_path / "simfoundry.yaml").touch()
    for k, objects in enumerate([MOVED, MOVED + MORE], 1):
        scene = f"simfoundry: scene/1\nextends: ../bench.scene.yaml\nname: benches_{k}\nobjects:\n{objects}"
        (folder / f"{k}.scene.yaml").write_text(scene + COUSIN % k)
        task = (
            f"simfoundry: task/1\nextends: ../push.task.yaml\nname: benches_{k}\nscene: {k}.scene.yaml\nreset: null\n"
        )
        (folder / f"{k}.task.yaml").write_text(task + COUSIN % k)
    own = task.replace("extends: ../push.task.yaml\n", "instruction: Touch it.\ngoal: Touching(arm, block)\n")
    (folder / "3.task.yaml").write_text(own.replace("2", "3", 1).replace("reset: null\n", "") + COUSIN % 3)
    np.save(tmp_path / "push.npy", np.column_stack([np.zeros(45), np.linspace(0.05, 0.22, 45), np.zeros(45)]))
    command = ["eval", str(folder), "-p", f"push=replay:{tmp_path / 'push.npy'}", "-n", "1", "--no-video"]
    result = run(*command, "-o", str(tmp_path / "out"))
    assert result.code == 0, result.err
    rates = {row["stratum"]: (row["successes"], row["rollouts"]) for row in _pooled(tmp_path / "out")}
    assert rates == {
        "all": (3, 3),
        "benches: scene": (1, 1),
        "benches: distractors + scene": (1, 1),
        "benches: distractors + scene + task": (1, 1),
    }
    assert "all (3)" in result.out and "3/3  100% (44% to 100%)" in result.out


def _pooled(out: Path) -> list[dict[str, Any]]:
    return list(json.loads((out / "results.json").read_text())["pooled"])
