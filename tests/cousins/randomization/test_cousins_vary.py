"""Cousins with drawn values: what is drawn, what is written, and that the documents are sound."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image as PillowImage

from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.statistics.results import cousin_of
from simfoundry.evaluate.task import load_task
from simfoundry.scene.lower import lower
from simfoundry.scene.model import Scene
from simfoundry.spec.diagnostics import Severity, SpecError
from simfoundry.spec.load import load
from simfoundry.spec.yaml.text import parse
from tests.cli.command import run
from tests.cousins.randomization.conftest import Sampler, write

MANY = """
light.*.intensity: {uniform: [0.4, 1.2]}
light.lamp.color: {shift: 0.1}
light.lamp.xyz: {shift: [0.3, 0.2, 0]}
light.key.direction: {cone_deg: 30}
camera.far_*.pose: {shift: 0.03, turn_deg: 3}
camera.eye.fx: {times: [0.97, 1.03]}
camera.far_*.fov_deg: {shift: [-3, 2]}
object.*.mass: {range: estimate}
object.peg_*.mass: {times: [0.5, 2]}
object.cube.mass: {uniform: [0.5, 1]}
object.tee.shape.compound.*.color: {choose: [white, wood, "#102030", [0.1, 0.2, 0.3]]}
object.tee.friction: {times: [0.9, 1.1]}
object.side_stool.color: {choose: [red, blue]}
material.*.restitution: {uniform: [0, 0.2]}
cabinet.drawer: {uniform: [0, 0.1]}
cabinet.*.damping: {log_uniform: [1, 10]}
object.cabinet.friction: {times: [0.7, 1.3]}
parameter.gap: {shift: 0.02}
gravity: {times: [0.99, 1.01]}
"""


def lowered(path: Path) -> Scene:
    loaded = load(path)
    assert [d for d in loaded.all_findings() if d.severity is Severity.ERROR] == []
    return lower(loaded)


def test_each_value_is_an_entry_of_a_sound_overlay(room: Path, sampler: Sampler) -> None:
    one = sampler(MANY)(1)
    assert one.accepted, one.reasons
    paths = write(room, one)
    scene = lowered(paths["scene"])
    twin = lower(load(room / "room.scene.yaml"))
    data: Any = parse(one.documents["scene"]).data
    for path in one.files().values():
        assert run("fmt", "--check", room / "out" / path).code == 0
    values = one.vary
    assert data["lights"]["key"]["intensity"] == values["light.key.intensity"]
    assert 0.4 <= scene.lights[0].intensity <= 1.2
    masses = {name: scene.object(name).root.mass for name in ("can", "peg_1", "peg_2", "cube")}
    assert masses["can"] == pytest.approx(values["object.can.mass"]) and 0.2 <= masses["can"] <= 0.5
    for name in ("peg_1", "peg_2"):  # whose masses follow from the density of their material
        assert masses[name] / twin.object(name).root.mass == pytest.approx(values[f"object.{name}.mass"], rel=1e-5)
    assert masses["cube"] == pytest.approx(values["object.cube.mass"])  # stated by the selected variant
    assert values["object.peg_1.mass"] != values["object.peg_2.mass"]
    drawer = next(j for j in scene.object("cabinet").joints if j.name == "drawer")
    assert drawer.position == values["cabinet.drawer"] and drawer.damping == values["cabinet.drawer.damping"]
    was, now = (s.object("cabinet").links[0].colliders[0].friction for s in (twin, scene))
    assert now / was == pytest.approx(values["object.cabinet.friction"], rel=1e-5)
    assert scene.object("can").X_WO.p[0] == pytest.approx(values["parameter.gap"], abs=1e-6)
    assert list(scene.gravity) == pytest.approx([0, 0, -9.81 * values["gravity"]], rel=1e-5)
    assert "Closed(cabinet.drawer)" not in map(str, scene.relations)
    assert not one.pictures_only


def test_poses_and_directions_stay_in_their_range(room: Path, sampler: Sampler) -> None:
    twin = lower(load(room / "room.scene.yaml"))
    make = sampler("light.key.direction: {cone_deg: 30}\ncamera.far_*.pose: {shift: 0.03, turn_deg: 3}\n"
                   "light.lamp.xyz: {shift: [0.3, 0.2, 0]}")  # fmt: skip
    angles, shifts, turns = [], [], []
    for k in range(1, 13):
        scene = lowered(write(room, make(k))["scene"])
        for one, other in zip(twin.cameras[1:], scene.cameras[1:], strict=True):
            shifts.append(float(np.linalg.norm(other.X_WC.p - one.X_WC.p)))
            turns.append(math.degrees(other.X_WC.angle_to(one.X_WC)))
        key, lamp = scene.lights
        angles.append(
            math.degrees(math.acos(np.clip(twin.lights[0].X_WL.rotation[:, 2] @ key.X_WL.rotation[:, 2], -1, 1)))
        )
        x, y, z = np.abs(lamp.X_WL.p - twin.lights[1].X_WL.p)
        assert x <= 0.3 and y <= 0.2 and z < 1e-9
    assert 0.02 < max(shifts) <= 0.0301 and 2 < max(turns) <= 3.01 and 15 < max(angles) <= 30.01
    assert len({round(a, 3) for a in angles}) == 12


def test_an_entry_changes_no_other_value_and_neither_does_their_order(sampler: Sampler) -> None:
    lines = MANY.strip().splitlines()
    few = sampler(lines[0])(2).vary
    all_ = sampler(MANY)(2).vary
    assert {name: all_[name] for name in few} == dict(few) and len(few) == 2
    assert dict(sampler("\n".join(reversed(lines)))(2).vary) == dict(all_)
    assert dict(sampler(lines[0], seed=1)(2).vary) != dict(few)


def test_values_that_are_drawn_together(sampler: Sampler) -> None:
    make = sampler("""light.*.intensity: {uniform: [0, 1], together: sun}
        material.wood.restitution: {uniform: [0, 0.1], together: sun}
        material.steel.restitution: {uniform: [0, 0.1]}""")
    for k in range(1, 4):
        found = make(k).vary
        assert found["light.key.intensity"] == found["light.lamp.intensity"]
        assert found["material.wood.restitution"] == pytest.approx(found["light.key.intensity"] / 10, abs=1e-6)
        assert found["material.steel.restitution"] != found["material.wood.restitution"]


def test_an_entry_without_a_star_wins_over_patterns(sampler: Sampler) -> None:
    found = sampler("light.*.intensity: {uniform: [0, 0.1]}\nlight.key.intensity: {uniform: [5, 6]}")(1).vary
    assert found["light.lamp.intensity"] <= 0.1 and 5 <= found["light.key.intensity"] <= 6


def test_splits(sampler: Sampler) -> None:
    splits = "splits: {train: {until: 0.9}, held_out: {from: 0.9}}\n"
    vary = "light.key.intensity: {uniform: [0, 1]}\nobject.table.color: {choose: [oak, white, slate]}"
    for split in ("train", "held_out"):
        make = sampler(vary, splits, split=split)
        found = [make(k) for k in range(1, 7)]
        assert {c.split for c in found} == {split}
        assert all((c.vary["light.key.intensity"] >= 0.9) == (split == "held_out") for c in found)
        assert all((c.vary["object.table.color"] == "slate") == (split == "held_out") for c in found)
    make = sampler(vary, splits)
    assert {make(k).split for k in range(1, 60)} == {"train", "held_out"}
    with pytest.raises(SimfoundryError, match="has no split `hold_out`; did you mean `held_out`"):
        sampler(vary, splits, split="hold_out")


def test_what_stands_on_an_object_moves_with_it(room: Path, sampler: Sampler) -> None:
    one = sampler("object.table.height: {shift: [0.04, 0.05], with_contents: true}")(1)
    scene, twin = lowered(write(room, one)["scene"]), lower(load(room / "room.scene.yaml"))
    shift = one.vary["object.table.height"]
    assert 0.04 <= shift <= 0.05
    for name in ("table", "brick", "cabinet", "can", "tee", "peg_1"):  # given by a pose, welded, and placed
        before, after = twin.object(name).X_WO, scene.object(name).X_WO
        assert list(after.p - before.p) == pytest.approx([0, 0, shift], abs=2e-4), name
        assert after.angle_to(before) < 1e-3
    stool = scene.object("side_stool").X_WO
    assert list(stool.p) == list(twin.object("side_stool").X_WO.p)
    data: Any = parse(one.documents["scene"]).data
    assert set(data["objects"]) == {"table", "brick", "cabinet"}  # the others are placed on the table again


def test_a_table_that_leaves_its_contents_behind_is_rejected(sampler: Sampler) -> None:
    one = sampler("object.table.height: {shift: [-0.06, -0.05]}")(1)
    assert not one.accepted and {reason.code for reason in one.reasons} & {"moved", "tilted", "relation_lost"}


def test_the_task_of_a_cousin(room: Path, sampler: Sampler) -> None:
    vary = "instruction: {choose: [Bring the can to the brick., Move the can beside the brick.]}"
    one = sampler(vary, twin="away.task.yaml")(1)
    assert set(one.documents) == {"task"} and one.pictures_only
    data: Any = parse(one.documents["task"]).data
    assert data["instruction"] == one.vary["instruction"] and "scene" not in data
    (room / "away.task.yaml").write_text(
        (room / "away.task.yaml").read_text() + "start: {joints: {cabinet: {drawer: 0.05}}}\n"
    )
    one = sampler("cabinet.drawer: {shift: 0.01}", twin="away.task.yaml")(1)
    data = parse(one.documents["task"]).data
    assert data["start"]["joints"]["cabinet"]["drawer"] == one.vary["cabinet.drawer"] != 0.05


def test_other_axes_beside_it(room: Path, sampler: Sampler) -> None:
    more = "scene: {anchor: tee, objects: {brick: [LeftOf, RightOf]}}\ndistractors: {count: [1, 1], mass: {max: 0.3}}\n"
    more += "object: {objects: {cabinet: {count: 2, changes: [appearance]}}}\n"
    make = sampler("object.cabinet.friction: {times: [0.5, 2]}\nlight.*.intensity: {uniform: [0, 1]}\n"
                   "object.table.height: {shift: 0.03, with_contents: true}", more)  # fmt: skip
    one = next(c for c in map(make, range(1, 40)) if c.accepted)
    scene = lowered(write(room, one)["scene"])
    data: Any = parse(one.documents["cabinet.asset"]).data
    assert data["extends"].startswith("assets/objects/cabinet_") and "friction" in data["links"]["body"]
    top = scene.object("table").X_WO.p[2] + 0.02
    assert scene.object("brick").X_WO.p[2] == pytest.approx(top + 0.015, abs=3e-4)
    assert len(scene.objects) == 10 and not one.pictures_only


@pytest.mark.slow  # 3 s: a whole run
def test_the_command(room: Path) -> None:
    recipe = room / "lit.cousins.yaml"
    recipe.write_text(
        "simfoundry: cousins/1\nname: lit\ntwin: away.task.yaml\nvary:\n  light.*.intensity: {uniform: [0.4, 1.2]}\n"
        "  object.table.color: {choose: [oak, white]}\nsplits: {a: {until: 0.5}, b: {from: 0.5}}\n"
    )
    made = [run("cousins", recipe, "-n", "4", "-o", room / name, "-j", jobs, "--no-gallery")
            for name, jobs in (("one", "1"), ("two", "2"))]  # fmt: skip
    assert [done.code for done in made] == [0, 0], made
    files = {p.name: p.read_bytes() for p in (room / "one").iterdir() if p.is_file()}
    assert files == {p.name: p.read_bytes() for p in (room / "two").iterdir() if p.is_file()}
    manifest = json.loads(files["manifest.json"])
    assert manifest["vary"]["light.key.intensity"] == {"entry": "light.*.intensity", "effect": "pictures"}
    assert manifest["vary"]["object.table.color"]["effect"] == "pictures"
    for cousin in manifest["cousins"]:
        assert set(cousin["vary"]) == set(manifest["vary"]) and cousin["pictures_only"] and cousin["split"] in "ab"
    assert run("check", room / "one").code == 0
    told = run("diff", room / "room.scene.yaml", room / "one" / "000001.scene.yaml").out
    assert "light key: intensity 0.9" in told and "table: color" in told
    other = run("cousins", recipe, "-n", "4", "-o", room / "one", "-j", "1", "--no-gallery", "--split", "a")
    assert other.code != 0 and "different run" in other.err


@pytest.mark.slow  # 2 s
def test_the_axes_of_a_cousin(room: Path, sampler: Sampler) -> None:
    """Evaluations pool the results of cousins by the axes along which they differ."""
    other = "object: {objects: {cabinet: {count: 1, changes: [appearance]}}}"
    for vary, more, axes in (
        ("light.*.intensity: {uniform: [0, 1]}", "", ["vary"]),
        ("object.can.mass: {range: estimate}", "", ["vary"]),
        ("cabinet.drawer: {uniform: [0.01, 0.1]}", "", ["vary"]),
        ("object.cabinet.friction: {times: [0.5, 2]}", "", ["vary"]),
        ("instruction: {choose: [Go., Run.]}", "", ["vary"]),
        ("object.cabinet.friction: {times: [0.5, 2]}", other, ["object", "vary"]),
        ("gravity: {times: [0.9, 1]}", "scene: {anchor: tee, objects: {brick: [LeftOf]}}", ["scene", "vary"]),
    ):
        make = sampler(vary, more, twin="away.task.yaml")
        one = next(c for c in map(make, range(1, 30)) if c.accepted)
        cousin = cousin_of(load_task(write(room, one)["task"]))
        assert cousin is not None and cousin["axes"] == axes, (vary, more)


@pytest.mark.slow  # 2 s
def test_a_preview_sheet(room: Path) -> None:
    recipe = room / "lit.cousins.yaml"
    recipe.write_text(
        "simfoundry: cousins/1\nname: lit\ntwin: room.scene.yaml\nvary: {object.table.color: {choose: [red, blue]}}\n"
    )
    line = ("cousins", recipe, "-n", "4", "-o", room / "one", "-j", "1", "--no-gallery")
    assert run(*line, "--preview", room / "sheet.png").code == 0
    assert "is an input of this command" in run(*line, "--preview", recipe).err
    with PillowImage.open(room / "sheet.png") as sheet:
        pixels = np.asarray(sheet.convert("RGB"), dtype=int)
    # The tables are 4 in a row below their captions: the twin's in the color of wood, the others red or blue.
    assert (
        pixels.shape[1] > 4 * 384
        and np.any(pixels[..., 2] - pixels[..., 0] > 80)
        and np.any(pixels[..., 0] - pixels[..., 1] > 80)
    )


@pytest.mark.slow  # 2 s
def test_a_stage_contains_the_poses_but_not_the_other_values(room: Path) -> None:
    from pxr import Usd

    recipe = room / "all.cousins.yaml"
    recipe.write_text(
        "simfoundry: cousins/1\nname: all\ntwin: room.scene.yaml\n"
        "vary: {object.cabinet.friction: {times: [0.5, 2]}, object.brick.pose: {shift: [0.02, 0.02, 0]}}\n"
        "object: {objects: {cabinet: {count: 2, changes: [appearance]}}}\n"
    )
    done = run(
        "cousins", recipe, "-n", "2", "-o", room / "out", "-j", "1", "--no-gallery", "--stage", room / "all.usda"
    )
    assert done.code == 0 and "the stage contains objects and poses, but no other values of `vary`" in done.err
    stage = Usd.Stage.Open(str(room / "all.usda"))
    variants = stage.GetPrimAtPath("/World").GetVariantSet("cousin")
    assert sorted(variants.GetVariantNames()) == ["c000001", "c000002", "twin"]
    variants.SetVariantSelection("c000001")
    chosen = stage.GetPrimAtPath("/World/Objects/cabinet").GetVariantSet("variant").GetVariantSelection()
    assert chosen.startswith("cabinet_")


def test_latency_and_noise_of_the_task(room: Path, sampler: Sampler) -> None:
    vary = """disturbances.action.latency: {uniform: [0.01, 0.05]}
        disturbances.action.joint_noise: {uniform: [0, 0.02]}
        disturbances.observation.image_latency: {choose: [0, 0.1]}
        disturbances.observation.exposure: {normal: 0.5}"""
    make = sampler(vary, twin="away.task.yaml")
    one = make(1)
    assert set(one.documents) == {"task"} and not one.pictures_only and one.accepted
    task = load_task(write(room, one)["task"])
    about = task.disturbances
    assert run("fmt", "--check", room / "out" / one.files()["task"]).code == 0
    assert about.action.latency == one.vary["disturbances.action.latency"] >= 0.01
    assert about.action.joint_noise == one.vary["disturbances.action.joint_noise"] > 0
    assert about.observation.exposure == one.vary["disturbances.observation.exposure"]
    assert -1.5 <= about.observation.exposure <= 1.5
    assert make(2).vary != one.vary
    seen = sampler("disturbances.observation.joint_noise: {log_uniform: [0.001, 0.01]}", twin="away.task.yaml")(1)
    assert seen.pictures_only  # what happens in the twin happens here, too; only the policy sees it differently
    with pytest.raises(SpecError, match=r"`disturbances\.action\.latency` is 0 in the twin, and `times` does not"):
        sampler("disturbances.action.latency: {times: [0.5, 2]}", twin="away.task.yaml")
    with pytest.raises(SpecError, match="the twin is a scene, which has no `disturbances`"):
        sampler("disturbances.action.latency: {uniform: [0, 0.1]}")
