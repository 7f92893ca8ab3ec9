"""The tools for captures in a real browser: each test acts as a person would, and asserts the texts."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simfoundry.geometry.frames import Pose
from simfoundry.studio.acts.background import background_similarity
from simfoundry.studio.view.contents import CloudContent
from tests.studio.browser import StudioPage
from tests.studio.captured import CAPTURE, write_project
from tests.studio.conftest import SCENE, OpenStudio
from tests.studio.test_background import BACKGROUND, ROOM, floor_splat

pytestmark = pytest.mark.slow

# Milliseconds in which a control may be pressed. A software renderer draws clouds slowly on a busy machine, and a
# control is pressed only between two frames.
PATIENCE_MS = 120_000


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A scene that was reconstructed from a capture."""
    return write_project(tmp_path)[0]


def opened(open_studio: OpenStudio, path: Path) -> StudioPage:
    """The studio, with the tools for captures in front."""
    studio = open_studio(path)
    studio.page.set_default_timeout(PATIENCE_MS)
    studio.until(lambda: "/capture/cloud" in studio.server.window.canvas.nodes, "the cloud")
    studio.tab("Capture")
    return studio


def select(studio: StudioPage, name: str) -> None:
    studio.server.window.select(f"objects.{name}")
    studio.until(lambda: f"/objects/{name}/selection" in studio.server.window.canvas.nodes)


def test_a_pose_is_refined_by_keys_with_its_fit_and_snapped(scene: Path, open_studio: OpenStudio) -> None:
    studio = opened(open_studio, scene)
    before = studio.text
    select(studio, "carton")
    fit = studio.page.get_by_text("fit error", exact=False).first
    studio.until(lambda: "0.1" in fit.inner_text(), "the fit")
    studio.page.evaluate("document.activeElement.blur()")  # so that keys reach the view
    for _ in range(5):
        studio.page.keyboard.press("l")
    studio.until(lambda: "xyz: [0.085, 0.02, 0.06], yaw_deg: 28.65" in studio.text, "the steps")
    studio.page.keyboard.press("Shift+o")
    studio.until(lambda: "xyz: [0.085, 0.02, 0.06], yaw_deg: 29.65" in studio.text, "the turn")
    studio.until(lambda: "0.1" not in fit.inner_text(), "a worse fit")
    studio.press("Snap to best fit")
    studio.until(lambda: "xyz: [0.08, " in studio.text or "xyz: [0.0799, " in studio.text, "the registration")
    studio.until(lambda: "0.1" in fit.inner_text(), "a better fit")
    for _ in range(7):
        studio.press("Undo")
    studio.until(lambda: studio.text == before, "undoing all")
    assert studio.problems == []


def drag_arrow(studio: StudioPage, X_WO: Pose, by: tuple[float, float]) -> None:
    """Drag the red arrow of the gizmo at a pose by a distance on the screen [px]."""
    tip = studio.screen_point(tuple(X_WO.apply(np.array([0.8 * studio.server.window.gizmo.size, 0, 0])).tolist()))
    studio.drag(tip, (tip[0] + by[0], tip[1] + by[1]))


def test_a_gizmo_drag_on_the_cloud_refines_the_pose_with_its_fit(scene: Path, open_studio: OpenStudio) -> None:
    studio = opened(open_studio, scene)
    before, session = studio.text, studio.server.session
    select(studio, "tin")
    fit = studio.page.get_by_text("fit error", exact=False).first
    studio.until(lambda: "tin" in fit.inner_text() and "fit error 0." in fit.inner_text(), "the fit")
    assert session.scene is not None
    drag_arrow(studio, session.scene.objects["tin"].X_WO, (-40.0, 0.0))
    studio.until(lambda: studio.text != before, "the refinement")
    changed = [line for line in studio.text.splitlines() if line not in before.splitlines()]
    assert [line.split(":")[0].strip() for line in changed] == ["pose", "origin"]
    moved = np.linalg.norm(session.scene.objects["tin"].X_WO.p - np.array([-0.08, -0.06, 0.04]))
    error = float(changed[1].split("fit_error: ")[1].split(",")[0].rstrip("}"))
    assert moved > 0.005 and 0.001 < error < moved  # the worse fit is written with the pose
    studio.until(lambda: "fit error 0." not in fit.inner_text(), "the worse fit")
    studio.press("Undo")
    studio.until(lambda: studio.text == before, "undoing")
    assert studio.problems == []


def cloud(studio: StudioPage) -> CloudContent | None:
    """The cloud that is shown, or None while it is replaced."""
    node = studio.server.window.canvas.nodes.get("/capture/cloud")
    return node.content if node is not None and isinstance(node.content, CloudContent) else None


def test_the_cloud_follows_its_switches(scene: Path, open_studio: OpenStudio) -> None:
    studio = opened(open_studio, scene)
    photo = cloud(studio)
    studio.choose("Colors", "objects")
    objects = studio.until(lambda: (shown := cloud(studio)) != photo and shown, "the colors of objects")
    studio.choose("Colors", "fit error")
    rgb = studio.until(lambda: (shown := cloud(studio)) != objects and shown, "the colors of errors").rgb
    green = (rgb.astype(int) - (0, 160, 60)).max(axis=1) < 60
    assert green.sum() > 0.9 * (rgb != 150).any(axis=1).sum() > 500  # most points are on their objects
    studio.control("Picture").check()
    studio.until(lambda: "/capture/picture" in studio.server.window.canvas.nodes, "the picture")
    studio.control("Cloud").uncheck()
    studio.until(lambda: "/capture/cloud" not in studio.server.window.canvas.nodes, "no cloud")
    overlay = studio.server.window.capture.overlay
    assert overlay is not None
    studio.press("Look through the camera")
    client = next(iter(studio.server.viser.get_clients().values()))
    studio.until(lambda: np.allclose(client.camera.position, overlay.X_WC.p, atol=1e-4), "the view of the camera")
    assert studio.problems == []


def test_objects_are_merged_locked_and_hidden(scene: Path, open_studio: OpenStudio) -> None:
    studio = opened(open_studio, scene)
    capture = scene.parents[2] / "captures" / "desk" / "capture.yaml"
    select(studio, "carton")
    studio.until(lambda: "tin" in studio.server.window.panel(_pieces()).other.options)
    studio.choose("Other object", "tin")
    studio.press("one piece")
    studio.until(lambda: "pieces: {carton: [[" in studio.server.session.texts.get(capture, ""), "the constraint")
    assert capture.read_text() == CAPTURE
    studio.press("Save")
    studio.until(lambda: "pieces: {carton: [[" in capture.read_text(), "saving")
    studio.press("Undo")
    studio.press("Save")
    studio.until(lambda: capture.read_text() == CAPTURE, "undoing and saving")
    before = studio.text
    studio.control("Locked").check()
    studio.until(lambda: studio.server.session.locked == {"carton"})
    studio.press("+x")
    studio.page.get_by_text("is locked", exact=False).first.wait_for()
    assert studio.text == before
    studio.control("Hidden").check()
    studio.until(lambda: not studio.server.window.canvas.nodes["/objects/carton"].is_visible, "hiding")
    studio.press("Show all")
    studio.until(lambda: studio.server.window.canvas.nodes["/objects/carton"].is_visible, "showing")


def _pieces() -> type:
    from simfoundry.studio.view.panels.pieces import PiecesPanel

    return PiecesPanel


def test_a_version_is_saved_taken_and_exported(scene: Path, open_studio: OpenStudio) -> None:
    studio = opened(open_studio, scene)
    before = studio.text
    studio.press("Save as a new version")
    version = scene.with_name("desk.v1.scene.yaml")
    studio.until(version.exists, "the version")
    assert version.read_text() == before
    select(studio, "tin")
    studio.press("+y")
    studio.until(lambda: "xyz: [-0.08, -0.059, 0.04]" in studio.text, "the step")
    studio.server.window.request_refresh()
    studio.until(lambda: version.name in studio.server.window.panel(_versions()).version.options)
    studio.choose("Version", version.name)
    studio.press("selected object")
    studio.until(lambda: studio.text == before, "the version's object")
    with studio.page.expect_download() as download:
        studio.press("Export the versions")
    assert download.value.suggested_filename == "desk_versions.zip"


def _versions() -> type:
    from simfoundry.studio.view.panels.versions import VersionsPanel

    return VersionsPanel


def test_the_background_is_dragged_and_aligned_by_pairs(desk: Path, open_studio: OpenStudio) -> None:
    desk.with_name("room.obj").write_text(ROOM)
    desk.write_text(SCENE + BACKGROUND)
    studio = open_studio(desk)
    studio.page.set_default_timeout(PATIENCE_MS)
    studio.tab("Capture")
    studio.until(lambda: "/background" in studio.server.window.canvas.nodes, "the background")
    studio.control("Move the background").check()
    studio.until(lambda: studio.server.window.selection == "background")
    studio.press("+x")
    studio.until(lambda: "xyz: [-0.999, -0.5, -0.8]" in studio.text, "the step")
    stepped = studio.text
    studio.look((-0.6, -2.2, 0.8), (-0.8, -0.5, -0.7))
    drag_arrow(studio, background_pose(studio), (40.0, 0.0))
    studio.until(lambda: studio.text != stepped, "the drag")
    (line,) = [line for line in studio.text.splitlines() if line not in stepped.splitlines()]
    assert line.startswith("  pose: {xyz: [") and line.endswith("yaw_deg: 10}")
    studio.press("Undo")
    studio.until(lambda: studio.text == stepped, "undoing the drag")
    studio.press("larger")
    studio.until(lambda: "scale: 0.505  # a guess" in studio.text, "the scale")
    panel = studio.server.window.panel(_background())
    for here, there in (((0, 0, 0), (0, 0, 0.1)), ((1, 0, 0), (1, 0, 0.1)), ((0, 1, 0), (0, 1, 0.1))):
        panel.here.value, panel.there.value = here, there
        studio.server.window.run(partial(panel._add, here, there))
    studio.until(lambda: len(panel.pairs) == 3)
    studio.press("align")
    studio.until(lambda: "xyz: [-0.999, -0.5, -0.7]" in studio.text, "the alignment")
    for _ in range(3):
        studio.press("Undo")
    studio.until(lambda: studio.text == SCENE + BACKGROUND, "undoing")
    assert studio.problems == []


def background_pose(studio: StudioPage) -> Pose:
    """The pose of the background in the world."""
    assert studio.server.session.scene is not None
    return background_similarity(studio.server.session.scene).X_AB


def test_a_splat_is_aligned_by_pairs_of_points_that_are_clicked(desk: Path, open_studio: OpenStudio) -> None:
    desk.with_name("floor.ply").write_bytes(floor_splat())
    text = SCENE + BACKGROUND.replace("mesh: room.obj", "splat: floor.ply")
    desk.write_text(text)
    studio = open_studio(desk)
    studio.page.set_default_timeout(PATIENCE_MS)
    studio.until(lambda: "/background" in studio.server.window.canvas.nodes, "the splat")
    studio.look((0.3, -0.6, 2.4), (0.3, 0.1, -0.4))
    studio.tab("Capture")
    studio.control("Pick pairs").check()
    studio.page.get_by_text("Click on the background").first.wait_for()  # then the browser reports clicks
    panel = studio.server.window.panel(_background())
    scene = studio.server.session.scene
    assert scene is not None
    here = background_similarity(scene).apply(np.array([[0.4, 2.0, 0.0], [0.4, 2.72, 0.0], [1.0, 2.72, 0.0]]))
    there = here + np.array([0.5, -0.55, 0.8])  # on the desk
    for k in range(3):
        studio.page.mouse.click(*studio.screen_point(tuple(here[k].tolist())))
        studio.until(lambda: panel._half is not None, "the point on the splat")
        studio.page.mouse.click(*studio.screen_point(tuple(there[k].tolist())))
        studio.until(partial(_has_pairs, panel, k + 1), "the point on the desk")
    found = np.array(panel.pairs)
    assert np.abs(found[:, 0] - here).max() < 0.025 and np.abs(found[:, 1] - there).max() < 0.01
    studio.control("Pick pairs").uncheck()
    studio.press("align")
    studio.until(lambda: studio.text != text, "the alignment")
    scene = studio.server.session.scene
    assert scene is not None
    aligned = background_similarity(scene).apply(np.array([0.4, 2.0, 0.0]))
    np.testing.assert_allclose(aligned, there[0], atol=0.03)
    studio.press("Undo")
    studio.until(lambda: studio.text == text, "undoing")
    assert studio.problems == []


def _has_pairs(panel: Any, count: int) -> bool:
    return len(panel.pairs) == count


def _background() -> type:
    from simfoundry.studio.view.panels.background import BackgroundPanel

    return BackgroundPanel


def test_an_object_is_split_at_points_that_are_clicked(scene: Path, open_studio: OpenStudio) -> None:
    studio = opened(open_studio, scene)
    overlay = studio.server.window.capture.overlay
    assert overlay is not None
    capture = scene.parents[2] / "captures" / "desk" / "capture.yaml"
    select(studio, "carton")
    studio.press("Look through the camera")
    client = next(iter(studio.server.viser.get_clients().values()))
    studio.until(lambda: np.allclose(client.camera.position, overlay.X_WC.p, atol=1e-4), "the view of the camera")
    studio.control("Mark by clicks").check()
    studio.until(lambda: studio.server.window.gizmo.size == 0.0, "no arrows, which would take the clicks")
    studio.page.wait_for_timeout(1000)
    panel = studio.server.window.panel(_pieces())
    rows, columns = np.nonzero(overlay.labels == 1)
    wanted = {}
    for part, at in (
        ("part 1", np.argsort(columns)[len(columns) // 6]),
        ("part 2", np.argsort(columns)[len(columns) // 2]),
    ):
        studio.choose("Mark", part)
        studio.until(partial(_is_chosen, panel, part))
        wanted[part] = (int(columns[at]), int(rows[at]))
        point = overlay.points_W[rows[at], columns[at]]
        studio.page.mouse.click(*studio.screen_point(tuple(point.tolist())))
        studio.until(partial(_is_marked, panel, part), f"the mark on {part}")
    studio.press("Split at the marks")
    studio.until(lambda: "carton_2: [[" in studio.server.session.texts.get(capture, ""), "the constraint")
    stated = load_capture_text(studio.server.session.texts[capture])
    for name, part in (("carton", "part 1"), ("carton_2", "part 2")):
        (pixel,) = stated[name]
        assert max(abs(a - b) for a, b in zip(pixel, wanted[part], strict=True)) <= 4


def _is_chosen(panel: Any, part: str) -> bool:
    return bool(panel.part.value == part)


def _is_marked(panel: Any, part: str) -> bool:
    return len(panel._marks.get(part, ())) == 1


def load_capture_text(text: str) -> dict[str, list[tuple[int, int]]]:
    """The pieces that the text of a capture states."""
    from simfoundry.spec.yaml.text import parse

    pieces: dict[str, list[tuple[int, int]]] = parse(text).data["frames"]["view"]["decomposition"]["pieces"]
    return pieces
