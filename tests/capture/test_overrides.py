"""A person's corrections survive new runs: masks, names, poses, meshes, and edits of the scene."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from simfoundry.capture.description.naming import final_names, kept_names
from simfoundry.capture.inputs import examine
from simfoundry.capture.outputs.mask_files import mask_image, palette, read_mask_names, read_masks
from simfoundry.capture.outputs.scene_merge import merge_scene
from simfoundry.capture.pipeline import _other_names
from simfoundry.capture.run import CaptureRun
from simfoundry.capture.statements.overrides import ObjectOverride, Overrides
from simfoundry.errors import OutputError, SimfoundryError
from simfoundry.scene.lower import lower_file
from simfoundry.scene.object_shapes import bounds
from simfoundry.spec.diagnostics import SpecError
from tests.capture.runs import again, output, ran

CUBE = "v 0 0 0\nv .1 0 0\nv .1 .1 0\nv 0 .1 0\nv 0 0 .09\nv .1 0 .09\nv .1 .1 .09\nv 0 .1 .09\n" + "".join(
    f"f {face}\n" for face in ("4 3 2 1", "5 6 7 8", "1 2 6 5", "2 3 7 6", "3 4 8 7", "4 1 5 8")
)


def masks_of(folder: Path) -> NDArray[np.int32]:
    return read_masks(folder / "out" / "masks.png", (180, 240))


def number(folder: Path, name: str) -> int:
    return int(json.loads((folder / "out" / "report.json").read_text())["objects"][name]["segment"])


def state(folder: Path, stage: str, name: str = "") -> str:
    return next(s.state for s in examine(folder / "out") if (s.stage, s.object) == (stage, name))


# -- masks and names ----------------------------------------------------------------------------------------------


@pytest.mark.slow  # 2 s
def test_edited_masks_and_names_are_kept_and_touch_only_their_object(folder: Path) -> None:
    red, masks = number(folder, "red_box"), masks_of(folder)
    rows, _ = np.nonzero(masks == red)
    masks[(masks == red) & (np.arange(180)[:, None] < np.quantile(rows, 0.2))] = 0
    colors = Image.fromarray(palette()[masks])  # as a program that knows no palettes would save it
    colors.save(folder / "out" / "masks.png")
    names = folder / "out" / "masks.yaml"
    names.write_text(names.read_text().replace("red_box", "jam"))
    edits = {name: (folder / "out" / name).read_bytes() for name in ("masks.png", "masks.yaml")}
    assert state(folder, "segment") == "stale" and state(folder, "shape", "green_box") == "cached"
    run = again(folder)
    assert set(run.reconstruction.shapes) == {"green_box", "jam"}
    assert {key for key in ran(run) if key[0] == "shape"} == {("shape", str(red))}
    for _ in range(2):
        assert {name: (folder / "out" / name).read_bytes() for name in edits} == edits
        assert run.report["edited"] == ["masks.png", "masks.yaml"]
        assert state(folder, "segment") == state(folder, "name") == "overridden"
        run = again(folder)
        assert ran(run) == set()
    for name in edits:
        (folder / "out" / name).unlink()
    assert set(again(folder).reconstruction.shapes) == {"green_box", "red_box"}, "deleting the files undoes the edits"


@pytest.mark.slow  # 2 s: several runs
def test_a_run_after_an_edit_writes_what_a_run_from_scratch_does(folder: Path) -> None:
    red, masks = number(folder, "red_box"), masks_of(folder)
    rows, _ = np.nonzero(masks == red)
    masks[(masks == red) & (np.arange(180)[:, None] < np.quantile(rows, 0.2))] = 0
    (folder / "out" / "masks.png").write_bytes(mask_image(masks))
    assert {key for key in ran(again(folder)) if key[0] == "shape"} == {("shape", str(red))}
    other = folder / "other"
    shutil.copytree(folder / "capture", other / "capture")
    for name in ("masks.png", "masks.yaml"):
        (other / "capture" / "overrides").mkdir(exist_ok=True)
        shutil.copy(folder / "out" / name, other / "capture" / "overrides" / name)
    again(other)
    written = [output(folder), output(other)]
    reports = [json.loads(files.pop("out/report.json")) for files in written]
    assert written[0] == written[1]
    for report in reports:
        report.pop("edited")
    assert reports[0] == reports[1]


@pytest.mark.slow  # 2 s: several runs
def test_masks_beside_the_capture_split_and_remove(folder: Path) -> None:
    red, green, masks = number(folder, "red_box"), number(folder, "green_box"), masks_of(folder)
    masks[masks == red] = 0
    masks[masks == green] = 7
    overrides = folder / "capture" / "overrides"
    overrides.mkdir()
    Image.fromarray(masks.astype(np.uint8)).save(overrides / "masks.png")
    (overrides / "masks.yaml").write_text("names: {tea: 7}\n")
    run = again(folder)
    assert list(run.reconstruction.shapes) == ["tea"] and run.reconstruction.names == {"tea": 1}


@pytest.mark.slow  # 2 s: several runs
def test_masks_that_cannot_be_used_are_errors(folder: Path) -> None:
    file = folder / "out" / "masks.png"
    before = output(folder)
    pixels = palette()[masks_of(folder)]
    pixels[90, 100] = (1, 2, 3)
    Image.fromarray(pixels).save(file)
    with pytest.raises(SimfoundryError, match=r"color #010203 at the pixel \[100, 90\], which stands for no object"):
        again(folder)
    Image.fromarray(pixels[:100]).save(file)
    with pytest.raises(SimfoundryError, match="240 x 100 pixels, but the color image has 240 x 180"):
        again(folder)
    file.write_bytes(b"paint")
    with pytest.raises(SimfoundryError, match="could not be read as an image of masks"):
        again(folder)
    (folder / "out" / "masks.yaml").write_text("names: {Red: 0}\n")
    file.write_bytes(before["out/masks.png"])
    with pytest.raises(SpecError, match=r"masks\.yaml"):
        again(folder)
    file.with_suffix(".yaml").write_bytes(before["out/masks.yaml"])
    assert output(folder) == before


def test_masks_are_read_as_they_were_written(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for most in (3, 199):
        labels = rng.integers(0, most + 1, (30, 40)).astype(np.int32)
        labels[0, 0] = most
        (tmp_path / "m.png").write_bytes(mask_image(labels))
        assert np.array_equal(read_masks(tmp_path / "m.png", (30, 40)), labels)
    assert len(np.unique(palette(), axis=0)) == 256
    (tmp_path / "m.png").write_bytes(mask_image(np.arange(1200, dtype=np.int32).reshape(30, 40)))
    with pytest.raises(SimfoundryError, match="contains 1199 objects; at most 200"):
        read_masks(tmp_path / "m.png", (30, 40))


def test_taken_names_are_findings_and_empty_files_state_nothing(tmp_path: Path) -> None:
    (tmp_path / "masks.yaml").write_text("# nothing\n")
    assert read_mask_names(tmp_path / "masks.yaml") == {}
    overrides = Overrides(objects={"red_box": ObjectOverride(name="table"), "can": ObjectOverride(name="mug")})
    found = {1: "red_box", 2: "can"}
    (finding,) = _other_names(final_names(found, {}, {}, overrides), found, overrides)
    assert finding.objects == ("table_2",) and "the name `table` is taken" in finding.message


def test_names_are_kept_by_overlap() -> None:
    last, labels = np.zeros((40, 60), np.int32), np.zeros((40, 60), np.int32)
    last[5:15, 5:15], last[5:15, 30:40], last[25:35, 5:15] = 1, 2, 3
    labels[5:15, 6:16], labels[5:15, 37:47], labels[25:35, 5:15] = 4, 5, 6
    names = {"red_box_2": 1, "blue_can": 2, "mug": 3}
    found = {4: "red_box", 5: "blue_can", 6: "white_bowl"}
    assert kept_names(labels, last, names, found) == {4: "red_box_2"}, "5 has moved, 6 is something else"
    assert kept_names(labels[:20], last, names, found) == {}


# -- statements about objects -------------------------------------------------------------------------------------


@pytest.mark.slow  # 1 s
def test_names_poses_and_meshes_are_taken_as_stated(folder: Path) -> None:
    overrides = folder / "capture" / "overrides"
    overrides.mkdir()
    (overrides / "cube.obj").write_text(CUBE)
    (overrides / "objects.yaml").write_text(
        "objects:\n  red_box: {name: jam, mesh: cube.obj}\n  green_box: {pose: {xyz: [0.1, 0.2, 0.05], yaw_deg: 20}}\n"
        "  blue_box: {name: x}\n"
    )
    run = again(folder)
    (finding,) = run.findings
    assert finding.code == "SF602" and "the override of `blue_box` was not used" in finding.message
    assert run.report["passed"] is False
    scene = lower_file(run.scene_file)
    green = scene.object("green_box").X_WO
    assert np.abs(np.asarray(green.p)[:2] - (0.1, 0.2)).max() < 0.002
    assert np.degrees(2 * np.arctan2(green.q[3], green.q[0])) == pytest.approx(20, abs=0.5)
    low, high = bounds(scene.object("jam"))
    assert (high - low).tolist() == pytest.approx([0.1, 0.1, 0.09], abs=1e-4)
    assert ("pose", "1") in ran(run) and ("pose", "2") in ran(run)
    assert {s.state for s in examine(folder / "out") if s.stage == "pose"} == {"overridden"}
    assert ran(again(folder)) == set(), "the second run goes by the same names"
    (overrides / "objects.yaml").write_text("objects: {red_box: {mesh: none.obj}}\n")
    with pytest.raises(SimfoundryError, match=r"names the mesh none\.obj, which could not be read"):
        again(folder)
    (overrides / "objects.yaml").write_text("objects: {red_box: {pos: 3}}\n")
    with pytest.raises(SpecError, match=r"objects\.yaml:1"):
        again(folder)


# -- edits of the scene -------------------------------------------------------------------------------------------


def edited(folder: Path, old: str, new: str) -> CaptureRun:
    scene = folder / "out" / "capture.scene.yaml"
    text = scene.read_text()
    assert text.count(old) >= 1
    scene.write_text(text.replace(old, new))
    return again(folder)


@pytest.mark.slow  # 1 s
def test_an_edited_scene_is_merged(folder: Path) -> None:
    scene = folder / "out" / "capture.scene.yaml"
    scene.write_text(re.sub(r"(?<!meshes/)red_box", "jam", scene.read_text()))
    run = again(folder)
    text = run.scene_file.read_text()
    assert "jam:" in text and "red_box:" not in text and run.findings == ()
    assert run.report["edited"] == ["capture.scene.yaml"] and set(run.report["objects"]) == {"green_box"}
    (folder / "out" / "pick.task.yaml").write_text("mine")
    masks = masks_of(folder)
    green = number(folder, "green_box")
    rows, _ = np.nonzero(masks == green)
    masks[(masks == green) & (np.arange(180)[:, None] < np.quantile(rows, 0.3))] = 0
    Image.fromarray(masks.astype(np.uint8)).save(folder / "out" / "masks.png")
    run = again(folder)
    new = run.scene_file.read_text()
    assert "jam:" in new and "red_box:" not in new and new != text, "both the edit and the new shape are there"
    assert (folder / "out" / "pick.task.yaml").read_text() == "mine"
    lower_file(run.scene_file)


@pytest.mark.slow  # 2 s: several runs
def test_a_contradicted_edit_wins_and_is_a_finding(folder: Path) -> None:
    text = (folder / "out" / "capture.scene.yaml").read_text()
    mass = text.partition("green_box:")[2].partition("mass: ")[2].partition("\n")[0]
    run = edited(folder, f"mass: {mass}", "mass: 0.321")
    assert run.findings == () and "mass: 0.321" in run.scene_file.read_text()
    masks = masks_of(folder)
    green = number(folder, "green_box")
    rows, _ = np.nonzero(masks == green)
    masks[(masks == green) & (np.arange(180)[:, None] < np.quantile(rows, 0.3))] = 0
    Image.fromarray(masks.astype(np.uint8)).save(folder / "out" / "masks.png")
    run = again(folder)
    assert "mass: 0.321" in run.scene_file.read_text()
    (finding,) = (f for f in run.findings if f.code != "SF625")  # that part of the box belongs to no object now
    assert finding.code == "SF604" and "objects.green_box.mass" in finding.message
    assert lower_file(run.scene_file).object("green_box").links[0].mass == pytest.approx(0.321)


@pytest.mark.slow  # 2 s: several runs
def test_edits_that_cannot_be_merged_are_not_lost(folder: Path) -> None:
    scene = folder / "out" / "capture.scene.yaml"
    good = scene.read_text()
    scene.write_text(good + "\n  - : [")
    with pytest.raises(SimfoundryError, match="cannot be merged into the new reconstruction"):
        again(folder)
    scene.write_text(good + "# mine\n")
    shutil.rmtree(folder / "out" / "stages")
    with pytest.raises(OutputError, match=r"edited since they were generated \(capture.scene.yaml\)"):
        again(folder)
    assert scene.read_text() == good + "# mine\n"
    scene.write_text(good)
    (folder / "out" / "meshes" / "green_box.obj").write_text(CUBE)
    with pytest.raises(OutputError, match=r"\(meshes/green_box.obj\); state corrections in overrides/objects.yaml"):
        again(folder)
    assert again(folder, force=True).findings == ()


def test_merging_without_an_edit_gives_the_new_text() -> None:
    old, new = "simfoundry: scene/1\nname: a\n", "simfoundry: scene/1\nname: b\n"
    assert merge_scene(Path("a.scene.yaml"), old, old, new).text == new
    assert merge_scene(Path("a.scene.yaml"), None, None, new).text == new
