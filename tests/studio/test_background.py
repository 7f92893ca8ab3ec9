"""The alignment of a background: poses and scales by the gizmo, by keys, and by pairs of points."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from simfoundry.geometry.frames import Pose, quat_from_rpy
from simfoundry.geometry.similarity import Similarity
from simfoundry.scene.model import Background
from simfoundry.studio.acts.act import ActError
from simfoundry.studio.acts.background import AlignBackground, AlignByPoints, Point, background_similarity, turned_about
from simfoundry.studio.session import StudioSession
from simfoundry.studio.view.picking import background_point, scene_point
from tests.studio.conftest import SCENE

# A room of three walls, in the units of a file that knows no lengths.
ROOM = "v 0 0 0\nv 4 0 0\nv 4 3 0\nv 0 3 0\nv 0 0 2\nv 4 0 2\nf 1 2 3\nf 1 3 4\nf 1 6 2\nf 1 5 6\n"

BACKGROUND = """\
background:  # scanned by phone
  mesh: room.obj
  pose: {xyz: [-1, -0.5, -0.8], yaw_deg: 10}
  scale: 0.5  # a guess
"""

# The true map from the file to the world.
S_WF = Similarity(Pose.of((-0.9, -0.6, -0.75), quat_from_rpy(0.05, -0.02, 0.4)), 0.62)
CORNERS_F = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 3.0, 0.0], [4.0, 0.0, 2.0]])


def floor_splat() -> bytes:
    """A part of a floor as a splat: opaque Gaussians on a grid of 0.04 in the units of its file, from (0, 1.6, 0)."""
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
    names += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    grid = np.stack(np.meshgrid(0.04 * np.arange(32), 1.6 + 0.04 * np.arange(36)), axis=-1).reshape(-1, 2)
    data = np.zeros((len(grid), len(names)), dtype="<f4")
    data[:, :2], data[:, 3], data[:, 6], data[:, 7:10], data[:, 10] = grid, 1.0, 5.0, np.log(0.02), 1.0
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(grid)}\n"
    return (head + "".join(f"property float {n}\n" for n in names) + "end_header\n").encode() + data.tobytes()


@pytest.fixture
def session(desk: Path) -> StudioSession:
    """A scene with a background."""
    desk.with_name("room.obj").write_text(ROOM)
    desk.write_text(SCENE + BACKGROUND)
    return StudioSession(desk)


def similarity(session: StudioSession) -> Similarity:
    assert session.scene is not None
    return background_similarity(session.scene)


def as_points(array: np.ndarray) -> list[Point]:
    return [(float(x), float(y), float(z)) for x, y, z in array]


def test_the_gizmo_and_the_slider_write_the_pose_and_the_scale(session: StudioSession) -> None:
    session.apply(AlignBackground(Similarity(Pose.of((-1.0, -0.4, -0.8), quat_from_rpy(0, 0, np.radians(10))), 0.5)))
    assert session.text == (SCENE + BACKGROUND).replace("-0.5, -0.8", "-0.4, -0.8")
    session.apply(AlignBackground(Similarity(similarity(session).X_AB, 0.6)), "background scale")
    session.apply(AlignBackground(Similarity(similarity(session).X_AB, 0.61)), "background scale")
    assert "  scale: 0.61  # a guess" in session.text
    assert session.undo() and session.undo() and session.text == SCENE + BACKGROUND  # the slider is one step
    session.apply(AlignBackground(Similarity(similarity(session).X_AB, 1.0)))
    assert "scale" not in session.text


def test_three_pairs_of_points_align_the_background(session: StudioSession) -> None:
    now, wanted = similarity(session).apply(CORNERS_F[:3]), S_WF.apply(CORNERS_F[:3])
    notes = session.apply(AlignByPoints(tuple(zip(as_points(now), as_points(wanted), strict=True))))
    assert notes == ("The points of a pair are now at most 0.0 mm apart",)
    found = similarity(session)
    # Positions are written to 0.1 mm and angles to 0.01 deg, which the room of 2.5 m turns into half a millimeter.
    assert found.residuals(CORNERS_F, S_WF.apply(CORNERS_F)).max() < 6e-4
    assert found.scale == pytest.approx(0.62, rel=1e-6)
    assert "  mesh: room.obj\n  pose: {xyz: [-0.9, -0.6, -0.75], rpy_deg: [2.86, -1.15, 22.92]}\n" in session.text
    session.undo()
    assert session.text == SCENE + BACKGROUND


def test_pairs_that_do_not_determine_a_similarity_are_refused(session: StudioSession) -> None:
    line: tuple[tuple[Point, Point], ...] = tuple(((k, k, 0.0), (k, 0.0, 0.0)) for k in (0.0, 1.0, 2.0))
    for pairs in ((), line[:2], line):
        with pytest.raises(ActError, match="the background cannot be aligned by these points"):
            session.apply(AlignByPoints(pairs))
    with pytest.raises(ActError, match="greater than zero"):
        session.apply(AlignBackground(Similarity(Pose.of(), 0.0)))
    assert session.text == SCENE + BACKGROUND


def test_a_scene_without_a_background_says_so(desk: Path) -> None:
    with pytest.raises(ActError, match="the scene has no background"):
        StudioSession(desk).apply(AlignBackground(Similarity(Pose.of())))


def test_a_turn_keeps_its_center_where_it_is() -> None:
    center = (0.3, -0.2, 0.9)
    turn = Pose.of(q=quat_from_rpy(0.3, -0.8, 1.9))
    found = turned_about(S_WF, center, turn, 1.7)
    np.testing.assert_allclose(found.apply(S_WF.inverse().apply(np.array(center))), center, atol=1e-12)
    assert found.scale == pytest.approx(1.7 * 0.62)
    np.testing.assert_allclose(found.X_AB.rotation, (turn @ S_WF.X_AB).rotation, atol=1e-12)


def test_clicks_meet_the_background_and_the_objects(session: StudioSession) -> None:
    scene = session.scene
    assert scene is not None and scene.surroundings.background is not None
    background: Background = scene.surroundings.background
    wanted = np.array(similarity(session).apply(np.array([1.0, 0.5, 0.0])))
    eye = np.array([0.5, 0.9, 3.0])
    found = background_point(background, eye, (wanted - eye) * 7)
    assert found is not None
    np.testing.assert_allclose(found, wanted, atol=1e-9)
    assert background_point(background, eye, np.array([0.0, 0.0, 1.0])) is None
    mug = scene.objects["mug"].X_WO.p + np.array([0.0, 0.0, 0.05])  # the center of its top
    on_mug = scene_point(scene.scene, None, eye, mug - eye)
    assert on_mug is not None
    np.testing.assert_allclose(on_mug, mug, atol=1e-6)
    assert scene_point(scene.scene, None, eye, np.array([0.0, 0.0, 1.0])) is None


def test_clicks_meet_a_splat(desk: Path) -> None:
    desk.with_name("floor.ply").write_bytes(floor_splat())
    desk.write_text(SCENE + BACKGROUND.replace("mesh: room.obj", "splat: floor.ply"))
    opened = StudioSession(desk)
    assert opened.scene is not None and opened.scene.surroundings.background is not None
    background, S_WF = opened.scene.surroundings.background, similarity(opened)
    center = S_WF.apply(np.array([0.4, 2.0, 0.0]))
    eye = np.array([0.0, 0.0, 2.0])
    found = background_point(background, eye, (center - eye) * 0.3 + np.array([0.0008, 0.0, 0.0]))
    assert found is not None
    np.testing.assert_allclose(found, center, atol=1e-6)  # the nearest Gaussian, although the click was beside it
    assert background_point(background, eye, np.array([1.0, 0.0, 0.0])) is None
    shift = Pose.of((0.5, -0.55, 0.8), quat_from_rpy(0, 0, 0.3))
    pairs = tuple(
        (as_points(p[None])[0], as_points(shift.apply(p)[None])[0])
        for p in S_WF.apply(np.array([[0.4, 2.0, 0.0], [0.4, 2.72, 0.0], [1.0, 2.72, 0.0]]))
    )
    opened.apply(AlignByPoints(pairs))
    np.testing.assert_allclose(similarity(opened).apply(np.array([0.4, 2.0, 0.0])), shift.apply(center), atol=1e-4)
    assert opened.undo() and opened.text == SCENE + BACKGROUND.replace("mesh: room.obj", "splat: floor.ply")
