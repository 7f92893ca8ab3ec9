"""One commit moves the base's mug and pins the overlay's: what `diff A..B`, `log` and `git show` say of it.

The pinned mug stays where it was, so of the overlay nothing may be said to move. All with real git, whose driver is set
by `simfoundry git install`.
"""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import pytest

from tests.cli.command import run
from tests.cli.repository import BASE, CABINET, OVERLAY, Repository

TABLE = BASE.replace("cup", "mug")
MOVED = TABLE.replace("[0.3, 0.1, 0.05]", "[0.33, 0.1, 0.05]")
FREE = OVERLAY.replace("cup", "mug")
PINNED = FREE.replace("0.7}", "0.7, pose: {xyz: [0.3, 0.1, 0.05]}}")
TASK = "simfoundry: task/1\nname: lift\nscene: moved.scene.yaml\ninstruction: Lift the mug.\ngoal: Lifted(mug)\n"

MOVES = ["mug moved 3.0 cm (+x 3.0)", "1 moved"]
SAME = ["equivalent, written differently"]
PLACED = ["added: 1 material (ceramic), 4 objects (desk, mug, bowl, cabinet), 1 camera (front)"]
ALONE = "(only this file's own keys are compared, because git does not report the revision of table.scene.yaml;"


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Repository:
    """A base and an overlay whose mug is where the base's is, and the driver of this installation."""
    folder = tmp_path / "repository"
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.setenv("GIT_CONFIG_GLOBAL", os.devnull)
    made = Repository(folder)
    made.write("table.scene.yaml", TABLE)
    made.write("moved.scene.yaml", FREE)
    assert run("git", "install").code == 0
    made.commit("two")
    return made


def commit(repository: Repository, message: str, **texts: str) -> None:
    for name, text in texts.items():
        repository.write(f"{name}.scene.yaml", text)
    repository.commit(message)


def shown(repository: Repository, *args: str) -> dict[str, list[str]]:
    """What `git show` says of each document."""
    return by_document(repository.git("show", "--ext-diff", "--format=", *(args or ("HEAD",))))


def compared(*args: str) -> dict[str, list[str]]:
    """What `simfoundry diff` says of each document."""
    documents = run("diff", "--format", "json", *args).json["documents"]
    text = run("diff", *args)
    assert "Traceback" not in text.out + text.err
    if len(documents) != 1:
        return by_document(text.out)
    return {documents[0]["name"]: text.out.splitlines()}


def by_document(text: str) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for line in text.splitlines():
        if line.startswith("  "):
            found[next(reversed(found))].append(line[2:])
        elif line:
            found[line] = []
    return found


def told(*args: str) -> list[tuple[str, list[str]]]:
    """Each commit that `simfoundry log` lists, by its subject, with what it says of it."""
    done = run("log", *args)
    assert (done.code, done.err) == (0, "")
    found: list[tuple[str, list[str]]] = []
    for line in done.out.splitlines():
        if line.startswith("  "):
            found[-1][1].append(line[2:])
        else:
            found.append((line.partition("t@example.org: ")[2] or line, []))
    return found


def names(entries: list[tuple[str, list[str]]]) -> list[str]:
    return [subject for subject, _ in entries]


# -- what the commit touches ----------------------------------------------------------------------------------------


@pytest.mark.slow  # 2 s: several commands
def test_both_files_in_one_commit(repository: Repository) -> None:
    commit(repository, "pin", table=MOVED, moved=PINNED)
    assert compared("HEAD~1..HEAD") == shown(repository) == {"moved.scene.yaml": SAME, "table.scene.yaml": MOVES}
    assert told("table.scene.yaml")[0] == ("pin", MOVES)
    assert names(told("moved.scene.yaml")) == ["two", "one"], "nothing in the overlay's scene changed"
    assert told("-v", "moved.scene.yaml")[0] == ("pin", SAME)
    assert run("diff", "--format", "json", "HEAD~1..HEAD", "moved.scene.yaml").json["documents"][0]["changes"] == []


def test_the_base_only(repository: Repository) -> None:
    commit(repository, "base", table=MOVED)
    assert compared("HEAD~1..HEAD") == shown(repository) == {"table.scene.yaml": MOVES}
    assert told("moved.scene.yaml")[0] == ("base", MOVES), "its mug moved as well"
    assert compared("HEAD~1..HEAD", "moved.scene.yaml") == {"moved.scene.yaml": MOVES}


@pytest.mark.slow  # 2 s: several commands
def test_the_overlay_only(repository: Repository) -> None:
    commit(repository, "pin", moved=PINNED)
    assert compared("HEAD~1..HEAD") == shown(repository) == {"moved.scene.yaml": SAME}
    commit(repository, "base", table=MOVED)
    assert names(told("moved.scene.yaml")) == ["two", "one"], "a pinned mug does not move with the base's"
    assert shown(repository, "HEAD~1")["moved.scene.yaml"][1:2] == [ALONE], "its blob lay beside two bases"


def test_the_mug_is_let_go_again(repository: Repository) -> None:
    commit(repository, "pin", table=MOVED, moved=PINNED)
    commit(repository, "let go", moved=FREE)
    assert compared("HEAD~1..HEAD") == {"moved.scene.yaml": MOVES}
    assert told("moved.scene.yaml")[0] == ("let go", MOVES)
    (said,) = shown(repository).values()
    assert ALONE in said, "the same blob lay beside the old base, so git's driver does not know which one is meant"
    assert "mug moved" not in "\n".join(said)


@pytest.mark.slow  # 2 s: several commands
def test_the_base_is_renamed_in_the_same_commit(repository: Repository) -> None:
    repository.git("mv", "table.scene.yaml", "desk.scene.yaml")
    commit(repository, "rename", desk=MOVED, moved=PINNED.replace("table.scene", "desk.scene"))
    renamed = ["extends table.scene.yaml → desk.scene.yaml", "extends changed"]
    base = "desk.scene.yaml (renamed from table.scene.yaml)"
    assert compared("HEAD~1..HEAD") == {base: MOVES, "moved.scene.yaml": renamed}
    assert shown(repository) == {
        "table.scene.yaml renamed to desk.scene.yaml": MOVES,
        "moved.scene.yaml": renamed,
    }
    assert told("moved.scene.yaml")[0] == ("rename", renamed)
    assert told("desk.scene.yaml")[0] == ("rename", MOVES)
    assert names(told("desk.scene.yaml"))[-1] == "one"


def test_a_file_that_an_object_refers_to(repository: Repository) -> None:
    """The asset of an object of the base, and a mesh, are of the revision as well."""
    repository.write("parts/cabinet.asset.yaml", CABINET.replace("mass: 1", "mass: 1.5"))
    repository.commit("drawer")
    assert told("moved.scene.yaml")[0] == (
        "drawer",
        ["cabinet: parts/cabinet.asset.yaml changed (1 changed)", "1 changed"],
    )
    mesh = "  ball: {asset: ball.glb, mass: 1, pose: {xyz: [1, 0, 1]}}\ncameras:"
    repository.write("ball.glb", "one")
    commit(repository, "ball", table=TABLE.replace("cameras:", mesh))
    repository.write("ball.glb", "two")
    repository.commit("mesh")
    assert told("moved.scene.yaml")[0] == ("mesh", ["ball: ball.glb is a different file", "1 changed"])


def test_the_scene_of_a_task(repository: Repository) -> None:
    repository.write("lift.task.yaml", TASK)
    repository.commit("task")
    commit(repository, "base", table=MOVED)
    commit(repository, "pin", table=TABLE, moved=PINNED.replace("0.3, 0.1", "0.33, 0.1"))
    assert told("lift.task.yaml")[:2] == [
        ("base", ["scene moved.scene.yaml changed (1 moved)", "scene changed"]),
        ("task", ["added: no named members"]),
    ]
    repository.git("revert", "--no-edit", "--quiet", "HEAD")
    assert compared("HEAD~3", "lift.task.yaml") == {
        "lift.task.yaml": ["scene moved.scene.yaml changed (1 moved)", "scene changed"]
    }


def test_links_are_followed_inside_a_commit(repository: Repository) -> None:
    """To the document, to a base, and never out of the repository."""
    link = repository.folder / "link.scene.yaml"
    link.symlink_to("table.scene.yaml")
    repository.write("over.scene.yaml", FREE.replace("table.scene", "link.scene"))
    (repository.folder / "outside.scene.yaml").symlink_to("../../etc/passwd")
    (repository.folder / "nowhere.scene.yaml").symlink_to("nowhere/else.scene.yaml")
    (repository.folder / "loop.scene.yaml").symlink_to("loop.scene.yaml")
    repository.commit("links")
    commit(repository, "base", table=MOVED)
    assert run("diff", "HEAD~1..HEAD", "link.scene.yaml").out.splitlines() == MOVES
    assert run("diff", "HEAD~1..HEAD", "over.scene.yaml").out.splitlines() == MOVES
    assert told("link.scene.yaml")[0][0] != "uncommitted changes"
    for name in ("outside", "nowhere", "loop"):
        done = run("diff", "HEAD~1..HEAD", f"{name}.scene.yaml")
        assert done.code == 2 and "there is no document" in done.err


# -- where it is asked ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cwd", ["scenes/today", "scenes", "parts"])
@pytest.mark.slow  # 8 s
def test_from_a_folder_that_the_base_is_not_in(
    repository: Repository, monkeypatch: pytest.MonkeyPatch, cwd: str
) -> None:
    path = "scenes/today/moved.scene.yaml"
    repository.write(path, FREE.replace("table.scene", "../../table.scene"))
    repository.commit("three")
    repository.write(path, PINNED.replace("table.scene", "../../table.scene"))
    commit(repository, "pin", table=MOVED)
    monkeypatch.chdir(cwd)
    file = os.path.relpath(repository.folder / path)
    assert compared("HEAD~1..HEAD") == shown(repository) == {path: SAME, "table.scene.yaml": MOVES}
    assert compared("HEAD~1..HEAD", file) == {file: SAME}
    assert names(told(file)) == ["three"]
    assert told(os.path.relpath(repository.folder / "table.scene.yaml"))[0] == ("pin", MOVES)
    before, after = (f"{revision}:./{file}" for revision in ("HEAD~1", "HEAD"))
    assert run("diff", before, after).out.splitlines() == SAME
    assert run("diff", f"HEAD~1:{path}", f"HEAD:{path}").out.splitlines() == SAME


def test_a_base_outside_the_repository_is_not_guessed(repository: Repository) -> None:
    """Git knows nothing of it, so no revision can be complete; the file beside the repository is not of then."""
    (repository.folder.parent / "shared.scene.yaml").write_text(TABLE)
    outside = FREE.replace("table.scene", "../shared.scene")
    commit(repository, "outside", moved=outside)
    commit(repository, "faster", moved=outside.replace("0.7", "0.9"))
    done = run("diff", "HEAD~1..HEAD")
    assert done.code == 2 and "`../shared.scene.yaml` is outside the project" in done.err
    assert "moved" not in done.out.replace("moved.scene.yaml", "")
    subject, lines = told("moved.scene.yaml")[0]
    assert subject == "faster" and lines[0].startswith("cannot be compared: no part of")
    assert lines[1].endswith("`../shared.scene.yaml` is outside the project")
    text = repository.git("show", "--ext-diff", "--format=")
    assert "\n-objects: {mug: {friction: 0.7}}\n+objects: {mug: {friction: 0.9}}\n" in text, "plain text says no more"


def test_a_worktree_has_its_own_head(repository: Repository, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    repository.git("worktree", "add", "--quiet", "-b", "side", str(tmp_path / "side"))
    commit(repository, "main moves on", table=MOVED)
    monkeypatch.chdir(tmp_path / "side")
    side = tmp_path / "side" / "moved.scene.yaml"
    side.write_text(PINNED)
    (tmp_path / "side" / "table.scene.yaml").write_text(MOVED)
    assert names(told("moved.scene.yaml")) == ["two", "one"]
    assert told("table.scene.yaml")[0] == ("uncommitted changes", MOVES)
    monkeypatch.chdir(repository.folder)
    assert names(told(str(side))) == ["two", "one"]
    assert names(told("moved.scene.yaml")) == ["main moves on", "two", "one"]


def test_a_shallow_clone_says_what_it_lacks(
    repository: Repository, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    commit(repository, "pin", table=MOVED, moved=PINNED)
    commit(repository, "faster", moved=PINNED.replace("0.7", "0.9"))
    clone = tmp_path / "clone"
    url = repository.folder.as_uri()
    subprocess.run(["git", "clone", "--quiet", "--depth", "2", url, clone], check=True, capture_output=True)
    monkeypatch.chdir(clone)
    shallow = "what this commit changed is unknown, because the clone is shallow (`git fetch --unshallow` completes it)"
    assert told("moved.scene.yaml") == [
        ("faster", ["mug: friction 0.7 → 0.9", "1 changed"]),
        ("pin", [shallow, PLACED[0].replace("added:", "it contains")]),
    ]
    assert compared("HEAD~1..HEAD") == {"moved.scene.yaml": ["mug: friction 0.7 → 0.9", "1 changed"]}
    done = run("diff", "HEAD~2..HEAD")
    assert done.code == 2 and "the clone is shallow, and `git fetch --unshallow` gets the commits" in done.err


# -- merges ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow  # 2 s
def test_a_merge_that_brings_both_together(repository: Repository) -> None:
    """One side moves the base's mug, the other pins the overlay's: in the merge, the overlay's is where it was."""
    repository.git("switch", "--quiet", "-c", "side")
    commit(repository, "side: base", table=MOVED)
    repository.git("switch", "--quiet", "main")
    commit(repository, "main: pin", moved=PINNED)
    repository.git("merge", "--quiet", "-m", "joined", "side")
    assert compared("HEAD~1..HEAD") == {"table.scene.yaml": MOVES}
    assert compared("HEAD~1..HEAD", "moved.scene.yaml") == {"moved.scene.yaml": ["no difference"]}
    assert told("main~1", "moved.scene.yaml")[0][0] == "two"
    assert dict(told("moved.scene.yaml"))["side: base"] == MOVES, "on that side it did move"
    assert "joined" not in names(told("moved.scene.yaml")), "it is as on the main side"
    assert shown(repository, "--first-parent", "HEAD") == {"table.scene.yaml": MOVES}


def test_an_open_conflict_is_said_and_the_history_goes_on(repository: Repository) -> None:
    for key in list(repository.git("config", "--name-only", "--get-regexp", r"^merge\.").split()):
        repository.git("config", "--unset", key)  # else there would be no markers
    repository.git("switch", "--quiet", "-c", "side")
    commit(repository, "pin", table=MOVED, moved=PINNED)
    repository.git("switch", "--quiet", "main")
    commit(repository, "faster", moved=FREE.replace("0.7", "0.9"))
    with pytest.raises(AssertionError):
        repository.git("merge", "side")
    first, second, *_ = told("moved.scene.yaml")
    assert first[0] == "uncommitted changes" and first[1][0].startswith("cannot be compared: no part of")
    assert first[1][1] == "  moved.scene.yaml:4:1: unresolved git conflict"
    assert second == ("faster", ["mug: friction 0.7 → 0.9", "1 changed"])
    done = run("diff")
    assert done.code == 2 and "unresolved git conflict" in done.err
    assert by_document(done.out)["table.scene.yaml"] == MOVES


# -- what cannot be read --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("broken", ["table", "moved"])
def test_a_broken_revision_is_said_and_the_history_goes_on(repository: Repository, broken: str) -> None:
    commit(repository, "broken", **{broken: "objects: [\n"})
    commit(repository, "more broken", **{broken: "objects: {\n"})
    commit(repository, "pin", table=MOVED, moved=PINNED.replace("0.7", "0.9"))
    last, more, first, *others = told("moved.scene.yaml")
    two = repository.git("rev-parse", "HEAD~3")[:10]
    note = f"valid again; the last valid version is that of {two}:"
    assert last == ("pin", [note, "mug: friction 0.7 → 0.9", "1 changed"])
    for name, lines in (more, first):
        assert name in ("broken", "more broken") and lines[0].startswith("cannot be compared: no part of ")
        assert lines[-1].endswith(f":{broken}.scene.yaml:2:1: expected a value") or "expected" in lines[-1]
    assert names(others) == ["two", "one"]
    found = run("log", "--json", "moved.scene.yaml").json["commits"]
    assert found[0]["note"] == note and found[1]["obstacle"] and found[1]["findings"][0]["line"] == 2
    assert json.dumps(found)


def test_a_document_that_was_never_valid(repository: Repository) -> None:
    commit(repository, "draft", new="objects: [\n")
    commit(repository, "done", new=TABLE)
    assert told("new.scene.yaml")[0] == (
        "done",
        ["valid for the first time", PLACED[0].replace("added:", "it contains")],
    )


# -- what is not committed ------------------------------------------------------------------------------------------


def test_what_is_not_committed_comes_first(repository: Repository) -> None:
    commit(repository, "faster", moved=FREE.replace("0.7", "0.9"))
    assert names(told("-n", "1", "moved.scene.yaml")) == ["faster"]
    repository.write("table.scene.yaml", MOVED)
    assert told("-n", "1", "moved.scene.yaml") == [
        ("uncommitted changes", MOVES),
        ("faster", ["mug: friction 0.7 → 0.9", "1 changed"]),
    ]
    repository.git("add", "--all")
    assert names(told("moved.scene.yaml"))[0] == "uncommitted changes"
    assert names(told("HEAD", "moved.scene.yaml"))[0] == "faster", "of a revision that is named, only commits"
    first, second, *_ = run("log", "--json", "moved.scene.yaml").json["commits"]
    assert (first["commit"], first["subject"], first["entries"][0]["marks"]) == (None, "uncommitted changes", ["moved"])
    assert second["subject"] == "faster"
    repository.write("moved.scene.yaml", PINNED.replace("0.7", "0.9"))
    assert names(told("moved.scene.yaml"))[0] == "faster", "the pinned mug stays"


def test_what_is_renamed_removed_or_new_and_not_committed(repository: Repository) -> None:
    repository.git("mv", "moved.scene.yaml", "pinned.scene.yaml")
    assert names(told("pinned.scene.yaml")) == ["two", "one"]
    repository.write("pinned.scene.yaml", FREE.replace("0.7", "0.9"))
    assert told("pinned.scene.yaml")[0] == ("uncommitted changes", ["mug: friction 0.7 → 0.9", "1 changed"])
    assert names(told("pinned.scene.yaml"))[1:] == ["two", "one"]
    assert told("moved.scene.yaml")[0] == ("uncommitted changes", [PLACED[0].replace("added", "removed")])
    repository.write("new.scene.yaml", TABLE)
    assert told("new.scene.yaml") == [("uncommitted changes", PLACED)]


def test_a_repository_without_commits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    subprocess.run(["git", "init", "--quiet"], check=True)
    (tmp_path / "table.scene.yaml").write_text(TABLE.replace("parts/cabinet.asset.yaml", "cabinet.asset.yaml"))
    (tmp_path / "cabinet.asset.yaml").write_text(CABINET)
    assert told("table.scene.yaml") == [("uncommitted changes", PLACED)]


@pytest.mark.slow  # 2 s
def test_included_scenes_are_bases(repository: Repository) -> None:
    cell = "simfoundry: scene/1\nname: cell\ninclude: {left: {scene: table.scene.yaml, pose: {xyz: [0, 1, 0]}}}\n"
    commit(repository, "cell", cell=cell)
    wider = cell.replace("[0, 1, 0]", "[0, 2, 0]")
    commit(repository, "wider", cell=wider, table=MOVED)
    both = ["include left moved 1.000 m (+y 1.000)", "left_mug moved 3.0 cm (+x 3.0)", "2 moved"]
    assert (
        shown(repository)["cell.scene.yaml"] == compared("HEAD~1..HEAD", "cell.scene.yaml")["cell.scene.yaml"] == both
    )
    assert dict(told("cell.scene.yaml"))["wider"] == both
    commit(repository, "back", table=TABLE)
    commit(repository, "again", table=MOVED.replace("0.33", "0.36"))
    assert (
        ALONE in shown(repository, "HEAD~2")["cell.scene.yaml"]
        or shown(repository, "HEAD~2")["cell.scene.yaml"] == both
    )
