"""The tools for captures: the fit of poses, constraints of the decomposition, versions, and locks."""

from __future__ import annotations

import io
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simfoundry.capture.frames.load import load_frame
from simfoundry.capture.outputs.overlay import CaptureOverlay, object_surface
from simfoundry.capture.segment.decompose import decompose
from simfoundry.capture.segment.find_support import find_support
from simfoundry.capture.segment.masks import Labels
from simfoundry.capture.shapes.fit import FittedShape, fit_shape
from simfoundry.capture.shapes.register_mesh import pose_agreement, registered_pose
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Array, Pose, quat_from_rpy
from simfoundry.geometry.shapes import Box, Mesh, tessellate
from simfoundry.spec.load import load_capture, load_scene
from simfoundry.studio.acts.act import Act, ActError
from simfoundry.studio.acts.decomposition import CaptureFrame, IgnorePiece, MergePieces, SplitPiece, StateOcclusion
from simfoundry.studio.acts.move import MoveObject
from simfoundry.studio.acts.names import RenameSymbol
from simfoundry.studio.acts.properties import SetProperties
from simfoundry.studio.acts.refine import RefinePose, ScaleObject, nudged
from simfoundry.studio.acts.versions import TakeObjects, TakeShape
from simfoundry.studio.captures import NoCaptureError, find_capture, scene_overlay
from simfoundry.studio.session import StudioSession
from simfoundry.studio.versions import exported_versions, fresh_folder, reconstructions, save_version, version_files
from simfoundry.studio.view.panels.capture import error_colors
from tests.studio.captured import CAPTURE, write_project, yawed


class Project:
    """A project with a capture, opened in the studio."""

    def __init__(self, folder: Path) -> None:
        self.scene_file, self.capture_file, self.truth = write_project(folder)
        self.session = StudioSession(self.scene_file)
        self.before = self.session.text

    @property
    def source(self) -> CaptureFrame:
        return CaptureFrame(self.capture_file, "view")

    @property
    def overlay(self) -> CaptureOverlay:
        assert self.session.scene is not None
        return scene_overlay(self.session.scene, find_capture(self.session.scene, self.session.root))

    def changed(self, act: Act) -> list[str]:
        """The lines of the scene that an act writes; undo then restores every byte of all texts."""
        before = dict(self.session.texts)
        self.session.apply(act)
        lines = [line for line in self.session.text.splitlines() if line not in self.before.splitlines()]
        assert self.session.undo() == act.label
        assert {path: self.session.texts[path] for path in before} == before
        self.session.redo()
        return lines


@pytest.fixture
def project(tmp_path: Path) -> Project:
    return Project(tmp_path)


# -- the overlay and the fit


def test_the_cloud_lies_on_the_objects(project: Project) -> None:
    overlay = project.overlay
    points, colors, numbers = overlay.cloud()
    assert len(points) == len(colors) == len(numbers) == np.isfinite(overlay.frame.depth).sum()
    assert abs(np.median(points[numbers == 0][:, 2])) < 0.002  # the table
    top = points[numbers == 1][:, 2]
    assert 0.118 < np.quantile(top, 0.98) < 0.124
    assert len(overlay.cloud(0.1)[0]) == pytest.approx(len(points) / 10, rel=0.01)
    scene = project.session.scene
    assert scene is not None
    found = pose_agreement(
        overlay.evidence(1, 0.0),  # type: ignore[arg-type]
        object_surface(scene.objects["carton"]),
        scene.objects["carton"].X_WO,
    )
    assert found.fit < 0.001 and found.explained > 0.99
    assert overlay.evidence(7, 0.0) is None


def test_points_are_colored_by_their_distance_from_their_object(project: Project) -> None:
    scene, overlay = project.session.scene, project.overlay
    assert scene is not None
    numbers = overlay.cloud()[2]
    vertices, faces = object_surface(scene.objects["carton"])

    def errors(offset: tuple[float, float, float]) -> Array:
        X_WO = yawed(scene.objects["carton"].X_WO, offset, 0.0)
        return overlay.errors({1: (X_WO.apply(vertices), faces)})

    good, far = errors((0.0, 0.0, 0.0)), errors((0.5, 0.0, 0.0))
    assert np.array_equal(np.isnan(good), numbers != 1) and np.isinf(far[numbers == 1]).all()
    assert np.median(good[numbers == 1]) < 0.001
    is_top = (numbers == 1) & (overlay.cloud()[0][:, 2] > 0.118)
    assert np.median(errors((0.0, 0.0, 0.004))[is_top]) == pytest.approx(0.004, abs=5e-4)
    colors = error_colors(np.array([0.0, 0.005, 0.01, 0.5, np.inf, np.nan]))
    assert colors[0].tolist() == [0, 160, 60] and colors[1].tolist() == [250, 200, 0]
    assert colors[2].tolist() == colors[3].tolist() == colors[4].tolist() == [220, 0, 30]
    assert colors[5].tolist() == [150, 150, 150]


def test_a_pixel_is_found_inside_an_object_and_on_a_ray(project: Project) -> None:
    overlay = project.overlay
    for k in (1, 2):
        pixel = overlay.pixel_of(k)
        assert pixel is not None and overlay.labels[pixel[1], pixel[0]] == k
        point = overlay.points_W[pixel[1], pixel[0]]
        found = overlay.pixel_on_ray(overlay.X_WC.p, point - overlay.X_WC.p)
        assert found is not None and max(abs(found[0] - pixel[0]), abs(found[1] - pixel[1])) <= 2
    assert overlay.pixel_of(9) is None
    assert overlay.pixel_on_ray(overlay.X_WC.p, np.array([0.0, 0.0, 1.0])) is None


def test_a_registration_returns_to_the_pose_from_which_the_picture_was_taken(project: Project) -> None:
    scene, overlay = project.session.scene, project.overlay
    assert scene is not None
    item, evidence = scene.objects["carton"], overlay.evidence(1, 0.0)
    assert evidence is not None
    wrong = yawed(item.X_WO, (0.012, -0.009, 0.004), 0.15)
    found = registered_pose(evidence, object_surface(item), wrong)
    assert np.linalg.norm(found.p - item.X_WO.p) < 0.001 and found.angle_to(item.X_WO) < np.radians(0.5)
    again = registered_pose(evidence, object_surface(item), item.X_WO)
    assert np.linalg.norm(again.p - item.X_WO.p) < 0.001


def test_a_refined_pose_is_written_with_its_fit(project: Project) -> None:
    scene = project.session.scene
    assert scene is not None
    evidence = project.overlay.evidence(1, 0.0)
    X_WO = yawed(scene.objects["carton"].X_WO, (0.006, 0.0, 0.0), 0.0)
    pose, origin = project.changed(RefinePose("carton", X_WO, evidence))
    assert pose == "    pose: {xyz: [0.086, 0.02, 0.06], yaw_deg: 28.65}"
    assert origin.startswith("    origin: {capture: desk, fit_error: 0.00") and "confidence" not in origin
    error = float(origin.split("fit_error: ")[1].split(",")[0])
    assert 0.002 < error < 0.006  # the long side is moved by 6 mm cos 28.65° from its points
    lines = project.changed(RefinePose("tin", yawed(scene.objects["tin"].X_WO, (0.0, 0.001, 0.0), 0.0)))
    assert not any("segment: 2" in line for line in lines)  # without evidence, nothing is said about the fit


def test_steps_follow_the_chosen_axes() -> None:
    X_WO, R_WA = Pose.of((1.0, 2.0, 3.0), quat_from_rpy(0.2, -0.4, 1.1)), Pose.of(q=quat_from_rpy(-0.7, 0.3, 2.0))
    middle, zero = np.array([1.1, 1.9, 3.3]), np.zeros(3)
    moved = nudged(X_WO, R_WA.rotation, middle, np.array([0.0, 0.01, 0.0]), zero)
    np.testing.assert_allclose(moved.p - X_WO.p, 0.01 * R_WA.rotation[:, 1], atol=1e-12)
    assert moved.angle_to(X_WO) < 1e-9
    turned = nudged(X_WO, R_WA.rotation, middle, zero, np.array([0.0, 0.0, 0.3]))
    np.testing.assert_allclose(turned.apply(X_WO.inverse().apply(middle)), middle, atol=1e-12)
    axis = R_WA.rotation[:, 2]
    np.testing.assert_allclose((turned @ X_WO.inverse()).rotation, Pose.about(axis, 0.3).rotation, atol=1e-12)


def test_a_scaled_object_keeps_its_base(project: Project) -> None:
    assert project.changed(ScaleObject("tin", 1.1)) == [
        "    shape: {box: [0.066, 0.099, 0.088]}",
        "    pose: {xyz: [-0.08, -0.06, 0.044], yaw_deg: -17.19}",
    ]
    for factor in (0.0, -1.0, float("nan")):
        with pytest.raises(ActError, match="greater than zero"):
            project.session.apply(ScaleObject("tin", factor))


# -- finding the capture


def test_a_scene_without_its_capture_says_what_is_missing(project: Project) -> None:
    scene, root = project.session.scene, project.session.root
    assert scene is not None
    assert find_capture(scene, root) == project.source
    segments = project.scene_file.with_name("segments.png")
    data = segments.read_bytes()
    segments.write_bytes(data[:50])
    with pytest.raises(SimfoundryError, match="is not an image of objects' numbers"):
        scene_overlay(scene, project.source)
    segments.unlink()
    with pytest.raises(SimfoundryError, match="run `simfoundry capture` again"):
        scene_overlay(scene, project.source)
    project.capture_file.write_text(CAPTURE.replace("fx: 290", "fx: 295"))
    with pytest.raises(NoCaptureError, match="no camera with fx = 295"):
        scene_overlay(scene, project.source)
    project.capture_file.write_text(CAPTURE.replace("name: desk", "name: shelf"))
    with pytest.raises(NoCaptureError, match=r"no capture below .* is called `desk`"):
        find_capture(scene, root)
    with pytest.raises(NoCaptureError, match="is not `desk`"):
        find_capture(scene, root, project.capture_file)


# -- the decomposition


def constraints(project: Project) -> str:
    """The text of the capture in the studio, after its fixed part."""
    text = project.session.texts[project.capture_file]
    assert text.startswith(CAPTURE)
    return text.removeprefix(CAPTURE)


def test_merged_objects_are_one_piece_in_the_capture(project: Project) -> None:
    assert project.changed(MergePieces(project.source, {"carton": (150, 90), "tin": (120, 140)})) == []
    assert constraints(project) == "    decomposition: {pieces: {carton: [[150, 90], [120, 140]]}}\n"
    assert "captures/desk/capture.yaml" in project.session.diff()
    assert project.capture_file.read_text() == CAPTURE
    project.session.save()
    assert project.capture_file.read_text() == project.session.texts[project.capture_file]


def test_split_objects_are_found_by_the_next_reconstruction(project: Project) -> None:
    overlay, truth = project.overlay, project.truth
    project.session.apply(MergePieces(project.source, {"carton": pixel(overlay, 1), "tin": pixel(overlay, 2)}))
    project.session.save()
    found = segmented(project)
    assert found == {"carton": {1, 2}}
    parts = {"carton": (pixel(overlay, 1),), "lid": (pixel(overlay, 2),)}
    project.session.apply(SplitPiece(project.source, "carton", parts))
    project.session.save()
    assert segmented(project) == {"carton": {1}, "lid": {2}}
    project.session.apply(IgnorePiece(project.source, "lid", pixel(overlay, 2)))
    project.session.save()
    assert segmented(project) == {"carton": {1}}
    assert [project.session.undo() for _ in range(3)] == [
        "ignore lid in the capture",
        "split carton",
        "merge carton and tin",
    ]
    project.session.save()
    assert project.capture_file.read_bytes() == CAPTURE.encode()
    assert truth.max() == 2


def pixel(overlay: CaptureOverlay, k: int) -> tuple[int, int]:
    found = overlay.pixel_of(k)
    assert found is not None
    return found


def segmented(project: Project) -> dict[str, set[int]]:
    """The true objects that each named piece covers, in a segmentation of the saved capture."""
    frame = load_frame(load_capture(project.capture_file))
    found = decompose(frame, find_support(frame))
    truth: Labels = project.truth
    return {
        name: {k for k in (1, 2) if (found.labels[truth == k] == number).mean() > 0.8}
        for name, number in found.pieces.items()
    }


def test_occlusions_are_stated_and_withdrawn(project: Project) -> None:
    front, behind = ("tin", (120, 140)), ("carton", (150, 90))
    project.session.apply(StateOcclusion(project.source, front, behind))
    stated = "    decomposition: {pieces: {tin: [[120, 140]], carton: [[150, 90]]}, occludes: {tin: [carton]}}\n"
    assert constraints(project) == stated
    project.session.apply(StateOcclusion(project.source, front, behind, holds=False))
    assert "occludes" not in constraints(project)
    project.session.undo()
    project.session.apply(MergePieces(project.source, {"tin": (120, 140), "carton": (150, 90)}))
    assert constraints(project) == "    decomposition: {pieces: {tin: [[120, 140], [150, 90]]}}\n"


def test_constraints_that_are_not_possible_change_nothing(project: Project, tmp_path: Path) -> None:
    for act, message in (
        (MergePieces(project.source, {"tin": (1, 1)}), "at least two objects"),
        (SplitPiece(project.source, "tin", {"tin": ((1, 1),)}), "mark at least one point"),
        (MergePieces(project.source, {"Tin": (1, 1), "carton": (2, 2)}), "the capture cannot state this"),
        (StateOcclusion(project.source, ("tin", (1, 1)), ("tin", (1, 1))), "cannot occlude itself"),
        (MergePieces(CaptureFrame(project.capture_file, "left"), {"tin": (1, 1), "carton": (2, 2)}), "no frame `left`"),
    ):
        with pytest.raises(ActError, match=message):
            project.session.apply(act)
    project.capture_file.write_text("simfoundry: capture/1\n")
    with pytest.raises(ActError, match=r"capture\.yaml cannot be edited"):
        project.session.apply(MergePieces(project.source, {"tin": (1, 1), "carton": (2, 2)}))
    outside = tmp_path.parent / f"{tmp_path.name}_other" / "capture.yaml"
    outside.parent.mkdir()
    outside.write_text(CAPTURE)
    for name in ("color.png", "depth.png"):
        outside.with_name(name).write_bytes(project.capture_file.with_name(name).read_bytes())
    with pytest.raises(SimfoundryError, match="outside of the project"):
        project.session.apply(MergePieces(CaptureFrame(outside, "view"), {"tin": (1, 1), "carton": (2, 2)}))
    assert project.session.text == project.before and project.session.history.labels == ()


# -- locks


def test_no_act_changes_a_locked_object(project: Project) -> None:
    project.session.locked = frozenset({"tin"})
    scene = project.session.scene
    assert scene is not None
    X_WO = yawed(scene.objects["tin"].X_WO, (0.01, 0.0, 0.0), 0.0)
    for act in (MoveObject("tin", X_WO), SetProperties("tin", {"mass": 1.0}), RenameSymbol("objects.tin", "can")):
        with pytest.raises(ActError, match="`tin` is locked"):
            project.session.apply(act)
    assert project.session.text == project.before
    project.session.apply(SetProperties("carton", {"mass": 1.0}))
    project.session.locked = frozenset()
    project.session.apply(SetProperties("tin", {"mass": 1.0}))


# -- versions


def test_each_version_is_a_file_of_its_own(project: Project) -> None:
    session, path = project.session, project.scene_file
    first = save_version(path, session.text, session.root)
    session.apply(SetProperties("tin", {"mass": 1.0}))
    second = save_version(path, session.text, session.root)
    assert [p.name for p in (first, second)] == ["desk.v1.scene.yaml", "desk.v2.scene.yaml"]
    assert first.read_text() == project.before != second.read_text() == session.text
    again = fresh_folder(path.parent)
    assert again.name == "desk_2"
    again.mkdir()
    (again / path.name).write_text(project.before)
    assert version_files(path) == [again / path.name, first, second]
    assert version_files(second) == [again / path.name, path, first]
    with pytest.raises(SimfoundryError, match="outside of the project"):
        save_version(path, session.text, path.parent / "other")
    exported = exported_versions(path, session.root)
    assert exported == exported_versions(path, session.root)
    names = zipfile.ZipFile(io.BytesIO(exported)).namelist()
    beside = [f"build/desk/desk{version}.scene.yaml" for version in ("", ".v1", ".v2")]
    assert names == [*beside, "build/desk_2/desk.scene.yaml"]


def test_other_reconstructions_of_the_capture_are_found(project: Project) -> None:
    path, root = project.session.path, project.session.root
    other = root / "elsewhere" / "other.scene.yaml"
    other.parent.mkdir()
    other.write_text(path.read_text())
    save_version(path, path.read_text(), root)
    (root / "plain.scene.yaml").write_text("simfoundry: scene/1\nname: plain\norigin: {capture: desktop}\n")
    assert reconstructions(path, root, ["desk"]) == [other]  # neither versions, nor those of other captures
    assert reconstructions(path, root, []) == []


def test_objects_are_taken_from_another_version(project: Project) -> None:
    folder = project.scene_file.with_name("run")
    folder.mkdir()
    version = folder / "desk.scene.yaml"
    text = project.before.replace("box: [0.06, 0.09, 0.08]", "sphere: 0.04").replace("  tin:\n", "  jar:\n")
    mesh = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (folder / "carton.obj").write_text(mesh)
    text = text.replace("OnTop(tin,", "OnTop(jar,").replace("shape: {box: [0.08, 0.16, 0.12]}", "asset: carton.obj")
    version.write_text(text)
    document = load_scene(version).document
    assert document is not None
    lines = project.changed(TakeObjects(version, document.data, ("carton",)))
    assert lines == ["    asset: run/carton.obj", "    origin: {capture: desk, fit_error: 0.0013, confidence: 0.9}"]
    project.session.undo()
    project.session.apply(TakeObjects(version, document.data))
    here = text.replace("asset: carton.obj", "asset: run/carton.obj")
    for k in (1, 2):  # the numbers of another folder mean nothing here
        here = here.replace(f", segment: {k}", "")
    assert project.session.text == here
    with pytest.raises(ActError, match="has no object `pot`"):
        project.session.apply(TakeObjects(version, document.data, ("pot",)))


def test_another_shape_is_taken_with_its_fit(project: Project) -> None:
    overlay = project.overlay
    frame = overlay.frame
    shape = fit_shape(frame, replace(find_support(frame), X_WC=overlay.X_WC), overlay.labels == 2, 0.0)
    assert isinstance(shape.geometry, Box)
    lines = project.changed(TakeShape("tin", shape, (0.5, 0.5012, 0.5)))
    assert lines[0].startswith("    shape: {box: [0.0") and "    color: [0.5, 0.501, 0.5]" in lines
    scene = project.session.scene
    assert scene is not None
    np.testing.assert_allclose(scene.objects["tin"].X_WO.p, (-0.08, -0.06, 0.04), atol=0.003)
    lump = FittedShape(object_mesh(), shape.X_WO, 0.001, 0.5, False)
    with pytest.raises(ActError, match="mesh without a file"):
        project.session.apply(TakeShape("tin", lump, (0.5, 0.5, 0.5)))


def object_mesh() -> Mesh:
    return tessellate(Box(np.array([0.1, 0.1, 0.1])))
