"""Libraries of things: their facts, and the filters of a recipe."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import pytest

from simfoundry.cousins.recipe.candidate import ImpossibleError, free_name
from simfoundry.cousins.recipe.document import read_recipe
from simfoundry.cousins.recipe.library import (
    Library,
    LibraryItem,
    default_folder,
    lowered,
    name_of,
    read_library,
    united,
)
from simfoundry.cousins.recipe.library_filters import filtered, remarks
from simfoundry.cousins.recipe.variant_pool import copied, references
from simfoundry.errors import SimfoundryError
from simfoundry.spec.load import load
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.cousins import DistractorAxis
from simfoundry.spec.project import project_root
from tests.assets.meshes import obj
from tests.conftest import REPOSITORY

BALL = """\
simfoundry: asset/1
name: ball
category: toy
links: {body: {density: 200, parts: {ball: {shape: {sphere: 0.03}}}}}
"""
BRICK = """\
simfoundry: asset/1
name: brick
links: {body: {mass: 0.9, parts: {brick: {shape: {box: [0.1, 0.05, 0.04]}}}}}
"""
HAT = """\
simfoundry: asset/1
name: hat
links: {body: {density: 300, parts: {hat: {mesh: ../shapes/hat.obj}}}}
"""
PYRAMID = ([[0, 0, 0], [0.06, 0, 0], [0.06, 0.06, 0], [0, 0.06, 0], [0.03, 0.03, 0.05]],
           [[0, 2, 1], [0, 3, 2], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A library of two documents of primitives, one of a mesh, a mesh of nobody, and a broken one."""
    import numpy as np

    library = tmp_path / "things"
    for name, text in (("ball", BALL), ("brick", BRICK), ("hats/hat", HAT)):
        path = library / f"{name}.asset.yaml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    mesh = obj(np.array(PYRAMID[0]), np.array(PYRAMID[1]))
    for name in ("shapes/hat.obj", "007_tent/textured.obj"):
        path = library / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(mesh)
    (library / "broken.asset.yaml").write_text("simfoundry: asset/1\nname: broken\nlinks: {}\n")
    (tmp_path / "simfoundry.yaml").write_text("")
    return library


def test_facts_are_those_of_the_lowered_things(folder: Path) -> None:
    library = read_library(folder)
    items = {item.name: item for item in library.items}
    assert list(items) == ["ball", "brick", "hat", "tent"]
    ball, brick, hat, tent = items.values()
    assert (ball.category, brick.category, tent.category) == ("toy", "brick", "tent")
    assert ball.volume == pytest.approx(4 / 3 * math.pi * 0.03**3)
    assert ball.mass == pytest.approx(200 * ball.volume) and ball.density == pytest.approx(200)
    assert [brick.mass, brick.density] == pytest.approx([0.9, 0.9 / 2e-4])
    assert hat.volume == tent.volume == pytest.approx(0.06 * 0.06 * 0.05 / 3)
    assert tent.mass == pytest.approx(500 * tent.volume)
    assert brick.size == pytest.approx((0.1, 0.05, 0.04))
    assert [file for file, _ in library.faults] == ["broken.asset.yaml"]
    assert read_library(folder) == library, "the same from the cache"


def test_filters(folder: Path) -> None:
    library = read_library(folder)

    def left(**asked: object) -> list[str]:
        return [item.name for item in filtered(library, DistractorAxis(**asked), own=["toy"])[0]]  # type: ignore[arg-type]

    assert left() == ["brick", "hat", "tent"], "the twin has a toy"
    assert left(categories=("toy",)) == ["ball"]
    assert left(exclude_categories=("brick",)) == ["hat", "tent"]
    assert left(mass={"max": 0.1}) == ["hat", "tent"]
    assert left(volume={"min": 1e-4}) == ["brick"]
    assert left(density={"min": 400, "max": 600}) == ["tent"]


def test_nothing_left_is_said_with_what_each_filter_took(folder: Path) -> None:
    axis = DistractorAxis(categories=("brick", "hat", "tend"), mass={"max": 0.0001}, density={"max": 1e4})  # type: ignore[arg-type]
    with pytest.raises(ImpossibleError) as raised:
        filtered(read_library(folder), axis)
    (reason,) = raised.value.reasons
    assert reason.numbers["library"] == 4
    assert reason.text == (
        "none of the 4 objects in things can be used as a distractor; "
        "category `brick` or `hat` or `tend`: 2 removed; mass at most 0.0001 "
        "kg: 2 removed (actual values 0.018 to 0.9); "
        "category `tend` does not exist in it, did you mean `tent`?; unusable files: 1, the first is "
        "broken.asset.yaml: expected at least 1 value, found 0"
    )


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(SimfoundryError, match="does not exist; specify"):
        read_library(tmp_path / "nowhere")


def test_libraries_together_hold_each_thing_once(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path / "copy")
    (tmp_path / "copy" / "ball.asset.yaml").write_text(BALL.replace("0.03", "0.02"))
    both = united([read_library(folder), read_library(tmp_path / "copy")])
    assert [item.name for item in both.items] == ["ball", "brick", "hat", "tent", "ball_2"]
    assert both.title == "things and copy"


def test_what_lies_outside_the_project_is_brought_along(folder: Path, tmp_path: Path) -> None:
    root = tmp_path / "elsewhere"
    out = root / "out"
    out.mkdir(parents=True)
    (root / "simfoundry.yaml").write_text("")
    items = read_library(folder).items
    named = references(items, root, out)
    for item in items:
        path = (out / named[item.name]).resolve()
        assert path.is_relative_to(out / "assets") and project_root(path) == root
    again = {i.name: i for i in read_library(out / "assets").items}
    assert {n: (i.mass, i.volume) for n, i in again.items()} == {i.name: (i.mass, i.volume) for i in items}
    before = {p: p.stat().st_mtime_ns for p in out.rglob("*.obj")}
    assert before and references(items, root, out) == named
    assert {p: p.stat().st_mtime_ns for p in out.rglob("*.obj")} == before, "a copy is made once"
    inside = references(items, tmp_path, tmp_path / "out")
    assert inside["ball"] == "../things/ball.asset.yaml"


def test_copies_are_sound_documents(folder: Path, tmp_path: Path) -> None:
    path = copied(folder / "hats" / "hat.asset.yaml", tmp_path / "new")
    loaded = load(path)
    assert loaded.findings == () and "mesh: 0/hat.obj" in path.read_text()


def test_names() -> None:
    assert name_of(Path("025_mug/google_16k/textured.obj")) == "mug"
    assert name_of(Path("Coffee-Mug.v2.glb")) == "coffee_mug"
    assert name_of(Path("things/042.stl")) == "thing"
    assert [free_name("mug", taken) for taken in ((), ("mug",), ("mug", "mug_2"))] == ["mug", "mug_2", "mug_3"]


def test_the_shipped_library_is_whole() -> None:
    """In a wheel it is packaged, in a checkout it is ``specs/assets``."""
    library = read_library(default_folder())
    assert library.faults == () and len(library.items) >= 24
    shipped = REPOSITORY / "specs" / "assets"
    assert {p.name for p in default_folder().iterdir()} == {p.name for p in shipped.iterdir()}
    assert all(isinstance(i, LibraryItem) and 0.005 < i.mass < 20 and 50 < i.density < 9000 for i in library.items)
    assert isinstance(library, Library)


def test_nothing_is_added_that_an_instruction_could_mean(tmp_path: Path) -> None:
    """A second cup is one by its category, by its name, or, where neither says anything, by its size and shape."""
    shipped = REPOSITORY / "specs" / "assets"
    plain = (shipped / "cup.asset.yaml").read_text().replace("category: cup\n", "")
    for name in ("green_cup", "gadget"):
        (tmp_path / f"{name}.asset.yaml").write_text(plain.replace("name: cup", f"name: {name}"))
    ball = (shipped / "tennis_ball.asset.yaml").read_text().replace("category: tennis_ball\n", "")
    (tmp_path / "widget.asset.yaml").write_text(ball.replace("name: tennis_ball", "name: widget"))
    tumbler = plain.replace("name: cup", "name: mine\ncategory: tumbler").replace("950", "990")
    (tmp_path / "mine.asset.yaml").write_text(tumbler)
    library = read_library(tmp_path)
    things = (lowered(shipped / "blue_cup.asset.yaml"),)
    left, steps = filtered(library, DistractorAxis(), ["cup", "blue_cup"], lambda: things)
    assert [item.name for item in left] == ["widget"]
    assert [[item.name for item in step.removed] for step in steps] == [["green_cup", "mine"], ["gadget"]]
    said = remarks(library, left, steps)
    assert (
        said[0].startswith("excluded `green_cup`, `mine` from ") and "a category that the twin does not have" in said[0]
    )
    assert said[1].startswith("excluded `gadget` from ") and "a shape that the twin does not have" in said[1]
    assert said[2].startswith("no `category` is set for `widget` in ") and "set it in these assets" in said[2]
    without = filtered(library, DistractorAxis(exclude_categories=("cup",)))[0]
    assert [item.name for item in without] == ["gadget", "widget"]


def test_a_task_that_says_the_cup_gets_no_second_one() -> None:
    recipe = read_recipe(REPOSITORY / "specs" / "cousins" / "cup_in_bowl.cousins.yaml")
    names = {item.name for item in recipe.distractors}
    assert names and not names & {"cup", "blue_cup", "orange_cup", "bowl"}
    assert all(item.stated for item in recipe.distractors) and len(recipe.remarks) == 1


@pytest.mark.parametrize("path", sorted((REPOSITORY / "specs" / "assets").glob("*.asset.yaml")), ids=lambda p: p.name)
def test_every_shipped_asset_states_its_category(path: Path) -> None:
    spec = load(path).spec
    assert isinstance(spec, AssetSpec) and spec.category is not None
