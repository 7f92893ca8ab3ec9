"""Stages whose objects have variants, edited as people edit them, and the document that comes back."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from simfoundry.backends import compile_scene
from simfoundry.backends.usd import compile_usd
from simfoundry.frontends.usd.compiled.loading import Imported, import_usd
from simfoundry.scene.lower import lower_file

if TYPE_CHECKING:
    from pxr import Usd

SCENE = """\
simfoundry: scene/1
name: shelf

objects:
  desk:
    fixed: true
    shape: {box: [1, 1, 0.04]}
    pose: {xyz: [0, 0, -0.02]}
  cup:
    shape: {cylinder: {radius: 0.03, height: 0.1}}
    mass: 0.2  # weighed
    place: {on: desk, xy: [0.3, 0.1], yaw_deg: 20}
    variants:
      tall: {labels: [vase], shape: {cylinder: {radius: 0.03, height: 0.2}}}
      red: {color: [1, 0, 0], mass: 0.3}
      chest: {asset: chest.asset.yaml}
  ball:
    shape: {sphere: 0.02}
    mass: 0.05
    place: {on: cup}
"""

CHEST = """\
simfoundry: asset/1
name: chest
links:
  body: {mass: 1, parts: {floor: {shape: {box: [0.1, 0.1, 0.05]}}}}
  lid: {mass: 0.1, parts: {plate: {shape: {box: [0.1, 0.1, 0.01]}, pose: {xyz: [0.05, 0, 0.01]}}}}
joints:
  hinge: {type: revolute, parent: body, child: lid, axis: [0, 1, 0], limits_deg: [-90, 0]}
"""

CUP = "/World/Objects/cup"


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the document and, below ``usd``, its stage."""
    folder = tmp_path_factory.mktemp("variants")
    (folder / "simfoundry.yaml").touch()
    (folder / "chest.asset.yaml").write_text(CHEST)
    (folder / "shelf.scene.yaml").write_text(SCENE)
    compile_usd(lower_file(folder / "shelf.scene.yaml")).write(folder / "usd")
    return folder


def imported(built: Path, edit: Callable[[Usd.Stage], object], flat: bool = False) -> Imported:
    """What comes back of a copy of the stage after an edit."""
    from pxr import Usd

    stage = Usd.Stage.Open(str(built / "usd" / "scene.usda"))
    text = stage.GetRootLayer().ExportToString()
    copy = built / "usd" / f"edited_{len(list((built / 'usd').iterdir()))}.usda"
    copy.write_text(text)
    stage = Usd.Stage.Open(str(copy))
    edit(stage)
    (stage.Flatten() if flat else stage.GetRootLayer()).Export(str(copy))
    return import_usd(copy, built / "shelf.scene.yaml")


def choose(stage: Usd.Stage, name: str) -> None:
    assert stage.GetPrimAtPath(CUP).GetVariantSet("variant").SetVariantSelection(name)


def weigh(stage: Usd.Stage, mass: float) -> None:
    stage.GetPrimAtPath(f"{CUP}/base").GetAttribute("physics:mass").Set(mass)


def weigh_within(stage: Usd.Stage, name: str, mass: float) -> None:
    """Edit a variant itself, which need not be the one that is seen."""
    choices = stage.GetPrimAtPath(CUP).GetVariantSet("variant")
    seen = choices.GetVariantSelection()
    choices.SetVariantSelection(name)
    with choices.GetVariantEditContext():
        weigh(stage, mass)
    choices.SetVariantSelection(seen)


@pytest.mark.parametrize("flat", [False, True])
def test_nothing_edited_is_nothing_changed(built: Path, flat: bool) -> None:
    assert imported(built, lambda stage: None, flat) == Imported(SCENE)


@pytest.mark.parametrize("flat", [False, True])
def test_a_variant_that_was_switched_is_chosen_and_nothing_else(built: Path, flat: bool) -> None:
    found = imported(built, lambda stage: choose(stage, "tall"), flat)
    assert found == Imported(SCENE.replace("    variants:\n", "    variant: tall\n    variants:\n"))


def test_an_edit_counts_for_the_variant_that_is_selected(built: Path) -> None:
    found = imported(built, lambda stage: weigh(stage, 0.25))
    assert found == Imported(SCENE.replace("mass: 0.2 ", "mass: 0.25 "))

    def edit(stage: Usd.Stage) -> None:
        choose(stage, "red")
        weigh(stage, 0.25)

    found = imported(built, edit)
    chosen = SCENE.replace("    variants:\n", "    variant: red\n    variants:\n")
    assert found == Imported(chosen.replace("mass: 0.3}", "mass: 0.25}"))


def test_what_is_written_within_a_variant_is_that_variants(built: Path) -> None:
    found = imported(built, lambda stage: weigh_within(stage, "red", 0.35))
    assert found == Imported(SCENE.replace("mass: 0.3}", "mass: 0.35}"))
    found = imported(built, lambda stage: weigh_within(stage, "tall", 0.35))
    assert found == Imported(SCENE.replace("height: 0.2}}}", "height: 0.2}}, mass: 0.35}"))


def test_an_object_that_was_moved_has_a_pose_and_its_variants_stay(built: Path) -> None:
    from pxr import Gf

    def edit(stage: Usd.Stage) -> None:
        stage.GetPrimAtPath(CUP).GetAttribute("xformOp:translate").Set(Gf.Vec3d(0.1, 0.1, 0.0501))

    found = imported(built, edit)
    assert found.notes == ()
    assert "    pose: {xyz: [0.1, 0.1, 0.0501], yaw_deg: 20}\n" in found.text
    assert found.text[found.text.index("    variants:") : found.text.index("  ball:")] in SCENE


def test_a_variant_that_was_resized_states_its_shape(built: Path) -> None:
    def edit(stage: Usd.Stage) -> None:
        choose(stage, "red")
        for kind in ("Visuals", "Colliders"):
            stage.GetPrimAtPath(f"{CUP}/base/{kind}/shape").GetAttribute("height").Set(0.12)

    found = imported(built, edit)
    assert found.notes == ()
    assert "red: {shape: {cylinder: {radius: 0.03, height: 0.12}}, color: [1, 0, 0], mass: 0.3}" in found.text
    assert "    shape: {cylinder: {radius: 0.03, height: 0.1}}\n" in found.text  # that of the object itself


def test_what_no_document_can_say_of_a_variant_is_said(built: Path) -> None:
    from pxr import Gf

    def move_within(stage: Usd.Stage) -> None:
        choices = stage.GetPrimAtPath(CUP).GetVariantSet("variant")
        choices.SetVariantSelection("red")
        with choices.GetVariantEditContext():
            stage.GetPrimAtPath(CUP).GetAttribute("xformOp:translate").Set(Gf.Vec3d(0.1, 0.1, 0.0501))
        choices.SetVariantSelection("default")

    found = imported(built, move_within)
    assert found.text == SCENE and [note.prim for note in found.notes] == [CUP]
    assert found.notes[0].message == ("the variant `red` was moved, but all variants of an object share the same pose")

    def add(stage: Usd.Stage) -> None:
        stage.GetPrimAtPath(CUP).GetVariantSet("variant").AddVariant("blue")
        choose(stage, "blue")

    found = imported(built, add)
    assert found.text == SCENE
    assert "not in the document; available variants: `default`, `tall`, `red`, `chest`" in found.notes[0].message


def test_a_copy_of_an_object_with_variants_is_one(built: Path) -> None:
    from pxr import Sdf

    def copy(stage: Usd.Stage) -> None:
        layer = stage.GetRootLayer()
        Sdf.CopySpec(layer, CUP, layer, "/World/Objects/cup_2")

    found = imported(built, copy)
    assert found.notes == () and found.text.startswith(SCENE.rstrip("\n"))
    assert "  cup_2:\n" in found.text and found.text.count("chest: {asset: chest.asset.yaml}") == 2


EYE = "  {name}: {{size: [64, 48], fx: 60, fy: 60, pose: {{xyz: [0, 0, 0.1], look_at: [0, 0, 1]}}, mount: {mount}}}\n"


def test_a_camera_rides_on_every_variant_that_has_its_link(built: Path) -> None:
    from pxr import Usd

    file = built / "eyes.scene.yaml"
    text = SCENE.replace("name: shelf", "name: eyes").replace(
        "    shape: {cylinder: {radius: 0.03, height: 0.1}}\n", ""
    )
    text = text.replace("    mass: 0.2  # weighed\n", "    asset: chest.asset.yaml\n").replace(", mass: 0.3}", "}")
    text = text.replace("height: 0.2}}}", "height: 0.2}}, mass: 1}").replace(
        "red: {color", "red: {mass: 1, shape: {sphere: 1}, color"
    )
    text = text.replace("      chest: {asset: chest.asset.yaml}\n", "")
    file.write_text(text + "cameras:\n" + EYE.format(name="eye", mount="cup") + EYE.format(name="two", mount="cup.lid"))
    artifact = compile_usd(lower_file(file))
    losses = [loss.reason for loss in artifact.losses if loss.path == "two"]
    assert losses == [
        f"Variant `{v}` of `cup` has no link `lid` on which to mount the camera." for v in ("tall", "red")
    ]
    artifact.write(built / "eyes")
    stage = Usd.Stage.Open(str(built / "eyes" / "scene.usda"))
    assert stage.GetPrimAtPath(f"{CUP}/body/eye") and stage.GetPrimAtPath(f"{CUP}/lid/two")
    assert import_usd(built / "eyes" / "scene.usda", file) == Imported(file.read_text())
    choose(stage, "tall")
    assert stage.GetPrimAtPath(f"{CUP}/base/eye") and not stage.GetPrimAtPath(f"{CUP}/lid")

    file.write_text(file.read_text().replace("    variants:\n", "    variant: tall\n    variants:\n"))
    for target in ("mjcf", "usd"):
        losses = [loss.reason for loss in compile_scene(lower_file(file), target).losses if "two" in loss.path]
        assert losses == ["the variant `tall` of `cup` has no link `lid`"]
