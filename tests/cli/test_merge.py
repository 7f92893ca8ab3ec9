"""Merges inside real git repositories, and on the command line alone."""

from __future__ import annotations

import json
import os
import re
import shlex
import stat
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from simfoundry.cli.git import LINES, settings
from simfoundry.spec.load import load
from tests.cli.command import run
from tests.conftest import REPOSITORY

SCENE = """\
# A desk.
simfoundry: scene/1
name: desk

objects:
  desk:
    fixed: true
    shape: {box: [1.2, 0.8, 0.04]}
    pose: {xyz: [0.4, 0, -0.02]}
  cup:  # blue
    shape: {cylinder: {radius: 0.04, height: 0.1}}
    mass: 0.2
    friction: 0.5
    pose: {xyz: [0.4, 0.1, 0.05]}

relations:
  - OnTop(cup, desk)
"""
NAME = "desk.scene.yaml"
MEANING, TEXT = True, False


@dataclass(frozen=True)
class Repository:
    """A repository in a folder of its own, with one scene in it."""

    root: Path

    @property
    def file(self) -> Path:
        return self.root / NAME

    @property
    def text(self) -> str:
        return self.file.read_text()

    def git(self, *args: str, code: int = 0) -> str:
        """What git prints; it must end with ``code``."""
        done = subprocess.run(["git", *args], cwd=self.root, capture_output=True, text=True, check=False)
        assert done.returncode == code, done.stdout + done.stderr
        return done.stdout + done.stderr

    def commit(self, *replacements: tuple[str, str], branch: str | None = None) -> None:
        """Replace pieces of the scene, each there once, and commit."""
        if branch is not None:
            self.git("switch", "-q", "-c", branch)
        text = self.text
        for old, new in replacements:
            assert text.count(old) == 1, (old, text)
            text = text.replace(old, new)
        self.file.write_text(text)
        self.git("add", "-A")
        self.git("commit", "-q", "-m", "edit")

    def unmerged(self) -> bool:
        return bool(self.git("ls-files", "--unmerged"))


@pytest.fixture
def start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Repository]:
    """Makes a repository; git knows nothing of this machine, and finds this project."""
    for name in [n for n in os.environ if n.startswith("GIT_")]:
        monkeypatch.delenv(name)
    home = tmp_path / "home"
    home.mkdir()
    for name, value in {"HOME": home, "XDG_CONFIG_HOME": home / ".config", "PYTHONPATH": REPOSITORY}.items():
        monkeypatch.setenv(name, str(value))
    monkeypatch.setenv("GIT_CONFIG_NOSYSTEM", "1")
    for who in ("AUTHOR", "COMMITTER"):
        monkeypatch.setenv(f"GIT_{who}_NAME", "A")
        monkeypatch.setenv(f"GIT_{who}_EMAIL", "a@example.org")

    def start(by_meaning: bool = MEANING, text: str = SCENE) -> Repository:
        root = tmp_path / "a repository"
        root.mkdir()
        repository = Repository(root)
        repository.git("init", "-q", "-b", "main")
        repository.file.write_text(text)
        monkeypatch.chdir(root)
        if by_meaning:
            assert run("git", "install").code == 0
        repository.git("add", "-A")
        repository.git("commit", "-q", "-m", "start")
        return repository

    return start


Start = Callable[..., Repository]


def part(repository: Repository, ours: tuple[str, str], theirs: tuple[str, str]) -> None:
    """Edit the scene on ``main`` and on ``other``."""
    repository.commit(theirs, branch="other")
    repository.git("switch", "-q", "main")
    repository.commit(ours)


# -- git merge --------------------------------------------------------------------------------------------------------

LIGHTER, ROUGHER = ("mass: 0.2", "mass: 0.15  # weighed"), ("friction: 0.5", "friction: 0.7  # felt")


def test_edits_on_neighboring_lines_conflict_as_text(start: Start) -> None:
    repository = start(TEXT)
    part(repository, LIGHTER, ROUGHER)
    repository.git("merge", "other", code=1)
    assert "<<<<<<<" in repository.text and repository.unmerged()


def test_the_same_edits_merge_by_meaning(start: Start) -> None:
    repository = start(MEANING)
    part(repository, LIGHTER, ROUGHER)
    repository.git("merge", "-q", "-m", "both", "other")
    expected = SCENE.replace("mass: 0.2", "mass: 0.15     # weighed").replace(*ROUGHER)
    assert repository.text == expected
    assert run("check", NAME).code == 0


def test_a_true_conflict_is_marked_named_and_mended(start: Start) -> None:
    repository = start()
    repository.file.chmod(0o755)
    part(repository, LIGHTER, ("mass: 0.2", "mass: 0.31"))
    said = repository.git("merge", "other", code=1)
    assert f"{NAME}: 1 conflict\nobjects.cup.mass: ours 0.15, theirs 0.31 (was 0.2)\n" in said
    assert repository.unmerged()
    entry = "\nconflicts:\n  objects.cup.mass: {base: 0.2, ours: 0.15, theirs: 0.31}\n"
    assert repository.text == SCENE.replace(*LIGHTER) + entry
    assert [d.code for d in load(repository.file).errors] == ["SF209"]
    assert run("compile", NAME).code == 2
    done = run("merge", "--resolve", "theirs", NAME)
    assert (done.code, done.out, done.err) == (0, "objects.cup.mass: took theirs\n", "")
    assert repository.text == SCENE.replace("mass: 0.2", "mass: 0.31  # weighed")
    assert stat.S_IMODE(repository.file.stat().st_mode) == 0o755
    repository.git("add", NAME)
    repository.git("commit", "-q", "-m", "mended")
    assert repository.git("status", "--porcelain") == ""


@pytest.mark.parametrize("command", ["rebase", "cherry-pick"])
def test_rebase_and_cherry_pick_merge_by_meaning(start: Start, command: str) -> None:
    repository = start()
    part(repository, LIGHTER, ROUGHER)
    if command == "rebase":
        repository.git("switch", "-q", "other")
        repository.git("rebase", "-q", "main")
    else:
        repository.git("cherry-pick", "other")
    assert load(repository.file).errors == []
    assert "mass: 0.15     # weighed\n    friction: 0.7  # felt\n" in repository.text


def test_a_rebase_stops_at_a_conflict_and_goes_on(start: Start) -> None:
    repository = start()
    part(repository, LIGHTER, ("mass: 0.2", "mass: 0.31"))
    repository.git("switch", "-q", "other")
    assert "objects.cup.mass: ours 0.15, theirs 0.31 (was 0.2)" in repository.git("rebase", "main", code=1)
    assert run("merge", "--resolve", "theirs", NAME).code == 0
    repository.git("add", NAME)
    repository.git("-c", "core.editor=true", "rebase", "--continue")
    assert "mass: 0.31" in repository.text and repository.git("log", "--oneline").count("\n") == 3


def test_sides_that_do_not_fit_together_are_merged_and_left_to_mend(start: Start) -> None:
    plate = "  plate: {shape: {sphere: 0.05}, mass: 0.3}\n"
    repository = start(text=SCENE.replace("\nrelations", f"{plate}\nrelations"))
    part(repository, (plate, ""), ("OnTop(cup, desk)", "OnTop(cup, desk)\n  - NextTo(cup, plate)"))
    said = repository.git("merge", "other", code=1)
    assert re.search(r"error\[SF201\] no object is called `plate`\n +[0-9]+ \|   - NextTo\(cup, plate\)\n", said), said
    assert f"{NAME}: no conflict" in said
    assert repository.unmerged() and "NextTo(cup, plate)" in repository.text and "  plate:" not in repository.text
    assert "conflicts" not in repository.text


def test_files_that_only_the_other_side_has_are_not_missed(start: Start) -> None:
    repository = start()
    (repository.root / "fork.obj").write_text("v 0 0 0\n")
    other = ("\nrelations", "  fork: {asset: fork.obj, mass: 0.1}\n\nrelations")
    repository.git("switch", "-q", "-c", "other")
    repository.commit(other)
    repository.git("switch", "-q", "main")
    assert not (repository.root / "fork.obj").exists()
    repository.commit(LIGHTER)
    repository.git("merge", "-q", "-m", "both", "other")
    assert load(repository.file).errors == [] and "fork.obj" in repository.text


@pytest.mark.parametrize("where", ["base", "ours", "theirs"])
def test_what_is_no_yaml_is_merged_by_lines(start: Start, where: str) -> None:
    broken = SCENE.replace("name: desk", "name: [desk")
    repository = start(text=broken if where == "base" else SCENE)
    mend = ("name: [desk", "name: desk")
    breaking = ("name: desk", "name: [desk")
    ours = mend if where == "base" else breaking if where == "ours" else LIGHTER
    theirs = breaking if where == "theirs" else ("OnTop(cup, desk)", "Upright(cup)")
    part(repository, ours, theirs)
    said = repository.git("merge", "-m", "both", "other")
    assert f"{NAME}: merged line by line, because {where} could not be parsed" in said
    assert repository.text == repository.git("show", f":{NAME}")
    assert (ours[1] in repository.text) and (theirs[1] in repository.text)


def test_lines_that_conflict_have_the_markers_of_git(start: Start) -> None:
    repository = start()
    part(repository, ("name: desk", "name: [a"), ("name: desk", "name: [b"))
    repository.git("merge", "other", code=1)
    assert "<<<<<<< ours\nname: [a\n" in repository.text and "name: [b\n>>>>>>> theirs\n" in repository.text


def test_without_the_python_of_the_setting_git_merges_text(start: Start) -> None:
    repository = start()
    driver = settings()["merge.simfoundry.driver"].replace(sys.executable, "/nowhere/python")
    assert "/nowhere/python" in driver
    repository.git("config", "merge.simfoundry.driver", driver)
    part(repository, LIGHTER, ("OnTop(cup, desk)", "Upright(cup)"))
    repository.git("merge", "-q", "-m", "both", "other")
    assert LIGHTER[1] in repository.text and "Upright(cup)" in repository.text


def test_modules_of_the_repository_are_not_run(start: Start) -> None:
    repository = start()
    for name in ("yaml.py", "click.py", "simfoundry.py"):
        (repository.root / name).write_text("raise SystemExit(f'{__file__} was run')\n")
    part(repository, LIGHTER, ROUGHER)
    assert "was run" not in repository.git("merge", "-m", "both", "other")
    assert "mass: 0.15     # weighed" in repository.text


# -- git install ------------------------------------------------------------------------------------------------------


def test_installing_twice_is_the_same_as_once_and_leaves_other_lines(start: Start) -> None:
    repository = start(TEXT)
    attributes, config = repository.root / ".gitattributes", repository.root / ".git" / "config"
    before = config.read_text()
    attributes.write_bytes(b"*.png binary\r\n*.bin \xff")
    assert run("git", "status").code == 1
    first = run("git", "install")
    assert first.code == 0 and "to undo: simfoundry git install --uninstall" in first.out
    once = (attributes.read_bytes(), config.read_text())
    assert once[0] == b"*.png binary\r\n*.bin \xff\n" + "".join(f"{line}\n" for line in LINES).encode()
    assert run("git", "install").code == 0
    assert (attributes.read_bytes(), config.read_text()) == once
    status = run("git", "status", "--json")
    assert (status.code, status.json["complete"], status.json["settings"]) == (0, True, settings())
    assert run("git", "install", "--uninstall").code == 0
    assert attributes.read_bytes() == b"*.png binary\r\n*.bin \xff\n"
    assert config.read_text() == before
    assert run("git", "install", "--uninstall").code == 0 and run("git", "status").code == 1


def test_uninstalling_removes_a_file_that_held_nothing_else(start: Start) -> None:
    repository = start()
    assert run("git", "install", "--uninstall").code == 0
    assert not (repository.root / ".gitattributes").exists()


def test_every_repository_can_be_set_up_at_once(start: Start) -> None:
    repository = start(TEXT)
    assert run("git", "install", "--global").code == 0
    assert not (repository.root / ".gitattributes").exists()
    assert run("git", "status").code == 0
    part(repository, LIGHTER, ROUGHER)
    repository.git("merge", "-q", "-m", "both", "other")
    assert run("check", NAME).code == 0 and ROUGHER[1] in repository.text
    assert run("git", "install", "--global", "--uninstall").code == 0
    assert run("git", "status").code == 1


def test_git_names_the_python_that_runs_and_quotes_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/a b/100%/it's/python")
    command, driver = (settings()[f"{key}"] for key in ("diff.simfoundry.command", "merge.simfoundry.driver"))
    assert shlex.split(command)[0] == "/a b/100%/it's/python"
    assert "100%%" in driver and "100%/" not in driver


def test_outside_a_repository_and_without_git_it_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path))
    folder = tmp_path / "plain"
    folder.mkdir()
    monkeypatch.chdir(folder)
    done = run("git", "install")
    assert done.code == 2 and "this is not a git repository; create one with `git init`, or pass --global" in done.err
    assert run("git", "status").code == 1
    both = run("git", "install", "--global", "--local")
    assert both.code == 2 and "--global and --local are mutually exclusive" in both.err
    monkeypatch.setenv("PATH", str(folder))
    assert "git is not installed" in run("git", "install").err


# -- files alone ------------------------------------------------------------------------------------------------------


@pytest.fixture
def three(tmp_path: Path) -> list[Path]:
    texts = (SCENE, SCENE.replace(*LIGHTER), SCENE.replace("mass: 0.2", "mass: 0.31").replace(*ROUGHER))
    paths = [tmp_path / f"{name}.scene.yaml" for name in ("base", "ours", "theirs")]
    for path, text in zip(paths, texts, strict=True):
        path.write_text(text)
    return paths


def test_three_files_merge_to_the_screen_or_a_file(three: list[Path], tmp_path: Path) -> None:
    shown = run("merge", *three)
    assert shown.code == 1 and shown.err.startswith("objects.cup.mass: ours 0.15, theirs 0.31 (was 0.2)\n")
    out = tmp_path / "out.scene.yaml"
    written = run("merge", *three, "-o", out)
    assert (written.code, written.out) == (1, f"wrote {out}: 1 conflict\n")
    assert out.read_text() == shown.out
    report = run("merge", *three, "--json").json
    assert report["conflicts"] == [{"path": "objects.cup.mass", "base": 0.2, "ours": 0.15, "theirs": 0.31}]
    assert (report["findings"], report["text"]) == ([], shown.out)
    clean = run("merge", three[0], three[0], three[2])
    assert (clean.code, clean.out, clean.err) == (0, three[2].read_text(), "")
    left = run("merge", "--resolve", "ours", out, "--json")
    assert left.json == {"out": str(out), "decided": ["objects.cup.mass"], "left": [], "findings": []}


def test_what_cannot_be_merged_is_said_in_a_sentence(three: list[Path], tmp_path: Path) -> None:
    base, ours, theirs = three
    assert "pass three files" in run("merge", base, ours).err
    ours.write_text("a: [")
    assert "ours could not be parsed: line 2" in run("merge", *three).err
    ours.write_bytes(b"\xff")
    assert f"{ours} could not be decoded as UTF-8" in run("merge", *three).err
    assert "no conflicts are recorded in this document" in run("merge", "--resolve", "ours", theirs).err
    assert run("merge", "--resolve", "ours").code == run("merge", "--git", "a").code == 2
    assert run("merge", *three[:2], tmp_path / "absent").code == 2


def test_a_large_scene_merges_in_time(tmp_path: Path) -> None:
    objects = "".join(
        f"  thing_{k}:\n    shape: {{box: [0.1, 0.2, 0.3]}}\n    mass: {{value: 2, range: [1, 3], source: me}}\n"
        f"    pose: {{xyz: [{k}, 0, 0.15], yaw_deg: {k % 90}}}\n"
        for k in range(1000)
    )
    base = f"simfoundry: scene/1\nname: large\nobjects:\n{objects}"
    texts = (base, base.replace("yaw_deg: 7}", "yaw_deg: 8}"), base.replace("xyz: [500,", "xyz: [501,"))
    paths = [tmp_path / f"{name}.scene.yaml" for name in ("base", "ours", "theirs")]
    for path, text in zip(paths, texts, strict=True):
        path.write_text(text)
    done = run("merge", *paths, "--json")
    assert done.code == 0 and json.loads(done.out)["text"] == texts[1].replace("xyz: [500,", "xyz: [501,")


# -- the page ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow  # 4 s: it runs many commands of git
def test_the_page_does_what_it_says(start: Start) -> None:
    page = (REPOSITORY / "docs" / "git.md").read_text()
    scene = re.findall(r"^```yaml\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    repository = start(TEXT, text=scene[0])
    blocks = re.findall(r"^```(sh|text)\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    simfoundry = f'simfoundry() {{ {shlex.quote(sys.executable)} -m simfoundry.cli.main "$@"; }}\nset -e\n'
    said, compared = "", 0
    for kind, block in blocks:
        if kind == "sh":
            done = subprocess.run(
                ["bash", "-c", simfoundry + block], cwd=repository.root, capture_output=True, text=True, check=False
            )
            assert done.returncode == 0, block + done.stdout + done.stderr
            said = done.stdout + done.stderr
        else:
            compared += 1
            assert block in said or block in repository.text, f"{block}\n--\n{said}\n--\n{repository.text}"
    assert compared == 3
    assert "mass: 0.28" in repository.text and "friction: 0.4" in repository.text and "plate:" in repository.text
    assert load(repository.file).errors == [] and repository.git("status", "--porcelain") == ""
