"""History by meaning: what `git show` may say of a document that extends another, and `simfoundry log`."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.spec.change.git import driver
from tests.cli.command import run
from tests.cli.repository import BASE, CABINET, OVERLAY, Repository

FASTER = OVERLAY.replace("0.7", "0.9")
ROUGHER = BASE.replace("friction: 0.35", "friction: 0.5")
OWN = [
    "moved.scene.yaml",
    "  objects.cup.friction: 0.7 → 0.9",
    "  (only this file's own keys are compared, because git does not report the revision of table.scene.yaml;",
    "   `simfoundry log moved.scene.yaml` shows each commit in full)",
]
WHOLE = ["moved.scene.yaml", "  cup: friction 0.7 → 0.9", "  1 changed"]


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Repository:
    """Two commits: documents, and an overlay that another friction comes into."""
    monkeypatch.chdir(tmp_path)
    made = Repository(tmp_path)
    made.write(".gitattributes", "*.yaml diff=simfoundry\n")
    made.write("moved.scene.yaml", FASTER)
    made.commit("two")
    return made


def _shown(repository: Repository, revision: str = "HEAD", path: str = "moved.scene.yaml") -> list[str]:
    return repository.git("show", "--ext-diff", "--format=", revision, "--", path, driver=True).splitlines()


# -- git's driver ---------------------------------------------------------------------------------------------------


def test_an_overlay_whose_base_never_changed_is_shown_whole(repository: Repository) -> None:
    assert _shown(repository) == WHOLE


def test_a_base_that_changed_later_is_not_taken_for_that_of_then(repository: Repository) -> None:
    """The overlay's blob lay beside two bases: `git diff HEAD~1 HEAD~2` and `git show` would mean different ones."""
    repository.write("table.scene.yaml", ROUGHER)
    repository.commit("three")
    assert _shown(repository, "HEAD~1") == OWN
    assert "1 changed" not in "\n".join(_shown(repository, "HEAD~1"))


@pytest.mark.slow  # 2 s
def test_an_overlay_that_changed_with_its_base_is_shown_whole_each_time(repository: Repository) -> None:
    """Each of its blobs lay beside one base only, none of them today's."""
    repository.write("table.scene.yaml", BASE.replace("[0.3, 0.1, 0.05]", "[0.33, 0.1, 0.05]"))
    repository.write("moved.scene.yaml", OVERLAY.replace("0.7", "0.8"))
    repository.commit("three")
    repository.git("rm", "--quiet", "table.scene.yaml", "moved.scene.yaml")
    repository.commit("four")
    assert _shown(repository, "HEAD~2") == WHOLE
    moved = ["moved.scene.yaml", "  cup moved 3.0 cm (+x 3.0); friction 0.9 → 0.8", "  1 moved, 1 changed"]
    assert _shown(repository, "HEAD~1") == moved
    assert _shown(repository)[1].startswith("  removed: 1 material (ceramic), 4 objects (desk, cup")


def test_an_amended_commit_counts_as_long_as_git_knows_it(repository: Repository) -> None:
    """The base was amended: `git show HEAD@{1}` still shows the commit of before."""
    repository.write("table.scene.yaml", ROUGHER)
    repository.git("add", "--all")
    repository.git("commit", "--quiet", "--amend", "-m", "two, amended")
    assert _shown(repository) == _shown(repository, "HEAD@{1}") == OWN


@pytest.mark.slow  # 2 s
def test_the_working_tree_and_the_index_count(repository: Repository) -> None:
    repository.write("table.scene.yaml", ROUGHER)
    assert _shown(repository) == WHOLE
    against = repository.git("diff", "HEAD~1", "--", "moved.scene.yaml", driver=True)
    assert against.splitlines() == OWN  # it might be `git diff HEAD~1 HEAD`, where the base is another one
    repository.git("checkout", "--quiet", "table.scene.yaml")
    assert _shown(repository) == WHOLE
    repository.write("moved.scene.yaml", OVERLAY)
    assert repository.git("diff", driver=True).splitlines() == [
        "moved.scene.yaml",
        "  cup: friction 0.9 → 0.7",
        "  1 changed",
    ]
    repository.write("table.scene.yaml", ROUGHER)
    repository.git("add", "table.scene.yaml")
    assert "objects.cup.friction: 0.9 → 0.7" in repository.git("diff", "moved.scene.yaml", driver=True)


def test_what_a_document_only_refers_to_does_not_make_it_unknown(repository: Repository) -> None:
    """An asset of several revisions takes away the unit of its joint, and nothing else."""
    asset = "asset: parts/cabinet.asset.yaml"
    repository.write("table.scene.yaml", BASE.replace(asset, f"{asset}, joints: {{slide: 0.12}}"))
    repository.commit("three")
    assert _shown(repository, path="table.scene.yaml")[1] == "  cabinet: joint slide 0.00 → 0.12 m"
    repository.write(
        "parts/cabinet.asset.yaml", CABINET.replace("prismatic", "revolute").replace("limits", "limits_deg")
    )
    repository.commit("four")
    assert _shown(repository, "HEAD~1", "table.scene.yaml")[1] == "  cabinet: joint slide 0.00 → 0.12"


def test_where_it_takes_too_long_nothing_is_guessed(repository: Repository, monkeypatch: pytest.MonkeyPatch) -> None:
    top = repository.folder
    blob = driver.Blob(
        "moved.scene.yaml", FASTER.encode(), repository.git("rev-parse", "HEAD:moved.scene.yaml").strip()
    )
    assert driver.read_beside(top, blob) is not None
    monkeypatch.setattr(driver, "MAX_STATES", 1)
    assert driver.read_beside(top, blob) is None
    monkeypatch.setattr(driver, "MAX_STATES", 5000)
    monkeypatch.setattr(driver, "LOOKUP_S", 0.0)
    assert driver.read_beside(top, blob) is None
    gone = driver.Blob("moved.scene.yaml", OVERLAY.encode(), "0123456789abcdef0123456789abcdef01234567")
    assert driver.read_beside(top, gone) is None


@pytest.mark.parametrize(
    "base", ["../table.scene.yaml", "a\nb.scene.yaml", "moved.scene.yaml", "gone.scene.yaml", "", "/x"]
)
def test_a_base_that_cannot_be_is_no_crash(repository: Repository, base: str) -> None:
    odd = OVERLAY.replace("extends: table.scene.yaml", f"extends: {base!r}")
    repository.write("moved.scene.yaml", odd)
    repository.commit("three")
    assert "Traceback" not in repository.git("show", "--ext-diff", driver=True)


# -- simfoundry log -------------------------------------------------------------------------------------------------


def _log(*args: str) -> list[str]:
    done = run("log", *args)
    assert (done.code, done.err) == (0, "")
    return [line[11:] if not line.startswith("  ") else line for line in done.out.splitlines()]


def test_each_commit_is_shown_as_it_was(repository: Repository) -> None:
    """Also one that changed the base only, and the first, and not one that changed something else."""
    repository.write("other.scene.yaml", BASE)
    repository.commit("something else")
    repository.write("table.scene.yaml", BASE.replace("[0.3, 0.1, 0.05]", "[0.33, 0.1, 0.05]"))
    repository.commit("the base moves")
    repository.write("moved.scene.yaml", FASTER.replace("name: moved", "name: moved\ndescription: Faster."))
    repository.commit("words")
    lines = _log("moved.scene.yaml")
    heads, told = [line for line in lines if line[:2] != "  "], [line for line in lines if line[:2] == "  "]
    assert [head.partition("t@example.org: ")[2] for head in heads] == ["words", "the base moves", "two", "one"]
    assert told == [
        '  description now "Faster."',
        "  description changed",
        "  cup moved 3.0 cm (+x 3.0)",
        "  1 moved",
        "  cup: friction 0.7 → 0.9",
        "  1 changed",
        "  added: 1 material (ceramic), 4 objects (desk, cup, bowl, cabinet), 1 camera (front)",
    ]
    assert len(_log("-n", "1", "moved.scene.yaml")) == 3
    assert _log("HEAD~1..HEAD", "moved.scene.yaml") == lines[:3]
    assert _log("HEAD~2", "moved.scene.yaml") == lines[6:]
    commits = run("log", "--json", "moved.scene.yaml").json["commits"]
    assert [c["summary"] for c in commits] == ["description changed", "1 moved", "1 changed", ""]
    assert commits[0]["commit"] == repository.git("rev-parse", "HEAD").strip()
    assert commits[1]["entries"][0]["marks"] == ["moved"]


def test_a_document_is_followed_to_its_former_name(repository: Repository) -> None:
    repository.git("mv", "moved.scene.yaml", "turned.scene.yaml")
    repository.write("turned.scene.yaml", FASTER.replace("0.9", "0.95"))
    repository.commit("renamed")
    assert [line for line in _log("turned.scene.yaml") if line[:2] == "  "][:3] == [
        "  cup: friction 0.90 → 0.95",
        "  1 changed",
        "  cup: friction 0.7 → 0.9",
    ]


def test_a_merge_is_shown_where_it_differs_from_both(repository: Repository) -> None:
    repository.git("switch", "--quiet", "-c", "side", "HEAD~1")
    repository.write("table.scene.yaml", BASE.replace("[0.3, 0.1, 0.05]", "[0.33, 0.1, 0.05]"))
    repository.commit("side")
    repository.git("switch", "--quiet", "main")
    repository.git("merge", "--quiet", "-m", "joined", "side")
    table = [line.partition("org: ")[2] for line in _log("table.scene.yaml") if line[:2] != "  "]
    assert table == ["side", "one"]
    lines = _log("moved.scene.yaml")
    heads = {line.partition("org: ")[2]: lines[k + 1] for k, line in enumerate(lines) if line[:2] != "  "}
    assert heads["joined"] == heads["side"] == "  cup moved 3.0 cm (+x 3.0)"
    assert heads["two"] == "  cup: friction 0.7 → 0.9"


def test_what_comes_and_goes_and_cannot_be_read_is_told(repository: Repository) -> None:
    repository.write("moved.scene.yaml", "objects: [")
    repository.commit("broken")
    repository.git("rm", "--quiet", "moved.scene.yaml")
    repository.commit("gone")
    lines = _log("moved.scene.yaml")
    heads = {line.partition("org: ")[2]: lines[k + 1] for k, line in enumerate(lines) if line[:2] != "  "}
    assert heads["gone"].startswith("  cannot be compared: no part of")
    assert heads["broken"].startswith("  cannot be compared: no part of")
    assert heads["two"] == "  cup: friction 0.7 → 0.9"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nothing.scene.yaml"], "no commit in this history changes nothing.scene.yaml"),
        (["HEAD..HEAD", "moved.scene.yaml"], "no commit in this history changes moved.scene.yaml"),
        (["nowhere", "moved.scene.yaml"], "`nowhere` is neither a file nor a revision"),
        (["--", "--all", "moved.scene.yaml"], "`--all` is neither a file nor a revision"),
        (["a", "b", "moved.scene.yaml"], "give one document"),
        (["parts"], "parts is a folder; give one document"),
        (["../elsewhere.scene.yaml"], "is not in a git repository"),
    ],
)
@pytest.mark.usefixtures("repository")
def test_what_has_no_history_says_so(arguments: list[str], message: str) -> None:
    done = run("log", *arguments)
    assert done.code == 2 and message in done.err and "Traceback" not in done.err
