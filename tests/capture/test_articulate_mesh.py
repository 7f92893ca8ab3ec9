"""Joints of a mesh in one state: words to coordinates, segments, the command, and joints from a server."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest

import simfoundry as sf
from simfoundry.assets.mesh import merged, read_mesh
from simfoundry.capture.articulation.placed_joints import check_joints, parse_joint, place
from simfoundry.capture.articulation.segments import SegmentedMesh, divide, in_object_frame, spread_labels
from simfoundry.errors import SimfoundryError
from simfoundry.models.offline import OfflineMeshes
from tests.capture.meshes import number_of, write_cabinet
from tests.cli.command import run
from tests.conftest import REPOSITORY


@pytest.fixture(scope="module")
def cabinet_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_cabinet(tmp_path_factory.mktemp("cabinet") / "cabinet.obj")


@pytest.fixture(scope="module")
def cabinet(cabinet_file: Path) -> SegmentedMesh:
    pieces = in_object_frame(read_mesh(cabinet_file), "-y")
    return divide(pieces, OfflineMeshes().segment_mesh(*merged(pieces)).labels)


@pytest.fixture(scope="module")
def numbers(cabinet: SegmentedMesh) -> dict[str, int]:
    boxes = [(segment.low, segment.high) for segment in cabinet.segments]
    return {name: number_of(name, boxes) for name in ("door", "door_handle", "drawer", "tray", "drawer_handle")}


def test_the_front_comes_to_plus_x(cabinet: SegmentedMesh, numbers: dict[str, int]) -> None:
    low, high = cabinet.bounds
    np.testing.assert_allclose((low + high)[:2], 0, atol=1e-9)
    assert low[2] == 0 and len(cabinet.segments) == 9
    handle, door, drawer = (cabinet.segments[numbers[name] - 1] for name in ("door_handle", "door", "drawer"))
    assert handle.high[0] == high[0]
    assert door.high[1] < drawer.low[1]  # the door is at the left of a person who faces the front, at -y


@pytest.mark.parametrize(
    ("words", "axis", "at"),
    [
        ("revolute:front_left:front:90", (0, 0, -1), {0: "high", 1: "low"}),
        ("revolute:front_right:front:90", (0, 0, 1), {0: "high", 1: "high"}),
        ("revolute:front_bottom:front:90", (0, 1, 0), {0: "high", 2: "low"}),
        ("revolute:back_top:front:60", (0, -1, 0), {0: "low", 2: "high"}),
    ],
)
def test_a_hinge_is_an_edge(
    words: str, axis: tuple[int, ...], at: dict[int, str], cabinet: SegmentedMesh, numbers: dict[str, int]
) -> None:
    door = cabinet.segments[numbers["door"] - 1]
    found = place(parse_joint(f"door={door.number}:{words}"), cabinet)
    np.testing.assert_allclose(found.axis, axis)
    for index, end in at.items():
        assert found.origin[index] == pytest.approx((door.high if end == "high" else door.low)[index])
    # The middle of the part starts to move to where it opens.
    moved = np.cross(found.axis, (door.low + door.high) / 2 - found.origin)
    assert moved[0] > 0
    assert found.upper == pytest.approx(math.radians(float(words.split(":")[-1])))


def test_slides_and_knobs(cabinet: SegmentedMesh, numbers: dict[str, int]) -> None:
    drawer = numbers["drawer"]
    assert place(parse_joint(f"d={drawer}:prismatic:right:0.2"), cabinet).axis == (0, 1, 0)
    knob = place(parse_joint(f"knob@door={drawer}:continuous:top"), cabinet)
    assert (knob.type, knob.axis, knob.parent, knob.upper) == ("continuous", (0, 0, 1), "door", 0)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("door", "is not a joint; write NAME=SEGMENTS:revolute"),
        ("door=1:hinge:front:9", "is not a joint; write NAME=SEGMENTS:revolute"),
        ("door=1:revolute:front:front:9", "hinge: expected one of front_left"),
        ("door=1:prismatic:out:9", "opens: expected one of front, back"),
        ("door=1:prismatic:front:0", "`travel` must be greater than 0"),
        ("door=1:prismatic:front:nan", "travel"),
        ("door=x:prismatic:front:1", "segments"),
        ("Door=1:prismatic:front:1", "name"),
    ],
)
def test_words_that_are_no_joint(text: str, reason: str) -> None:
    with pytest.raises(SimfoundryError, match=reason):
        parse_joint(text)


@pytest.mark.parametrize(
    ("joints", "reason"),
    [
        (["a=99:prismatic:front:1"], "there is no segment 99; segments are numbered from 1 to 9"),
        (["a=1:prismatic:front:1", "b=1:prismatic:front:1"], "segment 1 belongs to several parts"),
        (["a=1:prismatic:front:1", "a=2:prismatic:front:1"], "a name of its own"),
        (["body=1:prismatic:front:1"], "other than `body`"),
        (["a=1,2,3,4,5,6,7,8,9:prismatic:front:1"], "leave at least one for the body"),
        (["a@b=1:prismatic:front:1"], "a is attached to b, which is not a moving part"),
        (["a@b=1:prismatic:front:1", "b@a=2:prismatic:front:1"], "a is attached to itself through"),
    ],
)
def test_joints_that_do_not_fit(joints: list[str], reason: str, cabinet: SegmentedMesh) -> None:
    with pytest.raises(SimfoundryError, match=reason):
        check_joints([place(parse_joint(text), cabinet) for text in joints], cabinet)


def test_a_hinge_cannot_open_along_its_own_edge(cabinet: SegmentedMesh, numbers: dict[str, int]) -> None:
    with pytest.raises(SimfoundryError, match="door cannot open toward top about its edge front_left"):
        place(parse_joint(f"door={numbers['door']}:revolute:front_left:top:90"), cabinet)


def test_unlabeled_triangles_get_the_label_of_most_neighbors() -> None:
    # A strip of eight triangles along x; those in the middle are unlabeled, and two neighbors outvote one.
    vertices = np.array([(x, y, 0.0) for x in range(5) for y in (0, 1)])
    faces = np.array([f for k in range(4) for f in ((2 * k, 2 * k + 2, 2 * k + 1), (2 * k + 1, 2 * k + 2, 2 * k + 3))])
    labels = np.array([5, 5, -1, -1, -1, 7, 7, 7])
    found = spread_labels(vertices, faces.astype(np.int32), labels.astype(np.int32))
    assert found.tolist() == [5, 5, 5, 5, 7, 7, 7, 7]
    alone = spread_labels(vertices, faces.astype(np.int32), np.full(8, -1, np.int32))
    assert (alone == -1).all()


@pytest.mark.slow  # 4 s: it draws 40 pictures
def test_the_command_without_a_model(
    tmp_path: Path, cabinet_file: Path, numbers: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SIMFOUNDRY_MODEL_ARTICULATE", raising=False)
    out = tmp_path / "cabinet.asset.yaml"
    asked = run("articulate", cabinet_file, "-o", out)
    assert asked.code == 2 and "--joint door=3,4" in asked.err and not out.exists()
    assert (tmp_path / "cabinet.segments.png").is_file()
    made = run("articulate", cabinet_file, "-o", out, *_stated(numbers), "--json")
    assert made.code == 0, made.err
    said = json.loads(made.out)
    assert said["joints"]["drawer"]["range"] == [0, 0.2] and said["doubt"] == ""
    assert "note: " in out.read_text() and (tmp_path / "cabinet.png").is_file()


@pytest.mark.slow  # 6 s: it decomposes meshes into convex parts, and runs two engines
def test_a_mesh_moves_in_both_engines(tmp_path: Path, cabinet_file: Path, numbers: dict[str, int]) -> None:
    stated = _stated(numbers)
    for folder in ("", "again"):
        made = run("articulate", cabinet_file, "-o", tmp_path / folder / "cabinet.asset.yaml", *stated)
        assert made.code == 0, made.err
    scene = tmp_path / "room.scene.yaml"
    scene.write_text(
        "simfoundry: scene/1\nname: room\nobjects:\n"
        "  it: {asset: cabinet.asset.yaml, fixed: true, joints: {drawer: 0.1, door: 0.5}, pose: {}}\n"
    )
    document = sf.load(scene)
    assert document.check() == []
    for engine in ("mujoco", "pybullet"):
        world = document.open(engine)
        for _ in range(100):
            world.step()
        state = world.state().joints
        assert abs(state["it.drawer"] - 0.1) < 0.01 and abs(state["it.door"] - 0.5) < 0.1  # none jams
    first, second = (tmp_path / folder / "cabinet.asset.yaml" for folder in ("", "again"))
    assert first.read_bytes() == second.read_bytes()


def _stated(numbers: dict[str, int]) -> list[str]:
    door, handle, front, tray, pull = (
        numbers[name] for name in ("door", "door_handle", "drawer", "tray", "drawer_handle")
    )
    return [
        "--joint",
        f"door={door},{handle}:revolute:front_left:front:110",
        "--joint",
        f"drawer={front},{tray},{pull}:prismatic:front:0.2",
    ]


SERVER = """
import sys
sys.path.insert(0, {folder!r})
from scaffold import Model, Result, run

def articulate(request):
    labels, vertices = request.members["labels"], request.members["vertices"]
    assert vertices[:, 2].min() == 0 and labels.max() == 9
    joint = {{"part": {part}, "others": [{other}], "type": "prismatic", "axis": [1, 0, 0], "upper": 0.25}}
    joint["name"] = "Top Drawer"
    return Result({{}}, values={{"joints": [joint]}})

facts = {{"name": "particulate", "version": "1", "licence": "CC-BY-4.0", "commercial": True}}
sys.exit(run(Model(facts, {{"articulate": articulate}})))
"""


def test_joints_from_a_server(
    tmp_path: Path, cabinet_file: Path, numbers: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    server = tmp_path / "serve.py"
    drawer, handle = numbers["drawer"], numbers["drawer_handle"]
    server.write_text(SERVER.format(folder=str(REPOSITORY / "examples" / "servers"), part=drawer, other=handle))
    monkeypatch.setenv("SIMFOUNDRY_MODEL_ARTICULATE", f"command:{sys.executable} {server}")
    out = tmp_path / "cabinet.asset.yaml"
    made = run("articulate", cabinet_file, "-o", out, "--json")
    assert made.code == 0, made.err
    joint = json.loads(made.out)["joints"]["top_drawer"]
    assert joint["range"] == [0, 0.25] and joint["segments"] == [drawer, handle]
    assert "{task: articulate, name: particulate" in out.read_text()


def test_what_belongs_to_captures_is_refused_for_a_mesh(tmp_path: Path, cabinet_file: Path) -> None:
    out = tmp_path / "x.asset.yaml"
    assert "are for captures" in run("articulate", cabinet_file, "-o", out, "--frame", "a").err
    assert "are for a mesh" in run("articulate", cabinet_file, cabinet_file, "-o", out, "--front", "+x").err
    broken = tmp_path / "broken.obj"
    broken.write_text("v 0 0 nan\nf 1 1 1\n")
    refused = run("articulate", broken, "-o", out)
    assert refused.code == 2 and "Traceback" not in refused.err and not out.exists()
