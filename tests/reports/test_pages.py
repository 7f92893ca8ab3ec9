"""Every page escapes what documents and policies say, loads nothing from elsewhere and has the one style."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path

import pytest

from simfoundry.cousins.recipe.candidate import Candidate
from simfoundry.evaluate.statistics.correlation import RateAgreement
from simfoundry.reports import comparison, correlation, evaluation, gallery, verification
from simfoundry.reports.render import render
from simfoundry.spec.change.compare import compare, side
from simfoundry.verify.run import ReadbackResult

EVIL = "<script>alert('x')</script>\"'&<b>"


class _Tags(HTMLParser):
    """The tags of a page, and the addresses that they name."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.addresses: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        assert not [name for name, _ in attrs if name.startswith("on")]
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href")]


def _comparison(folder: Path) -> str:
    text = "simfoundry: task/1\nname: t\nscene: s.scene.yaml\ngoal: OnTop(a, b)\ninstruction: {}\n"
    for name, said in (("old", "go"), ("new", EVIL)):
        (folder / name).mkdir()
        (folder / name / "t.task.yaml").write_text(text.format('"' + said.replace('"', '\\"') + '"'))
    old, new = (side(folder / name / "t.task.yaml", EVIL) for name in ("old", "new"))
    return comparison.page([compare(EVIL, old, new)])


def _gallery(_: Path) -> str:
    facts = {"recipe": EVIL, "accepted": 5, "asked": 9, "seed": 0, "examined": 9, "acceptance_rate": 0.5, "end": EVIL}
    candidate = Candidate(1, asked=(EVIL,), goal=EVIL)
    return gallery.page({**facts, "reasons": {EVIL: 3}}, [candidate], {1: EVIL}, {EVIL: EVIL}, [EVIL])


def _evaluation(_: Path) -> str:
    record = {
        "task": EVIL, "part": "whole", "step": "", "policy": EVIL, "index": 0, "success": False, "end": EVIL,
        "reason": EVIL, "steps": 3, "subtasks": {EVIL: None}, "cells": {EVIL: [0, 0]}, "grid": [5, 5],
        "video": EVIL, "engine": EVIL, "engine_version": EVIL, "robots": {EVIL: EVIL}, "start": "1",
        "version": EVIL, "seed": 0, "instruction": EVIL, "asked_rollouts": 1, "control_hz": 15.0, "horizon": 9,
        "regions": {EVIL: {"x": [0, 1], "y": [0, 1]}}, "cousin": {"recipe": EVIL, "axes": [EVIL]},
    }  # fmt: skip
    return evaluation.page([record], EVIL)


def _verification(_: Path) -> str:
    return verification.page(
        [ReadbackResult(EVIL, "mujoco", None, EVIL, 0.1)], [], [], {"mujoco": None}, {EVIL: b"png"}
    )


def _correlation(_: Path) -> str:
    return correlation.scatter({EVIL: [RateAgreement(EVIL, (EVIL, "b"), (0.1, 0.5), (0.2, 0.4), 1.0, 0.0)]})


@pytest.mark.parametrize("page", [_comparison, _gallery, _evaluation, _verification, _correlation])
def test_no_text_becomes_markup(page: object, tmp_path: Path) -> None:
    assert callable(page)
    text = page(tmp_path)
    tags = _Tags(text)
    assert "script" not in tags.tags and text.count("&lt;script&gt;") >= 2
    assert "b" not in tags.tags or page is _evaluation
    for address in tags.addresses:
        assert address.startswith("data:image/png;base64,") or ":" not in address


@pytest.mark.parametrize("page", [_comparison, _gallery, _evaluation, _verification])
def test_pages_have_one_style_and_run_nothing(page: object, tmp_path: Path) -> None:
    assert callable(page)
    text = page(tmp_path)
    assert (
        "default-src 'none'" in text
        and (Path(render.__code__.co_filename).parent / "templates/style.css").read_text() in text
    )
