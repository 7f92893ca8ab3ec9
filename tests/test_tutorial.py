"""The tutorial is run: each command and each edit in its order, and what is shown is what is printed.

``--update-goldens`` writes what the commands print, and the picture, into the page; review the diff.
"""

from __future__ import annotations

import contextlib
import re
import shlex
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from simfoundry.spec.load import load
from simfoundry.spec.project import Project, find_project
from tests.cli.command import run
from tests.conftest import REPOSITORY

PAGE = REPOSITORY / "docs" / "tutorial.md"
PICTURE = REPOSITORY / "docs" / "images" / "tutorial.png"
BLOCK = re.compile(
    r"(?:^<!-- (?P<note>[^\n]*) -->\n)?^```(?P<language>\w+)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL
)


@dataclass
class Reader:
    """Somebody who does what the page says, in a folder of their own."""

    folder: Path
    commands: int = 0

    def follow(self, block: re.Match[str]) -> str:
        """Do what a block says; the block as it should be."""
        note, language, text = block["note"] or "", block["language"], block["text"]
        if language == "console":
            return f"```console\n{self.console(text)}```"
        name = re.search(r"\S+\.yaml", note)
        assert name is not None, f"nobody knows what to do with\n{block[0]}"
        file = self.folder / name[0]
        before = file.read_text()
        if note.startswith("shown in"):
            assert text in before, f"{name[0]} does not hold\n{text}"
        elif note.startswith("append to"):
            file.write_text(before + text)
        elif place := re.fullmatch(r'insert into \S+ before "(.*)"', note):
            assert before.count(place[1]) == 1
            file.write_text(before.replace(place[1], text + place[1]))
        else:
            assert note.startswith("change"), note
            file.write_text(changed(before, text))
        return block[0]

    def console(self, text: str) -> str:
        """Run the commands of a block; the block with what they print."""
        commands = re.findall(r"^\$ (.*)\n", text, re.MULTILINE)
        return "".join(f"$ {command}\n{self.run(command)}" for command in commands)

    def run(self, command: str) -> str:
        """What a command prints; ``cd`` changes the folder for those that follow."""
        self.commands += 1
        if command.startswith("cd "):
            self.folder = self.folder / command[3:]
            return ""
        name, *arguments = shlex.split(command)
        if name == "simfoundry":  # in this process: to start Python and to import takes longer than most commands
            with contextlib.chdir(self.folder):
                done = run(*arguments, together=True)
            code, said = done.code, done.out
        else:
            shell = subprocess.run(command, shell=True, cwd=self.folder, capture_output=True, text=True, timeout=300)
            code, said = shell.returncode, shell.stdout + shell.stderr
        assert code in (0, 1) and "Traceback" not in said, said
        assert "error" in said or "fmt --diff" in command or code == 0, said
        return re.sub(r" +$", "", said, flags=re.MULTILINE)


def changed(text: str, diff: str) -> str:
    """A text after the hunks of a diff: lines that stay and ``-`` lines, then ``+`` lines."""
    for old, new in re.findall(r"((?:^[ -].*\n)+)((?:^\+.*\n)*)", diff, re.MULTILINE):
        before = re.sub(r"^[ -]", "", old, flags=re.MULTILINE)
        stays = "".join(line[1:] for line in old.splitlines(keepends=True) if line.startswith(" "))
        assert text.count(before) == 1, f"not there once:\n{before}"
        text = text.replace(before, stays + re.sub(r"^\+", "", new, flags=re.MULTILINE))
    return text


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Reader:
    """A reader at an empty folder."""
    return Reader(tmp_path_factory.mktemp("tutorial"))


@pytest.fixture(scope="module")
def followed(reader: Reader, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The page as it should be, once the reader has done all of it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SIMFOUNDRY_CACHE", str(tmp_path_factory.mktemp("cache")))
        return BLOCK.sub(reader.follow, PAGE.read_text())


def test_every_command_prints_what_the_page_shows(followed: str, reader: Reader, update_goldens: bool) -> None:
    assert reader.commands >= 15
    if update_goldens:
        PAGE.write_text(followed)
        PICTURE.write_bytes((reader.folder / "desk.png").read_bytes())
    assert followed == PAGE.read_text()


@pytest.mark.usefixtures("followed")
def test_the_picture_is_what_the_page_renders(reader: Reader) -> None:
    from PIL import Image

    made, shown = (np.asarray(Image.open(p).convert("RGB"), dtype=float) for p in (reader.folder / "desk.png", PICTURE))
    assert made.shape == shown.shape
    assert np.abs(made - shown).mean() < 0.5
    assert PICTURE.stat().st_size < 60_000


@pytest.mark.usefixtures("followed")
def test_the_reader_ends_with_documents_without_findings(reader: Reader) -> None:
    documents = sorted(reader.folder.glob("*.*.yaml"))
    assert find_project(reader.folder) == Project(reader.folder.resolve())
    assert [p.name for p in documents] == ["desk.scene.yaml", "evening.scene.yaml", "mug_on_plate.task.yaml"]
    assert [d.message for p in documents for d in load(p).all_findings()] == []


def test_a_reader_stumbles_over_what_is_not_there(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("x: 1\n")
    for wrong in ("<!-- shown in a.yaml -->\n```yaml\ny: 1\n```", "<!-- change a.yaml -->\n```diff\n-y: 1\n+y: 2\n```"):
        block = BLOCK.match(wrong)
        assert block is not None
        with pytest.raises(AssertionError):
            Reader(tmp_path).follow(block)
