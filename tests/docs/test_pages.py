"""The pages: every code block is run, or says who runs it or why nobody does; named paths and options exist."""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import click
import pytest

import simfoundry as sf
from simfoundry.cli.main import app
from tests.conftest import REPOSITORY, of_the_checkout

PAGES = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").rglob("*.md"))]
BLOCK = re.compile(r"(?:^<!-- (?P<note>[^\n]*) -->\n)?^```(?P<language>\w*)\n(?P<text>.*?)^```$", re.M | re.S)
TESTS = sorted((REPOSITORY / "tests").rglob("test_*.py"))
RUN_HERE = ("README.md", "index.md", "python.md")
RUN_ELSEWHERE = {
    "tutorial.md": "tests/test_tutorial.py",
    "findings.md": "tests/spec/check/test_explain.py",
    "reference.md": "tests/test_repository.py",
}
"""Pages all of whose blocks a test of their own runs."""


class Block(NamedTuple):
    """A fenced block of a page."""

    note: str
    language: str
    text: str


def blocks(page: Path) -> Iterator[Block]:
    """The blocks of a page."""
    for match in BLOCK.finditer(page.read_text()):
        yield Block(match["note"] or "", match["language"], match["text"])


by_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)


@by_page
def test_every_block_is_run_or_says_why_not(page: Path) -> None:
    if page.name in RUN_ELSEWHERE:
        assert page.name in (REPOSITORY / RUN_ELSEWHERE[page.name]).read_text() or page.name == "findings.md"
        return
    if page.parent.name == "extend":  # the steps of these pages are followed by tests of a package outside the tree
        return
    for block in blocks(page):
        if block.note.startswith("run in: "):
            test = Path(block.note.removeprefix("run in: ")).name
            assert [t for t in TESTS if t.name == test and page.name in t.read_text()], block
            continue
        here = page.name in RUN_HERE and block.language in ("python", "yaml")
        document = block.language == "yaml" and block.text.startswith("simfoundry:")  # tests/test_repository.py
        make = page.name == "README.md" and block.text.startswith("make demo")  # the set-up of every check
        assert here or document or make or re.match(r"not run: .{8,}", block.note), block


def test_the_python_of_usd_runs(tmp_path: Path) -> None:
    (tmp_path / "desk.scene.yaml").write_text(
        next(b.text for b in blocks(REPOSITORY / "docs/python.md") if b.language == "yaml")
    )
    (block,) = [b.text for b in blocks(REPOSITORY / "docs/usd.md") if b.language == "python"]
    with contextlib.chdir(tmp_path):
        sf.load("desk.scene.yaml").compile("usd", out="build")
        before = Path("desk.scene.yaml").read_bytes()
        exec(compile(block, "docs/usd.md", "exec"), {})
        assert Path("desk.scene.yaml").read_bytes() == before


@pytest.mark.parametrize("name", RUN_HERE)
def test_python_and_documents_of_a_page_run_in_their_order(name: str, tmp_path: Path) -> None:
    pytest.importorskip("pybullet", reason="PyBullet has wheels only for Python 3.11 on Linux")
    page = next(p for p in PAGES if p.name == name)
    scope: dict[str, object] = {}
    with contextlib.chdir(tmp_path):
        for block in blocks(page):
            if block.language == "yaml":
                (document,) = re.findall(r"^name: (\w+)", block.text, re.M)
                Path(f"{document}.scene.yaml").write_text(block.text)
            elif block.language == "python":
                exec(compile(block.text, str(page), "exec"), scope)
    assert "sf" in scope


@by_page
def test_options_in_the_pages_exist(page: Path) -> None:
    """Lines that begin with ``simfoundry`` are read by the parser of their command; nothing is run."""
    for block in blocks(page):
        if block.language not in ("sh", "console", "") or page.name in RUN_ELSEWHERE:
            continue
        for line in re.findall(r"^(?:\$ )?simfoundry ([^#\n|]+)", block.text.replace("\\\n", " "), re.M):
            words = shlex.split(line.replace("…", ""))
            context = click.Context(app, info_name="simfoundry")
            command = app.get_command(context, words[0])
            assert command is not None, line
            inner: click.Command | None = command
            rest = words[1:]
            while isinstance(inner, click.Group) and rest:
                inner, rest = inner.get_command(context, rest[0]), rest[1:]
            assert inner is not None, line
            known = {option for p in inner.params for option in (*p.opts, *p.secondary_opts)} | {"--help"}
            for word in rest:
                if re.match(r"--?[a-z]", word):
                    assert word.partition("=")[0] in known, f"{line}: {word}"


@of_the_checkout
@pytest.mark.parametrize("page", ["docs/architecture.md", "docs/faq.md", "CONTRIBUTING.md", "SECURITY.md"])
def test_paths_that_a_page_names_exist(page: str) -> None:
    text = (REPOSITORY / page).read_text()
    named = re.findall(r"`((?:simfoundry|targets|tests|docs|specs|schemas)/[\w./-]*)`", text)
    assert named or page != "docs/architecture.md"
    missing = [path for path in named if not (REPOSITORY / path).exists() and "sdf" not in path]
    assert missing == []


@of_the_checkout
def test_the_folders_of_the_architecture_are_those_that_there_are() -> None:
    text = (REPOSITORY / "docs/architecture.md").read_text()
    there = {p.name for p in (REPOSITORY / "simfoundry").iterdir() if (p / "__init__.py").is_file()}
    assert set(re.findall(r"^\| `simfoundry/(\w+)/` \|", text, re.M)) == there


def test_the_readme_is_a_screen_and_a_half() -> None:
    assert len((REPOSITORY / "README.md").read_text().splitlines()) <= 100


@pytest.mark.slow  # 7 s
def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="the pages are built with the extra `docs`")
    pytest.importorskip("mkdocstrings", reason="the pages are built with the extra `docs`")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path / "site")]
    quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}  # of the theme, about the generator after this one
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, env=quiet)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "WARNING" not in done.stderr
    assert (tmp_path / "site" / "api.html").is_file() and (tmp_path / "site" / "commands.html").is_file()
