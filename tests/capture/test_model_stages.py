"""Stages of a reconstruction ask the models that are configured, use their answers, and go on without them."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from PIL import Image

from simfoundry.assets.cache import Cache
from simfoundry.capture.frames.load import load_frame, open_capture
from simfoundry.capture.model_stages.ask import StageModels
from simfoundry.capture.model_stages.meshes import ObjectView, model_pose
from simfoundry.capture.outputs.overlay import object_surface
from simfoundry.capture.reconstruct import nearby_labels
from simfoundry.capture.segment.find_support import find_support
from simfoundry.capture.shapes.fit import FittedShape
from simfoundry.capture.stages.runner import StageRunner
from simfoundry.capture.synthesize import simulate_frame, synthesize, write_capture
from simfoundry.geometry.frames import Pose, look_at
from simfoundry.geometry.shapes import Mesh
from simfoundry.models.setup import ModelSetup
from simfoundry.models.tasks.masks import bounding_boxes
from simfoundry.models.tasks.poses import Z_UP
from simfoundry.render.raycast import raycast
from simfoundry.scene.lower import lower, lower_file
from simfoundry.scene.model import Scene
from simfoundry.scene.state import pose_spec
from simfoundry.spec.load import load, load_scene
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.base import Estimate
from simfoundry.spec.models.capture import CaptureSpec
from simfoundry.spec.models.model_sources import ModelSource
from simfoundry.spec.models.scene import ObjectSpec
from simfoundry.spec.yaml.write import to_yaml
from tests.capture.conftest import SCENE as BOXES
from tests.capture.runs import again, output, ran
from tests.models.stand_ins import SOLVED, Result, StandIns, configured

SCENE = """\
simfoundry: scene/1
name: two_things
objects:
  desk: {fixed: true, shape: {box: [0.9, 0.7, 0.03]}, color: [0.7, 0.55, 0.4], pose: {xyz: [0, 0, -0.015]}}
  chest:
    shape:
      compound:
        body: {shape: {box: [0.08, 0.08, 0.09]}, pose: {xyz: [0, 0, 0.045]}}
        lid: {shape: {box: [0.13, 0.13, 0.02]}, pose: {xyz: [0, 0, 0.1]}}
    mass: 0.2
    color: [0.2, 0.5, 0.25]
    pose: {xyz: [0.15, 0.12, 0], yaw_deg: 25}
  jam: {shape: {box: [0.05, 0.06, 0.05]}, mass: 0.2, color: [0.7, 0.1, 0.1], pose: {xyz: [0.01, 0.1, 0.025]}}
cameras:
  view: {size: [240, 180], fx: 229, fy: 229, pose: {xyz: [-0.55, 0.05, 0.5], look_at: [0.05, 0, 0.02]}}
lights: {key: {type: distant, direction: [0.5, -0.35, -1]}, sky: {type: dome, intensity: 0.45}}
"""
CHEST_KG = 0.31
NAMES = {"chest": "toy chest", "jam": "jar of jam"}


def glb_of_object(scene: Scene, name: str) -> bytes:
    """Return an object as a mesh model might: with y up, in a unit of its own."""
    import trimesh

    (item,) = (each for each in scene.objects if each.name == name)
    vertices, faces = object_surface(item)
    mesh = trimesh.Trimesh(3.7 * vertices @ Z_UP[:3, :3], faces, process=False)
    return bytes(mesh.export(file_type="glb"))


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, StandIns]:
    """A folder with a capture, and stand-ins that know the annotation of its picture."""
    tmp = tmp_path_factory.mktemp("models")
    (tmp / "two_things.scene.yaml").write_text(SCENE)
    scene = lower_file(tmp / "two_things.scene.yaml")
    synthesize(scene, scene.cameras[0], tmp / "capture", seed=0, masks=True)
    labels = np.array(Image.open(tmp / "capture" / "instances.png")).astype(np.int32)
    file = tmp / "capture" / "capture.yaml"
    data = yaml.safe_load(file.read_text())
    del data["frames"]["view"]["masks"]
    file.write_text(yaml.safe_dump(data))
    numbers = {item.name: k + 1 for k, item in enumerate(scene.objects)}
    labels[labels == numbers["desk"]] = 0
    names = {numbers[name]: phrase for name, phrase in NAMES.items()}
    stand_ins = StandIns(
        labels,
        names,
        (numbers["chest"],),
        {numbers[name]: glb_of_object(scene, name) for name in ("chest",)},
        masses={numbers["chest"]: CHEST_KG},
    )
    return tmp, stand_ins


@pytest.fixture
def capture(made: tuple[Path, StandIns], tmp_path: Path) -> tuple[Path, StandIns]:
    """A copy of :func:`made` that a test may change."""
    shutil.copytree(made[0], tmp_path / "copy")
    return tmp_path / "copy", replace(made[1], asked=[])


def recorded(folder: Path) -> ModelSetup:
    """A setup in which all answers are recorded ones."""
    source = ModelSource(recorded="answers")
    return ModelSetup(folder, dict.fromkeys(SOLVED, (source, "a test")))


@pytest.mark.slow  # 12 s: two runs with all stages
def test_a_capture_from_recorded_answers(capture: tuple[Path, StandIns]) -> None:
    folder, stand_ins = capture
    with configured(stand_ins, folder, record="answers") as setup:
        first = again(folder, setup=setup)
    assert set(stand_ins.asked) == set(SOLVED), "each task is asked for"
    before, asked = output(folder), len(stand_ins.asked)
    assert not ran(again(folder, setup=setup)), "answers are kept with their stages: the server is gone"
    shutil.rmtree(folder / "out")
    run = again(folder, setup=recorded(folder))
    assert output(folder) == before and len(stand_ins.asked) == asked
    assert run.findings == first.findings

    built, spec = run.reconstruction, run.reconstruction.spec
    assert set(built.names) == {"toy_chest", "jar_of_jam"}
    for k, name in stand_ins.names.items():
        found = built.segmentation.labels == built.names[name.replace(" ", "_")]
        assert np.array_equal(found, stand_ins.labels == k), "the masks are those of the model"
    assert run.report["removal"] == [["jar_of_jam"], ["toy_chest"]], "the jar stands in front of the chest"
    assert run.report["objects"]["toy_chest"]["candidates"]["used"] == "model"
    assert run.report["objects"]["jar_of_jam"]["candidates"]["used"] == "fitted"
    kept = {f"{name}_{source}.obj" for name in ("toy_chest", "jar_of_jam") for source in ("model", "fitted")}
    assert {p.name for p in (folder / "out" / "candidates").glob("*.obj")} == kept
    tasks = {name: tasks_of(item) for name, item in spec.objects.items()}
    assert tasks["jar_of_jam"] == ["complete_depth", "segment", "read_scene"]
    assert tasks["toy_chest"][:3] == ["complete_depth", "segment", "mesh"]
    assert tasks["toy_chest"][-3:] == ["read_scene", "parts", "articulate"]
    assert spec.origin is not None and [use.task for use in spec.origin.models][-2:] == ["inpaint", "splat"]

    scene = lower(load_scene(folder / "out" / "capture.scene.yaml"), Cache(folder / "cache"))
    (chest,) = (item for item in scene.objects if item.name == "toy_chest")
    assert [joint.name for joint in chest.joints] == ["lid"] and len(chest.links) == 2
    document = load(folder / "out" / (spec.objects["toy_chest"].asset or "")).spec
    assert isinstance(document, AssetSpec) and spec.objects["toy_chest"].mass is None
    masses = [link.mass for link in document.links.values() if isinstance(link.mass, Estimate)]
    assert [mass.source for mass in masses] == ["stand-in", "stand-in"]
    ends = np.sum([mass.range for mass in masses if mass.range is not None], axis=0)
    assert sum(link.mass for link in chest.links) == pytest.approx(CHEST_KG, rel=0.01)
    assert ends == pytest.approx([0.5 * CHEST_KG, 2 * CHEST_KG], rel=0.01), "a model's mass counts, with its range"
    vertices = chest.X_WO.apply(object_surface(chest)[0])
    assert np.allclose(np.ptp(vertices[:, 2]), 0.11, atol=0.006), "the scale of the mesh was found"
    assert scene.background is not None
    camera = scene.cameras[0]
    alone = raycast(replace(scene, objects=()), camera)
    image = np.array(Image.open(folder / "capture" / "color.png")).astype(float)
    seen = np.isfinite(alone.depth)
    assert seen.mean() > 0.1 and np.abs(alone.color[seen] - image[seen]).mean() < 25, "the background is in its place"


def tasks_of(item: ObjectSpec) -> list[str]:
    """The tasks of the models that made an object."""
    return [] if item.origin is None else [use.task for use in item.origin.models]


@pytest.mark.slow  # 3 s
def test_models_that_may_not_be_used_commercially_are_refused(capture: tuple[Path, StandIns]) -> None:
    folder, stand_ins = capture
    with configured(replace(stand_ins, commercial=False), folder) as setup:
        run = again(folder, setup=replace(setup, commercial_only=True))
    failed = [finding.message for finding in run.findings if finding.code == "SF640"]
    assert len(failed) == 6 and all("may not be used commercially" in message for message in failed)
    assert not any(tasks_of(item) for item in run.reconstruction.spec.objects.values())


@pytest.mark.slow  # 2 s
def test_a_person_states_joints_and_what_moves(folder: Path, made: tuple[Path, StandIns]) -> None:
    stand_ins = replace(made[1], asked=[])
    overrides = folder / "capture" / "overrides" / "objects.yaml"
    overrides.parent.mkdir()
    overrides.write_text("objects: {green_box: {joints: ['lid=2:revolute:back_bottom:top:70']}}\n")
    with configured(stand_ins, folder, "parts") as setup:
        run = again(folder, setup=setup)
    assert stand_ins.asked == ["parts"], "stated joints need no model"
    assert run.reconstruction.spec.objects["green_box"].asset == "articulated/green_box/green_box.asset.yaml"
    scene = lower(load_scene(run.scene_file), Cache(folder / "cache"))
    (lid,) = next(item for item in scene.objects if item.name == "green_box").joints
    assert (lid.name, lid.type.value) == ("lid", "revolute")
    overrides.write_text("objects: {green_box: {joints: ['lid=9:revolute:back_bottom:top:70']}}\n")
    with configured(stand_ins, folder, "parts") as setup:
        run = again(folder, setup=setup)
    (finding,) = [finding for finding in run.findings if finding.code == "SF602"]
    assert "there is no segment 9" in finding.message and finding.objects == ("green_box",)
    overrides.write_text("objects: {green_box: {moves: true}}\n")
    stand_ins.asked.clear()
    with configured(stand_ins, folder, "parts", "articulate") as setup:
        run = again(folder, setup=setup)
    assert stand_ins.asked == ["parts", "articulate"]
    assert tasks_of(run.reconstruction.spec.objects["green_box"]) == ["parts", "articulate"]
    assert not (folder / "out" / "meshes" / "green_box.obj").exists()


@pytest.mark.slow  # 4 s
def test_a_background_is_made_of_all_posed_frames_without_objects(made: tuple[Path, StandIns], tmp_path: Path) -> None:
    (tmp_path / "boxes.scene.yaml").write_text(BOXES)
    scene, shots = lower_file(tmp_path / "boxes.scene.yaml"), {}
    for k, y in enumerate((0.05, -0.15, 0.25)):
        camera = replace(scene.cameras[0], X_WC=look_at(np.array([-0.6, y, 0.6]), np.array([0.02, 0, 0.02])))
        frame = replace(simulate_frame(raycast(scene, camera), np.random.default_rng(k)), instances=None)
        shot = write_capture(tmp_path / "capture" / f"f{k}", frame)
        assert shot.depth is not None
        depth = shot.depth.model_copy(update={"image": f"f{k}/depth.png"})
        update = {"color": f"f{k}/color.png", "depth": depth, "pose": pose_spec(camera.X_WC)}
        shots[f"f{k}"] = shot.model_copy(update=update)
    spec = CaptureSpec(simfoundry="capture/1", name="posed", frames=shots)
    (tmp_path / "capture" / "capture.yaml").write_text(to_yaml(spec))
    stand_ins = replace(made[1], asked=[], trained=[])
    with configured(stand_ins, tmp_path, "splat") as setup:
        run = again(tmp_path, setup=setup)
    assert stand_ins.asked == ["splat"] and len(stand_ins.trained) == 3
    for k, image in enumerate(stand_ins.trained):
        before = np.array(Image.open(tmp_path / "capture" / f"f{k}" / "color.png")).astype(int)
        after = image.astype(int)
        for channel, other in ((0, 1), (1, 0)):  # the red box and the green one
            was, now = (picture[..., channel] - picture[..., other] > 60 - 40 * channel for picture in (before, after))
            assert was.sum() > 150 and now.sum() < 0.1 * was.sum(), (k, channel)
    assert run.reconstruction.spec.background is not None and (tmp_path / "out" / "background.ply").is_file()


@pytest.mark.slow  # 3 s
@pytest.mark.parametrize("tasks", [("segment",), ("segment", "read_scene")])
def test_masks_that_show_no_object_change_nothing(
    folder: Path, made: tuple[Path, StandIns], tasks: Sequence[str]
) -> None:
    file = folder / "capture" / "capture.yaml"
    data = yaml.safe_load(file.read_text())
    del data["frames"]["view"]["masks"]
    file.write_text(yaml.safe_dump(data))
    shape = (180, 240)
    column = np.arange(shape[1])[None].repeat(shape[0], axis=0)
    odd = {
        "none": np.zeros((0, *shape), bool),
        "all": np.ones((1, *shape), bool),
        "few": np.eye(*shape, dtype=bool)[None],
        "stripes": np.stack([column % 8 < 4, column % 8 >= 4]),
    }
    for masks in odd.values():

        def spoil(result: Result, masks: NDArray[np.bool_] = masks) -> None:
            scores, prompts = np.full(len(masks), 0.9, np.float32), np.zeros(len(masks), np.int32)
            boxes = bounding_boxes(masks)
            result.members.update({"masks": masks, "boxes": boxes, "scores": scores, "prompts": prompts})

        with configured(replace(made[1], spoil={"segment": spoil}), folder, *tasks) as setup:
            run = again(folder, setup=setup)
        assert set(run.reconstruction.names) == {"green_box", "red_box"}
        assert not [finding for finding in run.findings if finding.code == "SF640"]


@pytest.mark.slow  # 2 s
def test_the_pose_of_a_model_is_used_if_it_is_better(made: tuple[Path, StandIns]) -> None:
    folder, stand_ins = made
    frame = load_frame(open_capture(folder / "capture"))
    support = find_support(frame)
    (k,) = stand_ins.moving
    mesh = chest_mesh(lower_file(folder / "two_things.scene.yaml"))
    points = support.X_WC.apply(frame.points)[(stand_ins.labels == k) & np.isfinite(frame.depth)]
    wrong = Pose.of([*points.mean(axis=0)[:2] + 0.05, 0.0])
    shape = FittedShape(mesh, wrong, 0.01, 0.5, False)
    view = ObjectView(frame, support, stand_ins.labels, k, nearby_labels(stand_ins.labels, k), shape)
    with configured(stand_ins, folder, "pose") as setup:
        found = model_pose(view, StageModels(setup, StageRunner()))
    assert found is not None and found.value.is_better and found.value.cost < 0.6 * found.value.fitted_cost
    assert [use.task for use in found.models] == ["pose"]
    gaps = np.abs(found.value.shape.X_WO.apply(mesh.vertices)[:, 2].min())
    assert gaps < 0.01, "it stands on the support"


def chest_mesh(scene: Scene) -> Mesh:
    """The chest of the scene, with its origin below it."""
    (item,) = (each for each in scene.objects if each.name == "chest")
    vertices, faces = object_surface(item)
    return Mesh(vertices, faces)
