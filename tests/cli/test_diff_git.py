"""`simfoundry diff` as the driver of `git diff` and `git show`."""

from __future__ import annotations

import pytest

from tests.cli.command import run
from tests.cli.repository import BASE, CABINET, EDITED, WORDS, Repository


def _attributes(repository: Repository) -> None:
    repository.write(".gitattributes", "*.yaml diff=simfoundry\n")
    repository.commit("attributes")


@pytest.mark.slow  # 3 s: several commands
def test_git_diff_speaks_in_the_words_of_the_scene(repository: Repository) -> None:
    _attributes(repository)
    repository.write("table.scene.yaml", EDITED)
    assert repository.git("diff", driver=True).splitlines() == ["table.scene.yaml", *(f"  {w}" for w in WORDS)]
    repository.commit("two")
    assert repository.git("show", "--ext-diff", "--format=", driver=True).splitlines()[1:] == [f"  {w}" for w in WORDS]


def test_git_diff_shows_documents_that_come_and_go(repository: Repository) -> None:
    _attributes(repository)
    repository.git("rm", "--quiet", "table.scene.yaml")
    repository.write("bowl.asset.yaml", CABINET)
    repository.git("add", "--all")
    assert repository.git("diff", "HEAD", "--no-renames", driver=True).splitlines() == [
        "bowl.asset.yaml",
        "  added: 2 links (body, drawer), 1 joint (slide)",
        "table.scene.yaml",
        "  removed: 1 material (ceramic), 4 objects (desk, cup, bowl, cabinet), 1 camera (front)",
    ]


def test_git_diff_follows_a_renamed_document(repository: Repository) -> None:
    _attributes(repository)
    repository.git("mv", "table.scene.yaml", "desk.scene.yaml")
    repository.write("desk.scene.yaml", BASE.replace("[0.3, 0.1, 0.05]", "[0.33, 0.1, 0.05]"))
    repository.git("add", "--all")
    assert repository.git("diff", "HEAD", "-M", driver=True).splitlines() == [
        "table.scene.yaml renamed to desk.scene.yaml",
        "  cup moved 3.0 cm (+x 3.0)",
        "  1 moved",
    ]


@pytest.mark.parametrize("broken", ["objects: [", "\t", "simfoundry: scene/9\n", "a: &x [*x]\n"])
def test_git_diff_falls_back_to_plain_text(repository: Repository, broken: str) -> None:
    _attributes(repository)
    repository.write("table.scene.yaml", broken)
    out = repository.git("diff", driver=True)
    assert out.startswith("diff --git a/table.scene.yaml b/table.scene.yaml\n--- a/table.scene.yaml\n")
    assert "-name: table\n" in out and f"+{broken.splitlines()[0]}\n".expandtabs(1) in out.replace("\\t", " ")
    assert repository.git("diff", driver=True) == out


def test_git_diff_of_a_link(repository: Repository) -> None:
    """A document that became a link, to nowhere at that: git shows one removed and one added."""
    _attributes(repository)
    (repository.folder / "table.scene.yaml").unlink()
    (repository.folder / "table.scene.yaml").symlink_to("nowhere.scene.yaml")
    out = repository.git("diff", driver=True)
    assert "  removed: 1 material (ceramic)" in out and "\n+nowhere.scene.yaml\n" in out


def test_git_diff_of_a_merge_conflict(repository: Repository) -> None:
    _attributes(repository)
    assert run("diff", "--git", "table.scene.yaml").out == "* unmerged: table.scene.yaml\n"
