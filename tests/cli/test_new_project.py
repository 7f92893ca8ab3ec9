"""``simfoundry new`` and ``cousins`` in folders that are no project yet: without git, without a marker."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.cousins.recipe.document import claim_project, read_recipe
from simfoundry.spec import project
from simfoundry.spec.load import load
from simfoundry.spec.project import MARKER, NoProjectError, common_project, find_project, markers
from tests.cli.command import run


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder in no project."""
    assert find_project(tmp_path) is None
    folder = tmp_path / "kitchen"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


def test_the_first_document_marks_the_working_folder(folder: Path) -> None:
    done = run("new", "scenes/desk.scene.yaml")
    assert f"wrote {MARKER}, which marks the root of the project" in done.out
    assert (folder / MARKER).is_file() and (folder / ".simfoundry").is_dir()
    assert not (folder / "scenes" / MARKER).exists()
    assert "wrote simfoundry.yaml" not in run("new", "scenes/other.scene.yaml").out


def test_a_task_of_a_scene_in_another_folder_is_valid_in_any_folder(folder: Path) -> None:
    run("new", "scenes/desk.scene.yaml")
    (folder / MARKER).unlink()  # as where somebody wrote the scene by hand
    (folder / "scenes" / "far").mkdir()
    for name, source in (("tasks/stack", "scenes/desk.scene.yaml"), ("scenes/far/stack", "scenes/desk.scene.yaml")):
        assert run("new", "task", name, "--from", source).code == 0
        assert load(Path(f"{name}.task.yaml")).all_findings() == []
    assert run("new", "cousins", "recipes/some", "--from", "tasks/stack.task.yaml").code == 0
    assert run("new", "night/desk.scene.yaml", "--extends", "scenes/desk.scene.yaml").code == 0
    assert run("check").out == "no findings in 5 documents\n"


def test_away_from_the_working_folder_the_closest_common_one_is_marked(tmp_path: Path) -> None:
    away = tmp_path / "away"
    run("new", away / "scenes" / "desk.scene.yaml")
    assert (away / "scenes" / MARKER).is_file()
    done = run("new", "task", away / "tasks" / "stack", "--from", away / "scenes" / "desk.scene.yaml")
    assert done.code == 2 and not (away / "tasks").exists()
    assert f"belongs to the project {away / 'scenes'}, which does not contain" in done.err
    assert f"move all files into {away / 'scenes'}, or its {MARKER} to {away}" in done.err
    (away / "scenes" / MARKER).rename(away / MARKER)  # what it says
    assert run("new", "task", away / "tasks" / "stack", "--from", away / "scenes" / "desk.scene.yaml").code == 0
    assert load(away / "tasks" / "stack.task.yaml").all_findings() == []


def test_what_belongs_to_everybody_is_not_marked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "home"
    (home / "me").mkdir(parents=True)
    monkeypatch.setattr(Path, "home", lambda: home / "me")
    monkeypatch.setattr(project, "gettempdir", lambda: str(tmp_path / "tmp"))
    monkeypatch.chdir(home / "me")
    assert run("new", "desk.scene.yaml").code == 0 and not (home / "me" / MARKER).exists()
    assert load(Path("desk.scene.yaml")).all_findings() == []
    assert run("new", "a/desk.scene.yaml").code == 0 and (home / "me" / "a" / MARKER).is_file()
    with pytest.raises(NoProjectError, match="which also contains unrelated files; move them into a separate folder"):
        common_project(Path("b/x.scene.yaml"), Path("c/y.task.yaml"))
    assert markers(common_project(Path("/x.scene.yaml"))) == {}


def test_a_file_outside_of_no_project_says_what_to_mark(folder: Path) -> None:
    run("new", "scenes/desk.scene.yaml")
    (folder / MARKER).unlink()
    (folder / "tasks").mkdir()
    (folder / "tasks" / "a.task.yaml").write_text(
        "simfoundry: task/1\nname: a\nscene: ../scenes/desk.scene.yaml\ninstruction: Lift it.\ngoal: Lifted(mug)\n"
    )
    done = run("check", "tasks")
    assert done.code == 1 and f"or create an empty `{MARKER}` in {folder}" in done.err
    (folder / MARKER).touch()
    assert "SF204" not in run("check", "tasks").err


def test_cousins_claim_the_folder_that_holds_their_recipe_and_themselves(folder: Path) -> None:
    run("new", "desk.scene.yaml")
    run("new", "cousins", "recipes/desks", "--from", "desk.scene.yaml")
    (folder / MARKER).rename(folder / "recipes" / MARKER)
    assert "belongs to the project" in run("new", "task", "a", "--from", "recipes/desks.cousins.yaml").err
    (folder / "recipes" / MARKER).unlink()
    run("new", "cousins", "desks", "--from", "desk.scene.yaml")
    (folder / MARKER).unlink()
    recipe = read_recipe(Path("desks.cousins.yaml"))
    out = folder / "build" / "desks"
    assert claim_project(recipe, out) == folder / MARKER and claim_project(recipe, out) is None
    assert find_project(out) == find_project(folder) == common_project(folder / MARKER)
    (out / "one.scene.yaml").parent.mkdir(parents=True)
    (out / "one.scene.yaml").write_text("simfoundry: scene/1\nname: one\nextends: ../../desk.scene.yaml\n")
    assert load(out / "one.scene.yaml").errors == []
