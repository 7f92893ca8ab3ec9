"""``simfoundry rename``: what it writes, shows and refuses."""

from __future__ import annotations

import os
import shlex
from pathlib import Path

import pytest

from tests.cli.command import run
from tests.conftest import REPOSITORY
from tests.docs.test_pages import blocks
from tests.spec.names.projects import FILES, write_project


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return write_project(tmp_path)


def _texts(project: Path) -> dict[str, str]:
    return {path.name: path.read_bytes().decode() for path in project.iterdir()}


def test_a_dry_run_shows_the_changes_and_writes_nothing(project: Path) -> None:
    done = run("rename", "desk.scene.yaml", "lamp", "sun", "--dry-run")
    assert done.code == 0
    changed = (
        "-  lamp: {type: point, xyz: [0, 0, 1], frame: corner}\n+  sun: {type: point, xyz: [0, 0, 1], frame: corner}\n"
    )
    assert changed in done.out
    assert done.out.endswith("would rename light `lamp` to `sun`: 2 places in 2 documents\n")
    assert _texts(project) == FILES


def test_a_rename_and_its_reverse_give_the_same_bytes(project: Path) -> None:
    (project / "evening.scene.yaml").write_bytes(FILES["evening.scene.yaml"].replace("\n", "\r\n").encode("utf-8-sig"))
    (project / "evening.scene.yaml").chmod(0o600)
    before = _texts(project)
    done = run("rename", "evening.scene.yaml", "mug", "beaker")
    assert done.out.startswith("renamed object `mug` to `beaker`: 23 places in 7 documents\n  desk.scene.yaml: 7\n")
    assert "note: these lines still contain the word `mug`:\n" in done.out
    assert run("check", "--no-lints", ".").out == "no findings in 10 documents\n"
    assert (project / "evening.scene.yaml").stat().st_mode & 0o777 == 0o600
    assert sorted(_texts(project)) == sorted(before)  # no temporary file is left
    assert run("rename", "lift.task.yaml", "beaker", "mug").code == 0
    assert _texts(project) == before


@pytest.mark.usefixtures("project")
def test_json_lists_places_diffs_and_notes() -> None:
    data = run("rename", "pi.policy.yaml", "portrait", "face", "--json", "--dry-run").json
    assert (data["kind"], data["old"], data["new"], data["written"]) == ("camera", "portrait", "face", False)
    assert data["files"]["pi.policy.yaml"] == [{"line": 8, "column": 31, "start": 150, "end": 158}]
    assert set(data["diffs"]) == {"desk.scene.yaml", "pi.policy.yaml"}
    assert data["notes"] == []


def test_all_reasons_are_in_one_message_and_nothing_is_written(project: Path) -> None:
    done = run("rename", "desk.scene.yaml", "mug", "bowl")
    assert done.code == 2
    assert done.err == (
        "Error: cannot rename object `mug` to `bowl`:\n"
        "  desk.scene.yaml:24:3: `bowl` already exists beside it\n"
        "  desk.scene.yaml:30:3: `bowl` already means object `bowl`\n"
        "  vary.cousins.yaml:7:13: `bowl` already exists beside it\n"
    )
    assert _texts(project) == FILES


def test_what_is_ambiguous_or_unknown_is_said(project: Path) -> None:
    text = FILES["desk.scene.yaml"].replace("vessel", "mug").replace("Upright", "Upright")
    (project / "desk.scene.yaml").write_text(text)
    done = run("rename", "desk.scene.yaml", "mug", "zz")
    assert done.code == 2
    assert "several things have this name; add `--kind`" in done.err and "template `mug`" in done.err
    assert run("rename", "desk.scene.yaml", "mug", "zz", "--kind", "template").code == 0
    assert "nothing has this name" in run("rename", "desk.scene.yaml", "nobody", "zz").err
    assert run("rename", "absent.scene.yaml", "mug", "zz").code == 2
    assert "Traceback" not in run("rename", ".", "mug", "zz").err


def test_a_read_only_folder_changes_nothing(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real, count = os.replace, iter(range(100))

    def failing(source: str, target: str) -> None:
        if next(count) == 3:
            raise OSError(28, "No space left on device", str(target))
        real(source, target)

    monkeypatch.setattr("simfoundry.runtime.files.os.replace", failing)
    done = run("rename", "desk.scene.yaml", "mug", "beaker")
    assert done.code == 2 and "No space left" in done.err
    assert _texts(project) == FILES


def test_the_page_about_editors_shows_a_rename(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    page = list(blocks(REPOSITORY / "docs/editors.md"))
    here = next(k for k, block in enumerate(page) if block.note == "run in: tests/cli/test_rename.py")
    scene, command, output = (block.text for block in page[here - 1 : here + 2])
    overlay = "simfoundry: scene/1\nextends: desk.scene.yaml\nname: evening\nobjects: {mug: {mass: 0.4}}\n"
    task = "simfoundry: task/1\nname: lift\nscene: desk.scene.yaml\ninstruction: Lift the mug.\ngoal: Lifted(mug)\n"
    for name, text in (("desk.scene", scene), ("evening.scene", overlay), ("lift.task", task)):
        (tmp_path / f"{name}.yaml").write_text(text)
    (tmp_path / "simfoundry.yaml").touch()
    program, *arguments = shlex.split(command)
    assert program == "simfoundry" and run(*arguments).out == output
