"""The whole in one command: stages that are not repeated, a report, and what goes wrong in one sentence."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

import simfoundry as sf
from tests.cli.command import run

# A policy of one run learns nothing in so few steps; what matters here is that all stages run.
OPTIONS = ("-p", "python:pushing.py:Push", "-n", "4", "--steps", "20", "--rollouts", "2", "--no-video")


@pytest.fixture(scope="module")
def here(bench: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("command") / "project"
    shutil.copytree(bench.parent, folder)
    return folder


def files_of(folder: Path) -> dict[str, tuple[int, bytes]]:
    return {
        str(p.relative_to(folder)): (p.stat().st_mtime_ns, p.read_bytes()) for p in folder.rglob("*.*") if p.is_file()
    }


def test_all_stages_run_once(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(here)
    done = run("train", "push.task.yaml", "-o", "out", *OPTIONS, "--json")
    assert done.code == 0, done.err
    report = done.json
    assert report["seen_starts"] == 0 and report["missing"] == 0
    (policy,) = report["policies"].values()
    assert policy["demonstrations"] == 4 and policy["steps"] == 20 and len(policy["losses"]) == 20
    assert set(policy["versions"]) == {"simfoundry", "torch", "mujoco"}
    assert report["scores"][0]["rollouts"] == 2 and report["scores"][0]["policy"] == "seed_0"
    assert (here / "out" / policy["folder"] / "baseline.json").is_file()
    assert json.loads((here / "out" / "report.json").read_text())["policies"] == report["policies"]
    page = (here / "out" / "report.html").read_text()
    assert "seed_0" in page and page.count("<polyline") == 1 and f"{report['evaluation']}/report.html" in page
    assert len(sf.demonstrations(here / "out" / "demonstrations")) == 4

    before = files_of(here / "out")
    again = run("train", "push.task.yaml", "-o", "out", *OPTIONS)
    assert again.code == 0 and "seed_0: 0/2" in again.out.replace("1/2", "0/2"), again.err
    after = files_of(here / "out")
    written = {name for name in after if after[name][0] != before[name][0]}
    assert {name: data for name, (_, data) in after.items()} == {name: data for name, (_, data) in before.items()}
    assert all(name.endswith(("report.json", "report.html", "results.json")) for name in written), written

    more = run("train", "push.task.yaml", "-o", "out", *OPTIONS, "--seed", "1", "--seed", "2", "--json")
    assert set(more.json["policies"]) == {"seed_1", "seed_2"}
    assert len(list((here / "out" / "policies").iterdir())) == 3


def test_demonstrations_can_be_learned_directly(demos: Path, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(here)
    done = run("train", demos, "-o", "direct", *OPTIONS, "--require", "1", "--json")
    assert done.code == 1 and done.json["policies"]["seed_0"]["demonstrations"] == 4
    assert not (here / "direct" / "demonstrations").exists()


@pytest.mark.slow  # 10 s: it records, generates, trains and evaluates
def test_demonstrations_are_generated_between_recording_and_training(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(here)
    options = ("-p", "python:pushing.py:Push", "-n", "2", "--augment", "3", "--steps", "20", "--rollouts", "1")
    done = run("train", "push.task.yaml", "-o", "more", *options, "--no-video", "--json")
    assert done.code == 0, done.err
    made, (policy,) = done.json["augmentation"], done.json["policies"].values()
    assert (made["folder"], made["demonstrations"], policy["demonstrations"]) == ("augmented", 3, 3)
    assert made["success"]["successes"] == 3 and {one["demonstration"] for one in made["sources"]} <= {0, 1}
    assert len(sf.demonstrations(here / "more" / "demonstrations")) == 2
    assert len(sf.demonstrations(here / "more" / "augmented")) == 3
    assert "generated from" in (here / "more" / "report.html").read_text()
    before = files_of(here / "more")
    again = run("train", "push.task.yaml", "-o", "more", *options, "--no-video")
    assert again.code == 0 and "3 demonstrations generated in" in again.out
    assert {name: data for name, (_, data) in files_of(here / "more").items()} == {
        name: data for name, (_, data) in before.items()
    }
    both = run("train", "more/demonstrations", "more/augmented", "--augment", "3", "-o", "both", "--steps", "20")
    assert both.code == 2 and "several folders of demonstrations cannot be augmented together" in both.err


def test_names_cannot_inject_markup() -> None:
    from simfoundry.reports.training import training_page

    evil = "<script>alert(1)</script>"
    facts = {"folder": evil, "tasks": [evil], "demonstrations": 1, "steps": 1, "loss": 1.0, "versions": {evil: evil}}
    losses = [{"step": 1, "train": 0.5, "validation": None}]
    report = {"policies": {evil: {**facts, "losses": losses}}, "sources": [evil], "seen_starts": 0, "evaluation": evil}
    page = training_page(report, [])
    assert "<script" not in page and "&lt;script&gt;" in page


@pytest.mark.parametrize(("arguments", "message"), [
    (("nowhere.task.yaml",), "does not exist"),
    (("push.task.yaml", "{demos}"), "tasks and folders of demonstrations cannot be combined"),
    (("push.task.yaml", "--seed", "1", "--seed", "1"), "the seeds of the trainings must differ"),
    (("push.task.yaml", "-o", "notes.txt/out"), "Not a directory"),
    (("{demos}", "-n", "13"), "training needs 13 demonstrations, but there are 12"),
    (("push.task.yaml", "-p", "random", "-n", "2", "-o", "few"), "2 demonstrations were recorded in"),
])  # fmt: skip
def test_mistakes_are_reported_in_one_sentence(
    demos: Path, here: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], message: str
) -> None:
    monkeypatch.chdir(here)
    (here / "notes.txt").write_text("mine")
    words = [word.format(demos=demos) for word in arguments]
    done = run("train", *words, *(() if "-n" in words else ("-n", "2")), "--steps", "20", "--no-video")
    assert done.code == 2 and done.one_line("Error:", message) and "Traceback" not in done.err
