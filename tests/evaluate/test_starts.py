"""Starts: one cell of the grid each time, free, at rest, the same for everyone; or a sentence that says why not."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import simfoundry.evaluate.resets.starts as module
from simfoundry.assets.cache import Cache
from simfoundry.evaluate.resets.placement import bounds, deal
from simfoundry.evaluate.resets.starts import RolloutStart, StartError, starts
from simfoundry.evaluate.task import Task, load_task
from simfoundry.predicates import Judge
from simfoundry.spec.models.task import Reset, ResetRegion
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.rest import simulate
from tests.conftest import REPOSITORY
from tests.evaluate.benches import TASK, write_bench


def digests(found: tuple[RolloutStart, ...]) -> list[str]:
    return [start.digest for start in found]


def test_25_starts_have_25_cells_of_each_object(push: Task, push_starts: tuple[RolloutStart, ...]) -> None:
    every = {(i, j) for i in range(5) for j in range(5)}
    for name, region in push.reset.objects.items():
        assert {start.cells[name] for start in push_starts} == every
        for start in push_starts:
            spans = bounds(region, push.reset.grid, start.cells[name])
            for (low, high), value in zip(spans, start.state.poses[name].p, strict=False):
                assert low - 1e-4 <= value <= high + 1e-4
    pairs = [tuple(start.cells.values()) for start in push_starts]
    assert any(a != b for a, b in pairs)  # the objects are dealt their cells independently


def test_every_start_stands_still_and_nothing_is_done_yet(
    push: Task, push_starts: tuple[RolloutStart, ...], push_world: MujocoWorld
) -> None:
    judge = Judge(push.scene)
    for start in push_starts[::4]:
        assert all(motion.moved < 0.002 for motion in simulate(push_world, 1.0, start.state))
        push_world.reset(start.state)
        assert max(contact.depth for contact in push_world.contacts()) < 1e-3
        assert not judge(push.goal, start.state).value


def test_turns_fill_their_range(push_starts: tuple[RolloutStart, ...]) -> None:
    yaws = []
    for start in push_starts:
        w, _, _, z = start.state.poses["block"].q
        yaws.append(np.degrees(2 * np.arctan2(z, w)))
    assert -10.1 < min(yaws) < -4 and 4 < max(yaws) < 10.1


def test_what_stands_on_a_thing_moves_along(push: Task, push_starts: tuple[RolloutStart, ...]) -> None:
    X_DC = push.scene.object("dish").X_WO.inverse() @ push.scene.object("crumb").X_WO
    for start in push_starts:
        now = start.state.poses["dish"].inverse() @ start.state.poses["crumb"]
        np.testing.assert_allclose(now.p, X_DC.p, atol=5e-4)
        assert now.angle_to(X_DC) < 0.01


def test_the_same_task_and_seed_give_the_same_starts(push: Task, push_starts: tuple[RolloutStart, ...]) -> None:
    assert digests(starts(push, 4)) == digests(push_starts[:4])
    assert set(digests(starts(push, 2, seed=1))).isdisjoint(digests(push_starts))
    assert len(set(digests(push_starts))) == 25


def test_another_process_with_another_hash_seed_gives_the_same_starts(
    push_file: Path, push_starts: tuple[RolloutStart, ...]
) -> None:
    code = (
        "import sys; from pathlib import Path; from simfoundry.evaluate.task import load_task;"
        "from simfoundry.evaluate.resets.starts import starts;"
        "print(*[s.digest for s in starts(load_task(Path(sys.argv[1])), 2)])"
    )
    environment = {**os.environ, "PYTHONHASHSEED": "4242", "PYTHONPATH": str(REPOSITORY)}
    done = subprocess.run(
        [sys.executable, "-c", code, str(push_file)], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == digests(push_starts[:2])


def test_after_a_grid_the_cells_are_dealt_anew(push: Task) -> None:
    small = replace(push, reset=push.reset.model_copy(update={"grid": (2, 1)}))
    found = starts(small, 5)
    for first in (0, 2):
        assert {start.cells["block"] for start in found[first : first + 2]} == {(0, 0), (1, 0)}
    assert [start.index for start in found] == [0, 1, 2, 3, 4] and len(set(digests(found))) == 5


def test_a_rerun_takes_them_from_the_cache(push: Task, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = Cache(tmp_path)
    first = starts(push, 3, cache=cache)
    more = starts(push, 5, cache=cache)  # goes on where it stopped

    def no_world(*_: object) -> None:
        raise AssertionError("a world was opened")

    monkeypatch.setattr(module, "open_world", no_world)
    again = starts(push, 5, cache=cache)
    assert digests(again) == digests(more) and digests(first) == digests(more[:3])
    for a, b in zip(more, again, strict=True):
        assert a.cells == b.cells
        for name, pose in a.state.poses.items():
            np.testing.assert_array_equal(pose.q, b.state.poses[name].q)
    with pytest.raises(AssertionError):  # another goal may be true where this one was not
        starts(replace(push, goal="At(block, 0.5, 0)"), 1, cache=cache)


def crowded(folder: Path, regions: str) -> Task:
    head = TASK[: TASK.index("    block: {x")]
    return load_task(write_bench(folder, head + regions))


def test_objects_whose_regions_overlap_exchange_cells(tmp_path: Path) -> None:
    same = "{x: [0.3, 0.55], y: [-0.1, 0.15], yaw_deg: [0, 90]}"
    task = crowded(tmp_path, f"    block: {same}\n    dish: {same}\n")
    dealt = deal(task.reset, 0, 0)
    found = starts(task, 25)
    assert any(s.cells["block"] != c or s.cells["dish"] != d for s, c, d in zip(found, *dealt.values(), strict=True))
    for name in ("block", "dish"):
        assert len({start.cells[name] for start in found}) == 25
    with MujocoWorld(task.scene) as world:
        for start in found:
            world.reset(start.state)
            assert not [c for c in world.contacts() if {c.a, c.b} == {"block", "dish"} and c.depth > 0]


def test_where_there_is_no_place_the_error_says_which_and_why(tmp_path: Path) -> None:
    task = crowded(tmp_path, "    block: {x: [0.3, 0.301], y: [0.3, 0.301]}\n")
    wanted = (
        r"task `push`: initial state 0: could not place `block` in cell \(\d, \d\) \(x 0\.\d{3} to 0\.\d{3} m, y .*\) "
        r"in 6 attempts: 6 times `block` overlaps `(dish|crumb)` by \d+\.\d mm; move its region under `reset`"
    )
    with pytest.raises(StartError, match=wanted):
        starts(task, 1)


def test_two_objects_that_are_always_too_close_have_no_start(tmp_path: Path) -> None:
    same = "{x: [0.4, 0.42], y: [0, 0.02]}"
    task = crowded(tmp_path, f"    block: {same}\n    dish: {same}\n")
    wanted = (
        r"initial state 0: could not place `(block|dish)` in .* in 20 attempts, nor in any remaining cell: .* overlaps"
    )
    with pytest.raises(StartError, match=wanted):
        starts(task, 1)


def test_what_falls_off_the_table_has_no_start(tmp_path: Path) -> None:
    task = crowded(tmp_path, "    block: {x: [1.01, 1.02], y: [0, 0.01]}\n")
    with pytest.raises(StartError, match=r"could not place `block` .* times `block` fell off the scene"):
        starts(task, 1)


def test_a_goal_that_is_true_already_is_no_start(push: Task) -> None:
    with pytest.raises(StartError, match=r"6 times the goal already holds: "):
        starts(replace(push, goal="OnTop(block, table)"), 1)


def test_without_regions_every_start_is_the_same(push: Task) -> None:
    still = replace(push, reset=Reset(objects={}))
    a, b = starts(still, 2)
    assert a.digest == b.digest and a.cells == {}


def test_what_an_object_is_dealt_does_not_depend_on_the_others() -> None:
    region = ResetRegion(x=(0, 1), y=(0, 1))
    both, one = Reset(objects={"a": region, "b": region}), Reset(objects={"b": region})
    assert deal(both, 3, 0)["b"] == deal(one, 3, 0)["b"] != deal(both, 3, 0)["a"]
    assert deal(one, 3, 0)["b"] != deal(one, 3, 1)["b"] != deal(one, 4, 1)["b"]


def test_the_page_about_rollouts_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    page = (REPOSITORY / "docs" / "rollouts.md").read_text()
    monkeypatch.chdir(REPOSITORY)
    (block,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    exec(compile(block, "docs/rollouts.md", "exec"), {})


def test_the_cousins_of_a_recipe_start_from_different_positions(push: Task, tmp_path: Path) -> None:
    def cousin(index: int) -> Task:
        origin = f"origin: {{cousin: {{recipe: pushes, seed: 4, index: {index}, generator: simfoundry 0.1.0}}}}\n"
        return load_task(write_bench(tmp_path / str(index), TASK + origin))

    first, second = cousin(1), cousin(2)
    assert digests(starts(first, 2)) == digests(starts(cousin(1), 2))
    everyone = [*digests(starts(first, 2)), *digests(starts(second, 2)), *digests(starts(push, 2))]
    assert len(set(everyone)) == 6
    assert len({module.key_of_starts(task, 0) for task in (first, second, push)}) == 3
