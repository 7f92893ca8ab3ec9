"""What can never be is refused by the command before anything is tried, with the numbers that say why."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.cousins.run.candidates import CandidateSampler
from simfoundry.cousins.run.log import log_file
from tests.cli.command import Done, run
from tests.cousins.conftest import TABLE
from tests.cousins.recipe.test_library import BALL, BRICK

RECIPE = """\
simfoundry: cousins/1
name: tables
twin: table.scene.yaml
scene:
  anchor: post
  objects: {brick: [LeftOf, RightOf], can: [InFrontOf, Behind]}
  gap: [0.02, 0.15]
distractors: {count: [1, 2], library: things, builtin_library: false}
"""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A project with a table, a library of two things, and a recipe that works."""
    (tmp_path / "simfoundry.yaml").write_text("")
    (tmp_path / "table.scene.yaml").write_text(TABLE)
    (tmp_path / "things").mkdir()
    (tmp_path / "things" / "ball.asset.yaml").write_text(BALL)
    (tmp_path / "things" / "brick.asset.yaml").write_text(BRICK)
    (tmp_path / "a.cousins.yaml").write_text(RECIPE)
    return tmp_path


def asked(project: Path, was: str, becomes: str, count: str = "100") -> Done:
    """The recipe with something else in it."""
    recipe = project / "a.cousins.yaml"
    text = recipe.read_text()
    assert was in text
    recipe.write_text(text.replace(was, becomes))
    return run("cousins", recipe, "-n", count, "-o", project / "out", "-j", "1", "--no-gallery")


def nothing_was_tried(project: Path) -> bool:
    log = log_file(project / "out", None)
    return not list(project.glob("out/*.yaml")) and not (log.is_file() and log.read_bytes())


def test_the_recipe_itself_works(project: Path) -> None:
    assert asked(project, "gap:", "gap:", "1").code == 0


def test_inside_of_something_solid(project: Path) -> None:
    done = asked(project, "brick: [LeftOf, RightOf]", "brick: [LeftOf, Inside]")
    assert (done.code, done.err) == (
        1,
        "impossible: Inside(brick, post) can never hold: `post` has no cavity, because its colliders do not "
        "enclose any space\n",
    )
    assert nothing_was_tried(project)


def test_an_anchor_that_does_not_exist(project: Path) -> None:
    done = asked(project, "anchor: post", "anchor: pots")
    assert done.code == 2 and "no object is called `pots`" in done.err and "did you mean `post`?" in done.err
    assert nothing_was_tried(project)


def test_an_anchor_that_no_goal_names(project: Path) -> None:
    done = asked(project, "  anchor: post\n", "")
    assert done.code == 2 and "there is no anchor" in done.err and nothing_was_tried(project)


def test_a_table_too_full_of_what_moves(project: Path) -> None:
    scene = project / "table.scene.yaml"
    crates = "".join(
        f"  crate_{k}: {{shape: {{box: [0.25, 0.25, 0.1]}}, material: wood, pose: {{xyz: [{3 + k}, 0, 0.05]}}}}\n"
        for k in range(9)
    )
    floor = "  floor: {fixed: true, shape: {box: [20, 2, 0.04]}, material: wood, pose: {xyz: [11, 0, -0.02]}}\n"
    scene.write_text(TABLE.replace("objects:\n", f"objects:\n{floor}{crates}"))
    moved = ", ".join(f"crate_{k}: [NextTo]" for k in range(9))
    done = asked(project, "objects: {", f"objects: {{{moved}, ")
    assert done.code == 1, done.err
    assert done.err == (
        "impossible: `table` is too full: the shadows of 12 objects require 0.579 m^2, but random placement can fill "
        "at most 85% of its 0.480 m^2\n"
    ), "9 crates of 0.0625 m^2, the brick of 0.0032, the can of 0.0027 and the post of 0.01 that stays"
    assert nothing_was_tried(project)


def test_a_table_too_full_of_distractors(project: Path) -> None:
    done = asked(project, "count: [1, 2]", "count: [150, 160]")
    assert done.code == 1, done.err
    # Balls of 28 cm^2 each, for there is a brick already; and 160 cm^2 of the brick, the can and the post.
    assert (
        "`table` is too full: the shadows of 3 objects and the 150 smallest distractors require 0.441 m^2, "
        "but random placement can fill at most 85% of its 0.480 m^2" in done.err
    )
    assert nothing_was_tried(project)


def test_a_table_that_may_hold_them_is_tried(project: Path) -> None:
    (project / "a.cousins.yaml").write_text(RECIPE.replace("count: [1, 2]", "count: [25, 25]"))
    one = CandidateSampler.load(project / "a.cousins.yaml", project / "out", 0)(1)
    assert one.accepted or {reason.code for reason in one.reasons} == {"no_room"}, one.reasons


def test_a_filter_that_matches_nothing(project: Path) -> None:
    done = asked(project, "library: things", "library: things, mass: {max: 0.001}")
    assert done.code == 1, done.err
    assert "none of the 2 objects in things can be used as a distractor" in done.err
    assert "mass at most 0.001 kg: 1 removed (actual values 0.0226 to 0.0226)" in done.err, "the twin has a brick"
    assert nothing_was_tried(project)


def test_a_gap_that_no_table_has(project: Path) -> None:
    done = asked(project, "gap: [0.02, 0.15]", "gap: [2, 3]")
    assert done.code == 1 and nothing_was_tried(project)
    assert "cannot be placed on `table` left of `post` with the minimum gap of 2 m from `post`" in done.err
