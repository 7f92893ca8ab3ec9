"""What changed, in words: the exact text for each kind of change."""

from __future__ import annotations

import copy
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simfoundry.spec.change.diff.changes import Reorder, diff
from simfoundry.spec.change.diff.values import motion, motion_words
from simfoundry.spec.change.diff.words import describe, summary, text
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.base import Model
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import TaskSpec
from simfoundry.spec.yaml.write import to_data
from tests.spec.strategies import ASSETS, SCENES

SCENE: dict[str, Any] = {
    "simfoundry": "scene/1",
    "name": "table",
    "viewpoint": "left",
    "materials": {"ceramic": {"density": 2400, "friction": 0.35}, "wood": {"density": 700, "color": (1, 0.5, 0)}},
    "objects": {
        "desk": {"fixed": True, "shape": {"box": (1.4, 0.7, 0.04)}, "material": "wood"},
        "cup": {
            "shape": {"cylinder": {"radius": 0.04, "height": 0.1}},
            "material": "ceramic",
            "mass": {"value": 0.2, "range": (0.15, 0.3), "source": "vlm"},
            "pose": {"xyz": (0.4, 0.1, 0.05)},
        },
        "bowl": {"shape": {"sphere": 0.1}, "material": "ceramic", "place": {"on": "desk", "xy": (0.2, 0.1)}},
        "cabinet": {"asset": "cabinet.asset.yaml", "pose": {"xyz": (0.6, -0.25, 0), "yaw_deg": 180}},
    },
    "cameras": {"left": {"size": (640, 480), "fx": 610, "fy": 610, "pose": {"xyz": (0, 1, 1), "look_at": (0, 0, 0)}}},
    "lights": {"sky": {"type": "dome", "intensity": 0.5}},
    "relations": ("OnTop(cup, desk)", "OnTop(bowl, desk)"),
}
TASK: dict[str, Any] = {
    "simfoundry": "task/1",
    "name": "tidy",
    "scene": "table.scene.yaml",
    "instruction": "Put the cup into the bowl.",
    "goal": "Inside(cup, bowl)",
    "subtasks": {"lift": {"goal": "Lifted(cup)"}},
    "reset": {"objects": {"cup": {"x": (0.3, 0.5), "y": (0.0, 0.1)}}},
    "horizon": 600,
}
ASSET: dict[str, Any] = {
    "simfoundry": "asset/1",
    "name": "cabinet",
    "links": {
        "body": {"mass": 3, "parts": {"wall": {"shape": {"box": (0.3, 0.3, 0.3)}, "pose": {"xyz": (0, 0, 0.1)}}}},
        "drawer": {"mass": 1, "parts": {"tray": {"shape": {"box": (0.2, 0.2, 0.1)}}}},
    },
    "joints": {"slide": {"type": "prismatic", "parent": "body", "child": "drawer", "limits": (0, 0.2), "damping": 1}},
}
MODELS: dict[str, type[Model]] = {"scene/1": SceneSpec, "task/1": TaskSpec, "asset/1": AssetSpec}
UNITS = {("cabinet", "drawer"): "m"}


def _changed(document: dict[str, Any], edits: dict[str, Any]) -> dict[str, Any]:
    """A copy in which the values at dotted paths are others; None removes."""
    out = copy.deepcopy(document)
    for path, value in edits.items():
        *above, last = path.split(".")
        place = out
        for key in above:
            place = place.setdefault(key, {})
        if value is None:
            del place[last]
        else:
            place[last] = value
    return out


def _said(document: dict[str, Any], edits: dict[str, Any], verbose: bool = False) -> tuple[list[str], str]:
    model = MODELS[document["simfoundry"]]
    a, b = (to_data(model.model_validate(d)) for d in (document, _changed(document, edits)))
    entries = describe(a, b, model, UNITS, verbose)
    return text(entries), summary(entries)


GOLDEN = [
    (
        SCENE,
        {"objects.cup.pose": {"xyz": (0.43, 0.111, 0.05), "yaw_deg": 12.0}},
        ["cup moved 3.2 cm (+x 3.0, +y 1.1), turned 12.0° about z"],
        "1 moved",
    ),
    (SCENE, {"objects.cup.pose.xyz": (0.4, 0.1, 0.0498)}, ["cup moved 0.2 mm (-z 0.2)"], "1 moved"),
    (SCENE, {"objects.cup.pose.xyz": (-1.6, 0.1, 0.05)}, ["cup moved 2.000 m (-x 2.000)"], "1 moved"),
    (
        SCENE,
        {"objects.cup.mass": 0.31},
        ["cup: mass 0.2 (estimated, 0.15 to 0.3 by vlm) → 0.31 kg"],
        "1 changed",
    ),
    (SCENE, {"objects.cup.friction": 0.7}, ["cup: friction 0.35 (from ceramic) → 0.7"], "1 changed"),
    (
        SCENE,
        {"objects.desk.friction": 0.7, "objects.desk.color": (0, 0, 1)},
        ["desk: color #ff8000 (from wood) → #0000ff; friction 0.5 (from wood) → 0.7"],
        "1 changed",
    ),
    (
        SCENE,
        {"objects.cup.mass": None, "objects.cup.density": 900},
        [
            "cup:",
            "  mass 0.2 kg (estimated, 0.15 to 0.3 by vlm) removed",
            "  density 2400 kg/m^3 (from ceramic) → 900 kg/m^3",
        ],
        "1 changed",
    ),
    (
        SCENE,
        {"objects.cup": None, "relations": ("OnTop(bowl, desk)",)},
        ["cup removed", "relations lose OnTop(cup, desk)"],
        "1 removed, relations changed",
    ),
    (
        SCENE,
        {
            "objects.mug": {
                "shape": {"sphere": 0.04},
                "mass": 0.1,
                "place": {"on": "desk", "left_of": "cup", "gap": 0.1},
            }
        },
        ["mug added: sphere of radius 0.04 m, on desk, left of cup with a gap of 0.1 m"],
        "1 added",
    ),
    (
        SCENE,
        {
            "objects.bowl": None,
            "objects.dish": SCENE["objects"]["bowl"],
            "relations": ("OnTop(cup, desk)", "OnTop(dish, desk)"),
        },
        ["bowl renamed to dish"],
        "1 renamed",
    ),
    (SCENE, {"objects.bowl.place.xy": (0.2, 0.15)}, ["bowl moved 5.0 cm (+y 5.0)"], "1 moved"),
    (
        SCENE,
        {"objects.bowl.place": {"inside": "cabinet", "yaw_deg": 30.0}},
        ["bowl is now inside cabinet (was on desk at (0.2, 0.1) m), turned 30.0° about z"],
        "1 moved",
    ),
    (
        SCENE,
        {"objects.cup.pose": None, "objects.cup.place": {"on": "desk"}},
        ["cup is now on desk (was at (0.4, 0.1, 0.05) m)"],
        "1 moved",
    ),
    (
        ASSET,
        {"joints.slide.closed": "upper"},
        ["joint slide closes at its upper limit (was: where it is nearest to zero)"],
        "1 changed",
    ),
    (
        ASSET | {"joints": {"slide": ASSET["joints"]["slide"] | {"closed": "upper"}}},
        {"joints.slide.closed": "lower"},
        ["joint slide closes at its lower limit (was: at its upper limit)"],
        "1 changed",
    ),
    (SCENE, {"objects.cup.fixed": True}, ["cup is fixed now"], "1 changed"),
    (SCENE, {"objects.desk.fixed": False}, ["desk is no longer fixed"], "1 changed"),
    (SCENE, {"objects.cabinet.joints": {"drawer": 0.12}}, ["cabinet: joint drawer 0.00 → 0.12 m"], "1 changed"),
    (
        SCENE,
        {"objects.cup.shape": {"sphere": 0.04}, "objects.desk.shape.box": (1.5, 0.7, 0.04)},
        [
            "desk: box 1.4 × 0.7 × 0.04 → box 1.5 × 0.7 × 0.04 m",
            "cup: cylinder of radius 0.04 and height 0.1 m → sphere of radius 0.04 m",
        ],
        "2 changed",
    ),
    (SCENE, {"cameras.left.fx": 612.0}, ["camera left: fx 610 → 612 px"], "1 changed"),
    (SCENE, {"cameras.left.size": (1280, 720)}, ["camera left: size 640 × 480 → 1280 × 720 px"], "1 changed"),
    (
        SCENE,
        {"cameras.left.pose.look_at": (1.0, 0.0, 0.0)},
        ["camera left turned 46.0° about (-0.20, -0.08, 0.98)"],
        "1 moved",
    ),
    (SCENE, {"description": "tidy"}, ['description now "tidy"'], "description changed"),
    (SCENE, {"lights.sky.intensity": 0.9}, ["light sky: intensity 0.5 → 0.9"], "1 changed"),
    (
        SCENE,
        {"materials.ceramic.friction": 0.5},
        ["material ceramic: friction 0.35 → 0.5 (default) (of cup, bowl)"],
        "1 changed",
    ),
    (
        SCENE,
        {"gravity": (0.0, 0.0, -1.62), "viewpoint": None},
        ["gravity (0, 0, -9.81) (default) → (0, 0, -1.62) m/s^2", "viewpoint left removed"],
        "gravity changed, viewpoint changed",
    ),
    (
        SCENE,
        {"description": "A table\nto tidy.", "allow": {"SF402": {"cup": "it is a model"}}},
        ['description now "A table to tidy."', 'allow SF402 cup now "it is a model"'],
        "description changed, allow changed",
    ),
    (
        SCENE,
        {"robots": {"arm": {"model": "franka_robotiq"}}},
        ["robot arm added: franka_robotiq"],
        "1 added",
    ),
    (
        SCENE,
        {"relations": ("OnTop(cup, desk)", "NextTo(cup, bowl)")},
        ["relations gain NextTo(cup, bowl) and lose OnTop(bowl, desk)"],
        "relations changed",
    ),
    (TASK, {"goal": {"all": ("Inside(cup, bowl)", "Released(cup)")}}, ["goal gains Released(cup)"], "goal changed"),
    (
        TASK,
        {"goal": {"any": ("Inside(cup, bowl)", {"not": "Open(cabinet)"})}},
        ["goal gains any(Inside(cup, bowl), not Open(cabinet)) and loses Inside(cup, bowl)"],
        "goal changed",
    ),
    (
        TASK,
        {"subtasks.lift.goal": "Grasped(cup)", "subtasks.put": {"goal": "Inside(cup, bowl)"}},
        ["subtask lift: goal gains Grasped(cup) and loses Lifted(cup)", "subtask put added: Inside(cup, bowl)"],
        "1 added, 1 changed",
    ),
    (TASK, {"horizon": 800}, ["horizon 600 (default) → 800"], "horizon changed"),
    (TASK, {"control_hz": 30.0}, ["control_hz 15 (default) → 30 Hz"], "control_hz changed"),
    (
        TASK,
        {"reset.objects.cup.x": (0.35, 0.5), "reset.grid": (3, 5), "start.joints": {"cabinet": {"drawer": 0.1}}},
        [
            "start joint cabinet added: drawer 0.1",
            "reset object cup x (0.3, 0.5) → (0.35, 0.5) m; reset grid 5 × 5 (default) → 3 × 5",
        ],
        "start changed, reset changed",
    ),
    (
        TASK,
        {"instruction": "Put the cup into the bowl that stands on the left of the plate."},
        ['instruction "Put the cup into the bowl." → "Put the cup into the bowl that stands on the le…"'],
        "instruction changed",
    ),
    (
        ASSET,
        {"links.body.parts.wall.pose.xyz": (0, 0.01, 0.1), "links.body.parts.door": {"shape": {"sphere": 0.1}}},
        ["link body: part wall pose moved 1.0 cm (+y 1.0); part door added: sphere of radius 0.1 m"],
        "1 changed",
    ),
    (
        ASSET,
        {"joints.slide.limits": (0, 0.25), "joints.slide.pose": {"xyz": (0, 0, 0.1)}, "joints.slide.damping": 2.5},
        ["joint slide: limits (0, 0.2) → (0, 0.25) m; damping 1.0 → 2.5 N s/m; pose moved 10.0 cm (+z 10.0)"],
        "1 changed",
    ),
    (
        ASSET,
        {"links.drawer": None, "links.box": ASSET["links"]["drawer"], "joints.slide.child": "box"},
        ["link drawer renamed to box"],
        "1 renamed",
    ),
]


@pytest.mark.parametrize(("document", "edits", "lines", "total"), GOLDEN)
def test_the_words_of_a_change(document: dict[str, Any], edits: dict[str, Any], lines: list[str], total: str) -> None:
    assert _said(document, edits) == (lines, total)


def test_a_thing_with_many_changes_has_them_on_lines_of_their_own() -> None:
    edits = {
        "objects.cup.pose.xyz": (0.5, 0.1, 0.05),
        "objects.cup.friction": 0.7,
        "objects.cup.mass": 0.31,
        "objects.cup.category": "mug",
    }
    assert _said(SCENE, edits)[0] == [
        "cup moved 10.0 cm (+x 10.0)",
        "  mass 0.2 (estimated, 0.15 to 0.3 by vlm) → 0.31 kg",
        "  category now mug",
        "  friction 0.35 (from ceramic) → 0.7",
    ]


def test_what_is_only_written_otherwise_is_said_when_asked() -> None:
    edits = {
        "objects.cup.pose": {"xyz": (0.4, 0.1, 0.05), "rpy_deg": (0.0, 0.0, 0.0)},
        "objects.cabinet.pose": {"xyz": (0.6, -0.25, 0), "quat_wxyz": (0.0, 0.0, 0.0, -1.0)},
        "cameras.left.pose": {"xyz": (0, 1, 1), "look_at": (0, 0.5, 0.5)},
        "relations": ("OnTop(bowl, desk)", "OnTop(cup, desk)"),
    }
    assert _said(SCENE, edits) == ([], "")
    assert _said(SCENE, edits, verbose=True)[0] == [
        "cup: same pose, written differently",
        "cabinet: same pose, written differently",
        "relations: reordered",
        "camera left: same pose, written differently",
    ]


ANGLES = st.floats(-720, 720)


@given(ANGLES, ANGLES, ANGLES)
def test_a_rotation_is_the_same_in_every_form(roll: float, pitch: float, yaw: float) -> None:
    (cr, sr), (cp, sp), (cy, sy) = (
        (math.cos(v), math.sin(v)) for v in (math.radians(a) / 2 for a in (roll, pitch, yaw))
    )
    quaternion = (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
    written = tuple(round(v, 6) for v in quaternion)
    assert motion_words(motion({"rpy_deg": (roll, pitch, yaw)}, {"quat_wxyz": quaternion})) == []
    assert motion_words(motion({"rpy_deg": (roll, pitch, yaw)}, {"quat_wxyz": written})) == []
    assert motion_words(motion({"yaw_deg": yaw}, {"rpy_deg": (0.0, 0.0, yaw)})) == []


@given(st.floats(0.1, 179.9), st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: math.hypot(*v) > 0.1), ANGLES)
def test_a_turn_is_found_again(angle: float, axis: tuple[float, float, float], yaw: float) -> None:
    """A turn about an axis of the parent, after a rotation that is there already."""
    n = math.hypot(*axis)
    s, c = math.sin(math.radians(angle / 2)), math.cos(math.radians(angle / 2))
    w, x, y, z = c, *(s * v / n for v in axis)
    cy, sy = math.cos(math.radians(yaw / 2)), math.sin(math.radians(yaw / 2))
    after = (w * cy - z * sy, x * cy + y * sy, y * cy - x * sy, w * sy + z * cy)
    found = motion({"yaw_deg": yaw}, {"quat_wxyz": after})
    assert found.angle == pytest.approx(angle, abs=1e-6)
    assert math.dist(found.axis, tuple(v / n for v in axis)) < 1e-6


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.6, 0.0, 0.8)])
def test_half_a_turn_has_an_axis(axis: tuple[float, float, float]) -> None:
    found = motion({}, {"quat_wxyz": (0.0, *axis)})
    assert found.angle == pytest.approx(180)
    assert min(math.dist(found.axis, axis), math.dist(found.axis, tuple(-v for v in axis))) < 1e-9
    assert "-180" not in motion_words(found)[0]


@given(st.tuples(SCENES, SCENES) | st.tuples(ASSETS, ASSETS))
def test_every_change_is_said(pair: tuple[Model, Model]) -> None:
    """No change goes unsaid, and what is the same has no words."""
    a, b = map(to_data, pair)
    entries = describe(a, b, type(pair[0]), verbose=True)
    assert bool(entries) >= any(not isinstance(c, Reorder) for c in diff(a, b))
    assert not describe(a, a, type(pair[0]), verbose=True)
    assert not any("\n" in line for line in text(entries))
