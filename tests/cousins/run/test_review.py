"""Reviews of cousins: decisions are kept beside the manifest, and rejected cousins are left out of folders."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from simfoundry.cousins.run.review import (
    REVIEW,
    CousinReview,
    read_cousins,
    read_reviews,
    usable_tasks,
    without_rejected,
    write_review,
)
from simfoundry.errors import SimfoundryError


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """The output folder of a run with three cousins."""
    cousins = []
    for index in (1, 4, 7):
        files = {kind: f"{index:06d}.{kind}.yaml" for kind in ("scene", "task")}
        cousins.append(
            {"index": index, "files": files, "asked": ["LeftOf(cup, bowl)"], "vary": {"objects.cup.mass": 0.2}}
        )
        for name in files.values():
            (tmp_path / name).touch()
    (tmp_path / "manifest.json").write_text(json.dumps({"simfoundry": "cousins-run/1", "cousins": cousins}))
    return tmp_path


def names(files: list[Path]) -> list[str]:
    """Return the names of files."""
    return [file.name for file in files]


def test_the_cousins_of_a_manifest_are_read(run: Path) -> None:
    first, *others = read_cousins(run)
    assert (first.index, first.asked, first.goal) == (1, ("LeftOf(cup, bowl)",), "")
    assert first.files == {"scene": run / "000001.scene.yaml", "task": run / "000001.task.yaml"}
    assert [each.index for each in others] == [4, 7]


def test_decisions_are_kept_and_changed_and_removed(run: Path) -> None:
    assert read_reviews(run) == {}
    write_review(run, 7, CousinReview(False, "the cup floats "))
    write_review(run, 1, CousinReview(True))
    assert read_reviews(run) == {1: CousinReview(True), 7: CousinReview(False, "the cup floats")}
    assert json.loads((run / REVIEW).read_text()) == {
        "simfoundry": "cousins-review/1",
        "cousins": {
            "1": {"verdict": "accepted", "reason": ""},
            "7": {"verdict": "rejected", "reason": "the cup floats"},
        },
    }
    write_review(run, 7, CousinReview(True, "it hangs on a hook"))
    write_review(run, 1, None)
    assert read_reviews(run) == {7: CousinReview(True, "it hangs on a hook")}


def test_a_rejection_needs_a_reason(run: Path) -> None:
    with pytest.raises(SimfoundryError, match="needs a reason"):
        write_review(run, 1, CousinReview(False, "  "))
    assert not (run / REVIEW).exists()


def test_rejected_cousins_are_left_out_of_folders(run: Path) -> None:
    write_review(run, 4, CousinReview(False, "too dark"))
    write_review(run, 7, CousinReview(True))
    (run / "by_hand.task.yaml").touch()
    tasks, left_out = usable_tasks([run])
    assert names(tasks) == ["000001.task.yaml", "000007.task.yaml", "by_hand.task.yaml"]
    assert names(left_out) == ["000004.task.yaml"]
    named = run / "000004.task.yaml"
    assert usable_tasks([named]) == ([named], [])  # a document that is named is meant
    assert usable_tasks([run.parent])[1] == [named]  # the folder above contains the run
    assert without_rejected([run / "000004.scene.yaml"]) == ([], [run / "000004.scene.yaml"])


def test_a_folder_of_rejected_cousins_is_an_error(run: Path) -> None:
    for index in (1, 4, 7):
        write_review(run, index, CousinReview(False, "all of them"))
    with pytest.raises(SimfoundryError, match=r"all 3 tasks in .* were rejected in a review"):
        usable_tasks([run])


BAD_REVIEWS = (
    "",
    "[]",
    '{"simfoundry": "cousins-review/2", "cousins": {}}',
    '{"simfoundry": "cousins-review/1", "cousins": {"x": {"verdict": "rejected"}}}',
    '{"simfoundry": "cousins-review/1", "cousins": {"1": {"verdict": "maybe"}}}',
    '{"simfoundry": "cousins-review/1", "cousins": [1]}',
    "[" * 100_000,
)


@pytest.mark.parametrize("text", BAD_REVIEWS)
def test_a_damaged_review_is_reported_and_not_overwritten(run: Path, text: str) -> None:
    (run / REVIEW).write_text(text)
    with pytest.raises(SimfoundryError, match="is not a review of cousins in the format cousins-review/1"):
        usable_tasks([run])
    with pytest.raises(SimfoundryError, match="is not a review"):
        write_review(run, 1, CousinReview(True))
    assert (run / REVIEW).read_text() == text


def test_manifests_that_cannot_be_read(run: Path) -> None:
    manifest = run / "manifest.json"
    outside = {"index": 1, "files": {"scene": "../../etc/000001.scene.yaml"}}
    manifest.write_text(json.dumps({"simfoundry": "cousins-run/1", "cousins": [outside]}))
    assert read_cousins(run)[0].files == {"scene": run / "000001.scene.yaml"}
    for text in (
        "",
        "{}",
        '{"simfoundry": "cousins-run/1", "cousins": [{}]}',
        '{"simfoundry": "cousins-run/1", "cousins": 3}',
    ):
        manifest.write_text(text)
        with pytest.raises(SimfoundryError, match="is not a manifest of cousins"):
            read_cousins(run)
    manifest.unlink()
    with pytest.raises(SimfoundryError, match="choose the output folder"):
        read_cousins(run)
