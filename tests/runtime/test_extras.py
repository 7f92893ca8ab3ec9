"""Extras: what the code says of them is what pyproject.toml installs, and every message names the same line."""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

import pytest

from simfoundry.runtime.extras import EXTRAS, MissingExtraError, how_to_install, install_line, need_extra
from tests.cli.command import python, without
from tests.conftest import PACKAGE, REPOSITORY

PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
NAME = re.compile(r"[A-Za-z0-9._-]+")


def test_the_extras_are_those_of_the_package() -> None:
    declared = {
        extra: {NAME.match(requirement)[0] for requirement in requirements}  # type: ignore[index]
        for extra, requirements in PROJECT["optional-dependencies"].items()
        if extra not in ("browser", "dev", "docs")  # for those who work on the package
    }
    assert {name: set(extra.packages) for name, extra in EXTRAS.items()} == declared


def test_every_message_takes_its_line_from_one_place() -> None:
    own = {p.name for p in PACKAGE.rglob("*.py") if re.search(r"install (?:-\S+ )*['\"]?simfoundry\[", p.read_text())}
    assert own == {"extras.py"}


def test_a_module_leads_to_the_extra_that_brings_it(monkeypatch: pytest.MonkeyPatch) -> None:
    assert how_to_install("mink.tasks") == install_line("expert") == "pip install 'simfoundry[expert]'"
    assert how_to_install("zmq") == "pip install 'simfoundry[policies]'"
    assert how_to_install("some_thing.part") == "pip install some-thing"
    monkeypatch.setitem(sys.modules, "daqp", None)
    with pytest.raises(
        MissingExtraError, match=r"^the expert requires daqp; install with `pip install 'simfoundry\[exp"
    ):
        need_extra("expert", "the expert")


def test_the_expert_without_its_packages_is_a_sentence_before_anything_runs(tmp_path: Path) -> None:
    task = REPOSITORY / "specs" / "tasks" / "cup_in_bowl.task.yaml"
    done = python(without("mink"), "eval", task, "-p", "expert", "-o", tmp_path / "out")
    assert done.code == 2 and not (tmp_path / "out").exists()
    assert done.err == "Error: policy `expert` requires mink; install with `pip install 'simfoundry[expert]'`\n"
