"""Runs: the same bytes whatever examines the candidates, and however often it is killed."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from simfoundry.cousins.recipe.candidate import Candidate
from simfoundry.cousins.run.log import Log, log_file, read_places
from simfoundry.cousins.run.report import write_manifest
from simfoundry.cousins.run.run import LEAST_RATE, PATIENCE, Ledger, RunEnd, RunPlan, finish, run
from simfoundry.cousins.run.worker_pools import CandidatePool, Work, open_pool
from simfoundry.errors import OutputError
from tests.conftest import REPOSITORY
from tests.cousins.run import toy
from tests.cousins.run.toy import Here

RATE = 0.4


def work(rate: float = RATE) -> Work:
    return Work(toy.FUNCTION, (rate,))


class Shuffled(Here):
    """Gives candidates back in any order."""

    def __init__(self, work: Work, size: int = 4, seed: int = 0) -> None:
        super().__init__(work, size)
        self._chance = random.Random(seed)

    def next(self) -> Candidate:
        return self.work.sampler()(self._asked.pop(self._chance.randrange(len(self._asked))))


def plan(out: Path, wanted: int = 30, **more: object) -> RunPlan:
    return replace(RunPlan(out, wanted, {"recipe": "toy", "seed": 0}), **more)  # type: ignore[arg-type]


def made(a: RunPlan, pool: CandidatePool | None = None) -> dict[str, bytes]:
    """A whole run, and every file of it, its log included."""
    ledger = run(a, lambda: pool or Here(work()))
    write_manifest(a, ledger)
    finish(a, ledger)
    return {p.relative_to(a.out).as_posix(): p.read_bytes() for p in sorted(a.out.rglob("*")) if p.is_file()}


def test_the_first_accepted_by_index_whatever_the_order(tmp_path: Path) -> None:
    expected = [k for k in range(1, 200) if toy.candidate(RATE, k).accepted][:30]
    found = made(plan(tmp_path / "a"))
    assert [int(name[:6]) for name in found if name.endswith(".scene.yaml")] == expected
    for seed in range(3):
        assert made(plan(tmp_path / f"b{seed}"), Shuffled(work(), seed=seed)) == found
    assert made(plan(tmp_path / "c"), open_pool(work(), jobs=2)) == found


def test_the_manifest_lists_every_candidate_that_counts(tmp_path: Path) -> None:
    made(plan(tmp_path / "a"), Shuffled(work()))
    manifest = json.loads((tmp_path / "a/manifest.json").read_bytes())
    indices = sorted(e["index"] for e in manifest["cousins"] + manifest["rejected"])
    assert indices == list(range(1, manifest["examined"] + 1))
    assert indices[-1] == manifest["cousins"][-1]["index"]
    assert manifest["end"] == "complete" and manifest["accepted"] == 30
    assert manifest["acceptance_rate"] == round(30 / len(indices), 4)
    assert sum(manifest["reasons"].values()) == len(manifest["rejected"])
    for entry in manifest["rejected"]:
        assert entry["reasons"] == [r.to_json() for r in toy.candidate(RATE, entry["index"]).reasons]


def test_shards_in_any_order_and_then_the_whole(tmp_path: Path) -> None:
    expected = made(plan(tmp_path / "a"))
    out = tmp_path / "b"
    for i in (3, 1, 2):
        ledger = run(plan(out, shard=(i, 3)), lambda: Here(work()))
        assert len(ledger.accepted) == 10 and not list(out.glob("*.yaml"))
        assert {k % 3 for k in ledger.accepted} == {i % 3}
    examined: list[int] = []

    class Counting(Here):
        def submit(self, index: int) -> None:
            examined.append(index)
            super().submit(index)

    assert made(plan(out), Counting(work())) == expected
    assert len(examined) < 10, "what the shards know is not examined again"


def test_more_cousins_go_on_from_those_that_are_there(tmp_path: Path) -> None:
    before = made(plan(tmp_path / "a", wanted=10))
    after = made(plan(tmp_path / "a", wanted=30))
    assert after == made(plan(tmp_path / "b", wanted=30))
    assert {k: v for k, v in after.items() if k in before and k.endswith(".scene.yaml")} == {
        k: v for k, v in before.items() if k.endswith(".scene.yaml")
    }
    with pytest.raises(OutputError, match="contains 20 documents of cousins beyond the 10"):
        made(plan(tmp_path / "a", wanted=10))


def test_a_torn_last_line_is_not_believed(tmp_path: Path) -> None:
    expected = made(plan(tmp_path / "a"))
    whole = (tmp_path / "a" / ".cousins" / "log.jsonl").read_bytes()
    for k, cut in enumerate((1, len(whole) // 3, len(whole) - 1)):
        out = tmp_path / f"b{k}"
        run(plan(out, wanted=1), lambda: Here(work()))
        log_file(out, None).write_bytes(whole[:cut])
        for path in out.glob("*.yaml"):
            path.unlink()
        assert made(plan(out)) == expected


def test_a_line_that_is_none_is_an_error_with_its_place(tmp_path: Path) -> None:
    made(plan(tmp_path / "a"))
    file = log_file(tmp_path / "a", None)
    file.write_bytes(b"{}\n" + file.read_bytes())
    with pytest.raises(OutputError, match=r"log\.jsonl:1 is not a valid line in a cousins log"):
        run(plan(tmp_path / "a"), lambda: Here(work()))


def test_one_run_at_a_time(tmp_path: Path) -> None:
    with Log(log_file(tmp_path, None)), pytest.raises(OutputError, match="another run"):
        Log(log_file(tmp_path, None))


def test_a_folder_of_another_run_or_of_other_things_is_left_alone(tmp_path: Path) -> None:
    made(plan(tmp_path / "a"))
    with pytest.raises(OutputError, match="its seed is 0, not 1"):
        run(plan(tmp_path / "a", about={"recipe": "toy", "seed": 1}), lambda: Here(work()))
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "mine.txt").write_text("")
    with pytest.raises(OutputError, match=r"mine\.txt"):
        run(plan(tmp_path / "b"), lambda: Here(work()))


def test_a_hopeless_recipe_stops_with_numbers(tmp_path: Path) -> None:
    ledger = run(plan(tmp_path / "a"), lambda: Shuffled(work(0.0)))
    assert (ledger.end, ledger.examined, ledger.accepted) == (RunEnd.HOPELESS, PATIENCE, [])
    assert sum(ledger.totals.values()) == PATIENCE
    rare = run(plan(tmp_path / "b", wanted=1000), lambda: Here(work(1.04 * LEAST_RATE)))
    assert rare.end is RunEnd.HOPELESS and rare.accepted and rare.rate < LEAST_RATE


def test_a_recipe_with_an_end(tmp_path: Path) -> None:
    ledger = run(plan(tmp_path / "a", most=20), lambda: Here(work()))
    assert (ledger.end, ledger.examined) == (RunEnd.EXHAUSTED, 20)
    assert ledger.accepted == [k for k in range(1, 21) if toy.candidate(RATE, k).accepted]


def test_a_process_that_dies_costs_its_candidate_at_most(tmp_path: Path) -> None:
    pool = open_pool(Work("tests.cousins.run.toy:fragile_sampler", (str(tmp_path / "mark"),)), jobs=2)
    ledger = run(plan(tmp_path / "a", wanted=10), lambda: pool)
    assert ledger.accepted == [1, 2, 3, 4, 6, 8, 9, 10, 11, 12]
    assert ledger.totals == {"failed": 2}


def test_work_ahead_is_bounded(tmp_path: Path) -> None:
    """The first candidate comes last of all that are asked for before it: there are not many."""
    asked: list[int] = []

    class Late(Here):
        def submit(self, index: int) -> None:
            asked.append(index)
            super().submit(index)

        def next(self) -> Candidate:
            self._asked.sort(key=lambda k: (k == 1, k))
            return self.work.sampler()(self._asked.pop(0))

    run(plan(tmp_path / "a", wanted=200), lambda: Late(work(), 2))
    before = asked[: asked.index(1) + 1] if 1 in asked else asked
    assert len(before) == 1 and max(asked) < 1000


def test_what_a_kill_left_half_written_is_cleared(tmp_path: Path) -> None:
    expected = made(plan(tmp_path / "a"))
    for name in (".000003.scene.yaml.3s_pgwz_", ".manifest.json.x1y2z3__"):
        (tmp_path / "a" / name).write_bytes(b"half")
    (tmp_path / "a" / ".gitignore").write_bytes(b"mine")
    assert made(plan(tmp_path / "a")) == {**expected, ".gitignore": b"mine"}


@pytest.mark.slow  # 4 s: it starts several runs
def test_killed_at_random_moments_and_resumed(tmp_path: Path) -> None:
    expected = made(plan(tmp_path / "a", wanted=60))
    program = (
        "import sys; from pathlib import Path; from tests.cousins.run.test_run import plan, made, work;"
        "from simfoundry.cousins.run.worker_pools import open_pool;"
        "made(plan(Path(sys.argv[1]), wanted=60), open_pool(work(), jobs=2))"
    )
    out, chance = tmp_path / "b", random.Random(1)
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    lines = []
    for _ in range(3):
        process = subprocess.Popen([sys.executable, "-c", program, str(out)], env=environment, start_new_session=True)
        goal = len(read_places(log_file(out, None))) + chance.randrange(3, 30)
        while process.poll() is None and len(read_places(log_file(out, None))) < goal:
            time.sleep(0.005)
        os.killpg(process.pid, signal.SIGKILL) if process.poll() is None else None
        process.wait()
        lines.append(len(read_places(log_file(out, None))))
    assert lines == sorted(lines) and lines[0] >= 3
    assert made(plan(out, wanted=60)) == expected


def test_candidates_travel_as_lines() -> None:
    for index in range(1, 30):
        candidate = toy.candidate(RATE, index)
        assert Candidate.of(candidate.line()) == candidate
        assert "\n" not in candidate.line()
    for text in ("", "[]", "{}", '{"index": 3}', '{"index": "x", "reasons": [{}]}', json.dumps({"reasons": 3})):
        with pytest.raises(ValueError):
            Candidate.of(text)


def test_an_empty_ledger_counts_nothing() -> None:
    ledger = Ledger(5)
    assert (ledger.examined, ledger.rate, ledger.last, list(ledger.counted())) == (0, 0.0, 0, [])
