"""Recording: the same bytes whatever happens on the way, and nothing kept that does not replay."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import simfoundry as sf
from simfoundry.api.demonstrations import record_plan
from simfoundry.data import attempt as attempts
from simfoundry.data import store as stores
from simfoundry.data.plan import RecordPlan, RecordSummary
from simfoundry.data.record import record
from simfoundry.data.shards import Attempt, read_shard, write_shard
from simfoundry.data.store import SHARDS, UNFINISHED
from simfoundry.data.trajectory import TrajectorySampler
from simfoundry.errors import OutputError, SimfoundryError
from simfoundry.evaluate.entries import Contender
from simfoundry.evaluate.rollouts.rollout import RolloutEnd
from simfoundry.render.gl import Engine, choose_engine
from tests.cli.command import run
from tests.conftest import REPOSITORY
from tests.evaluate.benches import write_bench


@pytest.fixture
def here(bench: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.chdir(bench.parent)
    monkeypatch.setattr(Contender, "is_foreign", False)  # starting a worker process for each recording takes long
    yield bench.parent
    attempts.close()


def plan_of(
    folder: Path, count: int, query: str = "miss=3", seed: int = 0, max_attempts: int | None = None
) -> RecordPlan:
    policy = f"python:pushing.py:Push?{query}"
    return record_plan([Path("push.task.yaml")], policy, folder, count, seed, max_attempts)


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_what_is_recorded_can_be_read_and_replays(demos: Path) -> None:
    found = sf.demonstrations(demos)
    assert len(found) == 4 and found.about["instruction"] == "Push the block away."
    assert found.about["objects"] == ["table", "block", "dish", "crumb"] and not (demos / UNFINISHED).exists()
    assert len({demo.index for demo in found}) == 4 and all(demo.index % 3 for demo in found)
    with found.open() as world:
        for demo in found[1:3]:
            states = list(found.replay(demo, world))
            assert len(states) == demo.steps + 1 == len(demo.states["objects"])
            for k, state in enumerate(states):
                poses = np.array([[*pose.p, *pose.q] for pose in state.poses.values()])
                np.testing.assert_array_equal(poses, demo.states["objects"][k])
                assert list(state.robots["arm"].values()) == demo.states["arm/model"][k].tolist()
            assert demo.states["arm/joints"].shape == (demo.steps + 1, 2)
            assert demo.actions.shape == (demo.steps, 3) and str(demo.action_space) == "joint_position"
            assert demo.subtasks["away"] == demo.steps - 2


@pytest.mark.skipif(choose_engine() is Engine.RAYCAST, reason="no GL driver")
def test_pictures_of_any_size_show_the_same_poses(demos: Path, here: Path) -> None:
    shutil.copytree(demos, here / "demos")
    (here / "demos" / "demonstrations.json").write_text(
        (demos / "demonstrations.json").read_text().replace(_document(demos), "../push.task.yaml")
    )
    page = (REPOSITORY / "docs" / "demonstrations.md").read_text()
    made: dict[str, Any] = {}
    exec(page.partition("```python\n")[2].partition("```")[0], made)
    assert np.shape(made["image"]) == (48, 64, 3)
    found = sf.demonstrations(demos)
    with found.open() as world:
        last = [
            (list(found.replay(found[0], world))[-1], world.render("front", *size)) for size in ((64, 48), (32, 24))
        ]
    assert last[0][0].poses.keys() == last[1][0].poses.keys()
    assert all(np.array_equal(p.p, last[1][0].poses[n].p) for n, p in last[0][0].poses.items())
    assert [image.shape for _, image in last] == [(48, 64, 3), (24, 32, 3)]


def _document(folder: Path) -> str:
    return str(json.loads((folder / "demonstrations.json").read_text())["document"])


@pytest.mark.slow  # 7 s: it records several times
def test_the_bytes_depend_neither_on_processes_nor_on_interruptions(demos: Path, here: Path) -> None:
    for name, counts, jobs in (("more", (2, 4), 1), ("jobs", (4,), 2)):
        out = here / name / "demos"
        for count in counts:
            record(plan_of(out, count), workers=jobs)
        mine, theirs = bytes_of(out), bytes_of(demos)
        assert mine.keys() == theirs.keys() and mine["shards/00000.npz"] == theirs["shards/00000.npz"]
    kept = len(sf.demonstrations(out))
    assert record(plan_of(out, 1)).kept == kept == 4  # fewer than there are: nothing is lost


@pytest.mark.slow  # 5 s: it records several times
def test_a_killed_recording_is_resumed_without_loss_or_repetition(demos: Path, here: Path) -> None:
    out = here / "killed" / "demos"
    command = [sys.executable, "-m", "simfoundry", "record", "push.task.yaml", "-n", "4", "-o", str(out)]
    command += ["-p", "python:pushing.py:Push?miss=3"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None and len(list((out / UNFINISHED).glob("*.npz"))) < 2:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    before = {path.name: path.read_bytes() for path in (out / UNFINISHED).glob("*.npz")}
    (out / UNFINISHED / ".000099.npz.abcd1234").write_bytes(b"half")  # what a kill leaves of a file
    done = run("record", "push.task.yaml", "-n", "4", "-o", str(out), "-p", "python:pushing.py:Push?miss=3", "--json")
    assert done.code == 0, done.err
    assert json.loads(done.out)["demonstrations"] == 4 and (len(before) >= 2 or process.returncode == 0)
    assert (out / "shards/00000.npz").read_bytes() == (demos / "shards/00000.npz").read_bytes()
    assert not (out / UNFINISHED).exists()


def _finished(k: int, kept: bool) -> Attempt:
    arrays = {"actions": np.full((2, 3), float(k))} if kept else {}
    return Attempt({"index": k, "kept": kept, "end": "success" if kept else "horizon", "reason": ""}, arrays)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.usefixtures("here")
def test_full_shards_are_the_same_in_every_order(seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Attempts that finish in any order, with kills between any two of them."""
    monkeypatch.setattr(stores, "SHARD", 3)
    rng = np.random.default_rng(seed)

    def won(k: int) -> bool:
        return (k * 7 + 3) % 5 < 3

    def run_in(folder: Path, workers: int, kill: float) -> RecordSummary:
        while True:
            folder.mkdir(exist_ok=True)
            store = stores.AttemptStore(plan_of(folder, 10))
            running: set[int] = set()
            while True:
                while len(running) < workers and (job := store.next(running)) is not None:
                    running.add(job.index)
                if not running:
                    store.finish()
                    return store.summary()
                k = int(rng.choice(sorted(running)))
                running.discard(k)
                store.add(_finished(k, won(k)))
                if rng.random() < kill:
                    break

    plain = run_in(tmp_path / "a", 1, 0.0)
    wild = run_in(tmp_path / "b", 4, 0.4)
    assert plain == wild and plain.kept == 10 and won(plain.attempts - 1)
    assert bytes_of(tmp_path / "a") == {**bytes_of(tmp_path / "b")}
    assert len(list((tmp_path / "a" / SHARDS).iterdir())) == 4


@pytest.mark.usefixtures("here")
def test_what_does_not_replay_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = attempts.replay

    class Liar:
        """Replays in this process, the second attempt with other actions."""

        calls = 0

        def call(self, _: str, document: Path, recorded: attempts._Recorded) -> object:
            self.calls += 1
            actions = recorded.actions + 1e-9 * (self.calls == 2)
            return whole(document, replace(recorded, actions=actions))

        def close(self, _: float) -> None:
            pass

    monkeypatch.setattr(attempts._Process, "verifier", Liar())
    summary = record(plan_of(tmp_path / "d", 2, "miss=0"))
    assert (summary.kept, summary.not_reproduced) == (2, (1,)) and summary.attempts >= 3
    assert "the replay reached" in summary.reasons[attempts.NOT_REPRODUCED]
    assert 1 not in [demo.index for demo in sf.demonstrations(tmp_path / "d")]


def test_a_policy_that_never_wins_comes_to_an_end(here: Path) -> None:
    result = run("record", "push.task.yaml", "-p", "python:pushing.py:Push?bad=nan", "-n", "3", "-o", "nan",
                 "--max-attempts", "2")  # fmt: skip
    assert result.code == 1 and "nan: no demonstrations in 2 attempts" in result.out
    assert "0 of 3 demonstrations were recorded in 2 attempts of `Push`: 2 ended with `invalid answer`" in result.err
    assert "joint 1 of `arm`" in result.err and RolloutEnd.INVALID in result.err
    assert len(sf.demonstrations(here / "nan")) == 0
    with pytest.raises(SimfoundryError, match="0 of 1 demonstrations"):
        sf.record("push.task.yaml", "random", out="never", count=1, max_attempts=1)
    with pytest.raises(SimfoundryError, match="`count` must be between 1"):
        sf.record("push.task.yaml", "random", out="never", count=0)


@pytest.mark.slow  # 2 s
def test_a_policy_that_ends_its_process_ends_the_recording_with_a_sentence(
    bench: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(bench.parent)
    with pytest.raises(SimfoundryError, match="the worker process for attempt 0 exited with code 7"):
        record(plan_of(tmp_path / "exit", 1, "bad=exit"))
    assert len(sf.demonstrations(tmp_path / "exit")) == 0


def test_folders_of_others_are_refused(demos: Path, here: Path) -> None:
    (here / "mine").mkdir()
    (here / "mine" / "thesis.tex").write_text("")
    with pytest.raises(OutputError, match=r"contains other files, such as thesis\.tex"):
        record(plan_of(here / "mine", 1))
    with pytest.raises(OutputError, match="a different policy"):
        record(plan_of(demos, 5, "miss=4"))
    with pytest.raises(OutputError, match="a different scene, goal or initial states"):
        record(plan_of(demos, 5, seed=1))
    with pytest.raises(SimfoundryError, match="is not a folder of demonstrations"):
        sf.demonstrations(here / "nothing")
    with pytest.raises(OutputError, match=r"demonstrations\.json is missing"):
        sf.demonstrations(here / "mine")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda data: data[: len(data) // 2], "not a zip file"),
        (lambda data: b"", "not a zip file"),
        (lambda data: data.replace(b"000001/actions", b"000001/bctions"), "is not|does not contain"),
    ],
)
def test_damaged_shards_are_refused(demos: Path, tmp_path: Path, change: object, words: str) -> None:
    copy = shutil.copytree(demos, tmp_path / "copy")
    shard = copy / SHARDS / "00000.npz"
    shard.write_bytes(change(shard.read_bytes()))  # type: ignore[operator]
    with pytest.raises(OutputError, match=words):
        list(sf.demonstrations(copy))


@pytest.mark.parametrize(
    ("about", "arrays", "words"),
    [
        ({"steps": 3}, {}, r"the shape of `objects` is \(\d+, 4, 7\), not \(4, 4, 7\)"),
        ({"action_hz": 1e-9}, {}, "its actions do not last as long as its states"),
        ({"action_hz": -1.0}, {}, "it must be the number of actions per second"),
        ({"action_space": "telepathy"}, {}, "unknown action space `telepathy`"),
        ({"initial": {"poses": {}, "joints": {}, "motions": {}}}, {}, "does not have the objects and joints"),
        ({"initial": None}, {}, "NoneType"),
        ({}, {"actions": np.zeros((27, 1))}, r"the shape of `actions` is \(27, 1\), not \(actions, 3\)"),
        ({}, {"arm/hand": np.zeros((2, 7))}, "the shape of `arm/hand`"),
        ({}, {"more": np.zeros(3)}, "the array `more` is unknown"),
    ],
)
def test_demonstrations_that_do_not_fit_their_task_are_refused(
    demos: Path, tmp_path: Path, about: dict[str, Any], arrays: dict[str, np.ndarray], words: str
) -> None:
    shard = shutil.copytree(demos, tmp_path / "copy") / SHARDS / "00000.npz"
    kept = [Attempt({**a.about, **about}, {**a.arrays, **arrays}) if a.is_kept else a for a in read_shard(shard)]
    write_shard(shard, kept)
    with pytest.raises(OutputError, match=f"00000.npz does not contain valid demonstrations: .*{words}"):
        list(sf.demonstrations(tmp_path / "copy"))


@pytest.mark.parametrize("change", [{"tasks": []}, {"tasks": 3}, {"objects": "abc"}, {"seed": "x"}, {"control_hz": 0}])
def test_damaged_indexes_are_refused(demos: Path, tmp_path: Path, change: dict[str, Any]) -> None:
    path = shutil.copytree(demos, tmp_path / "copy") / "demonstrations.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(OutputError, match="is not an index of demonstrations"):
        sf.demonstrations(tmp_path / "copy")


def test_a_missing_shard_is_noticed(demos: Path, tmp_path: Path) -> None:
    shard = shutil.copytree(demos, tmp_path / "copy") / SHARDS / "00000.npz"
    shard.rename(shard.with_name("00001.npz"))
    with pytest.raises(OutputError, match=r"00001\.npz does not continue the shards before it"):
        sf.demonstrations(tmp_path / "copy")


def test_shards_hold_numbers_only(tmp_path: Path) -> None:
    values: list[Any] = [np.full((2, 3), np.nan), np.zeros((2, 3), np.float32)]
    for value in values:
        write_shard(tmp_path / "a.npz", [Attempt({"index": 0, "kept": True}, {"actions": value})])
        with pytest.raises(OutputError, match="does not contain finite numbers in float64"):
            read_shard(tmp_path / "a.npz")
    with zipfile.ZipFile(tmp_path / "b.npz", "w") as files:
        files.writestr("shard.json", '{"simfoundry": "demonstrations/9"}')
    with pytest.raises(OutputError, match="its format is demonstrations/9"):
        read_shard(tmp_path / "b.npz")


def test_a_policy_with_its_own_rate_is_recorded(here: Path) -> None:
    record(plan_of(here / "slow", 1, "hz=5"))
    (demo,) = sf.demonstrations(here / "slow")
    assert demo.action_hz == 5.0 and len(demo.actions) == -(-demo.steps // 3)


@pytest.fixture(scope="module")
def tasks(bench: Path) -> Path:
    """A folder of two tasks whose scenes have different objects."""
    from tests.evaluate.benches import SCENE, TASK

    folder = bench.parent / "several tasks"
    crumbs = "  crumb: {shape: {box: [0.02, 0.02, 0.02]}, material: wood, place: {on: dish}}\n"
    scenes = SCENE, SCENE.replace(crumbs, "").replace(", OnTop(crumb, dish)", "")
    near = TASK.replace("x: [0.31, 0.33], y: [-0.02, 0.02]", "x: [0.319, 0.321], y: [-0.001, 0.001]")
    for name, scene in zip(("a", "b"), scenes, strict=True):
        write_bench(folder / name, near.replace("push", f"push_{name}", 1), scene)
    return folder


@pytest.mark.slow  # 7 s: it records several times
def test_several_tasks_take_turns(tasks: Path, here: Path) -> None:
    documents = sorted(tasks.rglob("*.task.yaml"))
    plans = [replace(plan_of(here / name, 3), documents=tuple(documents)) for name in ("turns", "turns jobs")]
    assert [record(replace(plans[0], count=count)).kept for count in (1, 3)] == [1, 3]
    assert record(plans[1], workers=2).kept == 3
    assert bytes_of(plans[0].folder) == bytes_of(plans[1].folder)
    found = sf.demonstrations(plans[0].folder)
    assert [demo.index for demo in found] == [2, 3, 4]  # each task fails from its initial state 0
    assert [demo.document for demo in found] == [documents[k].resolve() for k in (0, 1, 0)]
    assert [demo.start.index for demo in found] == [1, 1, 2]
    assert "objects" not in found.about and found.about["instruction"] == "Push the block away."
    assert [len(demo.about["objects"]) for demo in found[:2]] == [4, 3]
    for demo in found[:2]:
        assert demo.load_task().name == found.task_of(demo).name == demo.about["task"]
        with found.open(demo) as world:
            states = list(found.replay(demo, world))
        poses = np.array([[*pose.p, *pose.q] for pose in states[-1].poses.values()])
        np.testing.assert_array_equal(poses, demo.states["objects"][-1])
    with pytest.raises(OutputError, match="contains 2 tasks; use `task_of`"):
        found.open()


def test_other_tasks_are_refused(tasks: Path, here: Path) -> None:
    (first, second), out = sorted(tasks.rglob("*.task.yaml")), here / "others"
    plan = replace(plan_of(out, 1, "miss=0"), documents=(first, second))
    assert record(plan).kept == 1
    with pytest.raises(OutputError, match="contains demonstrations of 2 tasks, not of the task `push_a`"):
        record(replace(plan, documents=(first,)))
    with pytest.raises(OutputError, match=r"several tasks/b/push\.task\.yaml with a different `task`: 'push_a'"):
        record(replace(plan, documents=(second, first)))
    done = run("record", str(tasks), str(first), "-p", "python:pushing.py:Push", "-n", "1", "-o", str(here / "twice"))
    assert done.code == 2 and "several tasks/a/push.task.yaml is listed twice" in done.err
    done = run("record", str(out / "shards"), "-o", str(here / "none"))
    assert done.code == 2 and "does not contain any tasks" in done.err


@pytest.mark.slow  # 2 s
def test_noise_and_latency_replay_to_the_bit(here: Path) -> None:
    document = here / "push.task.yaml"
    text = document.read_text()
    about = (
        "disturbances: {action: {latency: 0.04, joint_noise: 0.01}, observation: {latency: 0.05, joint_noise: 0.01}}\n"
    )
    try:
        document.write_text(text + about)
        assert record(plan_of(here / "noisy", 2)).not_reproduced == ()
        found = sf.demonstrations(here / "noisy")
        with found.open() as world:
            for demo in found:
                last = list(found.replay(demo, world))[-1]
                assert [*last.poses["block"].p] == demo.states["objects"][-1][1][:3].tolist()
        with TrajectorySampler(found.task) as sampler:  # in a dataset, targets are those that the policy commanded
            trajectory = sampler.sample(found[0], 2 * found.task.control_hz)
        np.testing.assert_array_equal(trajectory.targets["arm"][2::2], found[0].actions[:, :2])
        np.testing.assert_array_equal(trajectory.observations["objects"][::2], found[0].states["objects"])
        document.write_text(text + about.replace("latency: 0.05, ", ""))  # observations do not matter for a replay
        assert sf.demonstrations(here / "noisy").task.disturbances.action.latency == 0.04
        with pytest.raises(OutputError, match="demonstrations with a different `disturbances`"):
            record(plan_of(here / "noisy", 2))
        document.write_text(text)
        with pytest.raises(OutputError, match="has changed since"):
            _ = sf.demonstrations(here / "noisy").task
    finally:
        document.write_text(text)
