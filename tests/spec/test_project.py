"""Where a project starts, and what its marker excludes."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.project import Project, find_project, project_root
from tests.cli.command import run
from tests.conftest import REPOSITORY

TEXT = "simfoundry: scene/1\nname: good\nobjects: {cup: {shape: {sphere: 0.04}, mass: 0.2}}\n"


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project with a document in each of its folders."""
    for folder in ("a/bad", "a/good", "b/c/bad"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "x.scene.yaml").write_text(TEXT)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_marker_comes_before_a_repository(tmp_path: Path) -> None:
    inner = tmp_path / "outer" / "inner"
    (inner / ".git").mkdir(parents=True)
    assert find_project(inner / "x.scene.yaml") == Project(inner)
    (tmp_path / "outer" / "simfoundry.yaml").touch()
    assert find_project(inner / "x.scene.yaml") == find_project(inner) == Project(tmp_path / "outer")
    assert project_root(inner / "x.scene.yaml") == tmp_path / "outer"
    assert find_project(tmp_path) is None
    assert project_root(tmp_path / "x.scene.yaml") == tmp_path


@pytest.mark.parametrize(
    ("exclude", "left"),
    [
        ("[]", ["a/bad", "a/good", "b/c/bad"]),
        ("[a/bad]", ["a/good", "b/c/bad"]),
        ("[./a/bad/]", ["a/good", "b/c/bad"]),
        ("[bad]", ["a/bad", "a/good", "b/c/bad"]),
        ("['**/bad']", ["a/good"]),
        ("['*/good', b]", ["a/bad"]),
        ("['a/*/x.*']", ["b/c/bad"]),
        ("['', .]", ["a/bad", "a/good", "b/c/bad"]),
    ],
)
def test_what_is_excluded_is_passed_over(tree: Path, exclude: str, left: list[str]) -> None:
    (tree / "simfoundry.yaml").write_text(f"exclude: {exclude}\n")
    found = run("check", "--json").json["files"]
    assert found == [f"{folder}/x.scene.yaml" for folder in left]
    assert f"{len(left)} document" in run("fmt", "--check").out


def test_what_is_named_is_checked(tree: Path) -> None:
    (tree / "simfoundry.yaml").write_text("exclude: [a, '**/bad']\n")
    assert run("check", "--json", "a/good").json["files"] == ["a/good/x.scene.yaml"]
    assert run("check", "--json", "a/bad").json["files"] == ["a/bad/x.scene.yaml"]
    assert run("check", "--json", "a/bad/x.scene.yaml").json["files"] == ["a/bad/x.scene.yaml"]
    done = run("check")
    assert done.code == 2
    assert "could not find any documents below . except 3 excluded by simfoundry.yaml" in done.err


def test_a_project_inside_another_excludes_its_own(tree: Path) -> None:
    (tree / "a" / "simfoundry.yaml").write_text("exclude: [bad]\n")
    assert run("check", "--json").json["files"] == ["a/good/x.scene.yaml", "b/c/bad/x.scene.yaml"]


@pytest.mark.parametrize(
    ("text", "finding"),
    [
        ("exclud: [a]\n", "simfoundry.yaml:1:1: error[SF101] unknown key `exclud`"),
        ("exclude: a\n", "simfoundry.yaml:1:10: error[SF103] expected a list, found the string `a`"),
        ("exclude: [a\n", "simfoundry.yaml:1:10: error[SF002]"),
        ("- a\n", "simfoundry.yaml:1:1: error[SF103] expected a mapping"),
    ],
)
def test_a_wrong_marker_is_a_finding(tree: Path, text: str, finding: str) -> None:
    (tree / "simfoundry.yaml").write_text(text)
    done = run("check")
    assert done.code == 2
    assert finding in done.err, done.err
    with pytest.raises(SpecError):
        _ = Project(tree).exclude


def test_a_clone_of_this_repository_has_no_findings_by_its_folders() -> None:
    """The documents with mistakes belong to the tests."""
    project = find_project(REPOSITORY / "specs")
    assert project is not None
    assert project.excludes(REPOSITORY / "tests/spec/bad/SF101_unknown_key.scene.yaml", REPOSITORY)


def test_links_that_form_a_ring_are_findings(tree: Path) -> None:
    (tree / "ring.scene.yaml").symlink_to("back.scene.yaml")
    (tree / "back.scene.yaml").symlink_to("ring.scene.yaml")
    (tree / "round").symlink_to("round")
    (tree / "self").symlink_to(".")
    (tree / "gone.scene.yaml").symlink_to("nothing.scene.yaml")
    done = run("check", ".")
    for name in ("ring", "back"):
        assert (
            f"{name}.scene.yaml: error[SF001] the file could not be read: its symbolic links form a cycle" in done.err
        )
    assert "gone.scene.yaml: error[SF001] the file could not be read: No such file or directory" in done.err
    assert done.out == "3 errors in 3 of 6 documents\n"
    assert "error[SF001]" in run("check", "ring.scene.yaml").err
