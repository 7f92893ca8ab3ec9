"""The simulators hold what the scene says, and behave as physics says."""

from __future__ import annotations

import dataclasses
import math
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from simfoundry.geometry.frames import Pose, frozen_array
from simfoundry.geometry.shapes import Capsule, Cylinder, Primitive, Sphere
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Collider, Link, Scene, SceneObject
from simfoundry.scene.state import SceneState
from simfoundry.worlds import MissingEngineError, World
from simfoundry.worlds.base import ClosedWorldError
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.pybullet_world import PybulletWorld
from tests.readback import assert_joints, assert_links, poses_of, read_world
from tests.scenes import (
    all_scenes,
    box,
    cabinet,
    fan,
    full_scene,
    pose,
    primitives_scene,
    scene_of,
    skewed_inertia,
    solid,
    textured_object,
    wedge_mesh,
)

ROOT = Path(__file__).parents[2]
TOLERANCE = 1e-9  # numbers are written with twelve digits; the bar is 1e-6
Engine = Callable[[Scene], World]


@pytest.fixture(params=[MujocoWorld, PybulletWorld], ids=["mujoco", "pybullet"])
def engine(request: pytest.FixtureRequest) -> Engine:
    world: Engine = request.param
    if world is PybulletWorld:
        pytest.importorskip("pybullet", reason="PyBullet is not installed")
    return world


SCENES = pytest.mark.parametrize("scene", all_scenes().values(), ids=all_scenes())


@SCENES
def test_links_and_joints_read_back_as_the_scene_has_them(scene: Scene, engine: Engine) -> None:
    with engine(scene) as world:
        found = read_world(world)
    assert_links(scene, found, TOLERANCE, TOLERANCE)
    assert_joints(scene, found, TOLERANCE)


def test_frictions_read_back(engine: Engine) -> None:
    with engine(full_scene()) as world:
        links = read_world(world).links
    expected = (0.35, 0.35, 0.6) if engine is MujocoWorld else ((0.35 * 0.35 * 0.6) ** (1 / 3),) * 3
    for name, wanted in (("puck", (0.1,)), ("cabinet.handle", (0.8,)), ("wedge", expected)):
        assert [c.friction for c in links[name].colliders or ()] == pytest.approx(wanted, rel=1e-6)


def test_the_first_state_is_the_scenes(engine: Engine) -> None:
    scene = full_scene()
    with engine(scene) as world:
        assert_states_equal(world.state(), SceneState.initial(scene))


def assert_states_equal(found: SceneState, expected: SceneState) -> None:
    assert set(found.poses) == set(expected.poses)
    for name, X_WO in expected.poses.items():
        assert np.linalg.norm(found.poses[name].p - X_WO.p) < TOLERANCE, name
        assert found.poses[name].angle_to(X_WO) < TOLERANCE, name
    assert dict(found.joints) == pytest.approx(dict(expected.joints), abs=TOLERANCE)


def test_reset_goes_to_any_state_and_back_at_rest(engine: Engine) -> None:
    scene = full_scene()
    poses = {"wedge": pose(0.1, 0.2, 2.0, 1.0, -0.4, 2.0), "fan": pose(3, 0, 1, 0.2, 0.1, 0.4),
             "cabinet": pose(2.0, 1.0, 0.3, 0.2, -0.1, 1.1)}  # fmt: skip
    asked = SceneState.of(poses, {"cabinet.slide": 0.2, "fan.spin": -1.0})
    with engine(scene) as world:
        world.step(100)
        world.reset(asked)
        initial = SceneState.initial(scene)
        expected = SceneState.of({**initial.poses, **asked.poses}, {**initial.joints, **asked.joints})
        assert_states_equal(world.state(), expected)
        links = poses_of(read_world(world))
        X_OL = link_poses(scene.object("cabinet"), {"slide": 0.2})
        assert np.linalg.norm(links["cabinet.drawer"].p - (poses["cabinet"] @ X_OL["drawer"]).p) < 1e-9
        world.step()  # one step from rest falls by g dt^2
        fallen = world.state().poses["wedge"].p - poses["wedge"].p
        np.testing.assert_allclose(fallen, [0, 0, -9.81 * world.timestep**2], atol=1e-7)
        world.reset()
        assert_states_equal(world.state(), initial)


def test_reset_names_what_is_not_in_the_scene(engine: Engine) -> None:
    with engine(primitives_scene()) as world:
        with pytest.raises(KeyError, match="the scene has no object 'cup'; available names: table, crate"):
            world.reset(SceneState.of({"cup": Pose.of()}, {}))
        with pytest.raises(KeyError, match=r"the scene has no joint 'cup\.lid'; available names: none"):
            world.reset(SceneState.of({}, {"cup.lid": 0.0}))


def test_free_fall(engine: Engine) -> None:
    item = dataclasses.replace(textured_object(), X_WO=pose(0, 0, 60, 0.5, -0.3, 2.1))
    with engine(scene_of(solid("ball", Sphere(0.03), pose(5, 0, 60)), item)) as world:
        steps = round(3 / world.timestep)
        world.step(steps)
        t = steps * world.timestep
        for name in ("ball", "wedge"):
            assert 60 - world.state().poses[name].p[2] == pytest.approx(9.81 * t * t / 2, rel=1e-3)


def ramp_scene(degrees: float, mu_box: float, mu_ramp: float) -> Scene:
    X_WR = pose(0.3, -0.2, 0.5, 0.0, math.radians(degrees), 0.4)
    ramp = solid("ramp", box(2.0, 0.6, 0.05), X_WR, mass=10, friction=mu_ramp, fixed=True)
    return scene_of(ramp, solid("crate", box(0.1, 0.08, 0.04), X_WR @ Pose.of([-0.6, 0, 0.045]), friction=mu_box))


def slide(engine: Engine, degrees: float, mu_box: float, mu_ramp: float) -> float:
    """How far the box slides in one second, after half a second to find its place [m]."""
    with engine(ramp_scene(degrees, mu_box, mu_ramp)) as world:
        world.step(round(0.5 / world.timestep))
        before = world.state().poses["crate"].p
        world.step(round(1.0 / world.timestep))
        return float(np.linalg.norm(world.state().poses["crate"].p - before))


@pytest.mark.parametrize(("mu_box", "mu_ramp"), [(0.3, 0.8), (0.8, 0.3), (0.49, 0.49)])
def test_slip_angle_is_that_of_the_geometric_mean(engine: Engine, mu_box: float, mu_ramp: float) -> None:
    mu = math.sqrt(mu_box * mu_ramp)
    mean = math.degrees(math.atan(mu))  # 26.1 degrees
    assert slide(engine, mean - 1.1, mu_box, mu_ramp) < 1e-3
    assert slide(engine, mean + 0.9, mu_box, mu_ramp) > 0.05
    theta = math.radians(mean + 4)
    # From rest, the distance between 0.5 s and 1.5 s in meters is the acceleration in m/s^2.
    acceleration = slide(engine, mean + 4, mu_box, mu_ramp)
    found = (9.81 * math.sin(theta) - acceleration) / (9.81 * math.cos(theta))
    # Bullet's friction depends on the direction in which a body slides; this one is oblique to its axes.
    assert found == pytest.approx(mu, rel=0.01 if engine is MujocoWorld else 0.05)


def hull_object() -> SceneObject:
    """A wedge that lies on its largest face, with its center of mass above it."""
    com = frozen_array([0.1 / 3, 0.03, 0.05 / 3])
    collider = Collider("ramp", wedge_mesh(0.1, 0.06, 0.05), 0.5, 0.0)
    return SceneObject(
        "thing", "", False, pose(0.1, 0.2, 0.05, yaw=0.7),
        (Link("body", 0.2, com, skewed_inertia(1e-4, 1.3e-4, 1.8e-4, 0, 0, 0.1), (), (collider,)),),
    )  # fmt: skip


RESTING: dict[str, tuple[Primitive | None, Pose, float]] = {
    "box": (box(0.08, 0.06, 0.05), pose(0.1, 0.2, 0.05, yaw=0.7), 0.025),
    "cylinder": (Cylinder(0.03, 0.1), pose(0.1, 0.2, 0.05, yaw=0.7), 0.05),
    "sphere": (Sphere(0.03), pose(0.1, 0.2, 0.05, 0.4, 0.2, 0.7), 0.03),
    "lying capsule": (Capsule(0.02, 0.08), pose(0.1, 0.2, 0.05, math.pi / 2, 0.0, 0.7), 0.02),
    "convex mesh": (None, pose(0.1, 0.2, 0.05, yaw=0.7), 0.0),
}


@pytest.mark.parametrize("kind", RESTING)
def test_a_dropped_object_comes_to_rest_where_it_should(engine: Engine, kind: str) -> None:
    shape, X_WO, height = RESTING[kind]
    raised = Pose.of([*X_WO.p[:2], height + 0.05], X_WO.q)
    thing = dataclasses.replace(hull_object(), X_WO=raised) if shape is None else solid("thing", shape, raised)
    table = solid("table", box(1, 1, 0.04), pose(0, 0, -0.02, yaw=0.2), fixed=True)
    with engine(scene_of(table, thing)) as world:
        world.step(round(1 / world.timestep))
        landed = world.state().poses["thing"]
        assert abs(landed.p[2] - height) < 1e-3
        contacts = world.contacts()
        assert {(c.a, c.b) for c in contacts} <= {("table", "thing"), ("thing", "table")}
        assert contacts
        for contact in contacts:
            assert abs(contact.depth) < 1e-3
            up = contact.normal[2] if contact.a == "table" else -contact.normal[2]
            assert up == pytest.approx(1, abs=1e-3)  # from a toward b
            assert abs(contact.position[2]) < 2e-3
        world.step(round(2 / world.timestep))
        settled = world.state().poses["thing"].p
        if kind == "lying capsule":  # nothing holds it from rolling on, but it stays on the table
            assert abs(settled[2] - landed.p[2]) < 1e-4
        else:
            assert np.linalg.norm(settled - landed.p) < 1e-3


def test_a_bounce_keeps_the_geometric_mean_of_the_restitutions(engine: Engine) -> None:
    ball = solid("ball", Sphere(0.03), pose(0, 0, 0.53, 0.3, 0.2, 0.1), restitution=0.9)
    floor = solid("floor", box(1, 1, 0.1), pose(0, 0, -0.05), restitution=0.4, fixed=True)
    with engine(scene_of(ball, floor)) as world:
        heights = [0.53]
        for _ in range(round(0.9 / world.timestep)):
            world.step()
            heights.append(float(world.state().poses["ball"].p[2]))
        speeds = np.diff(heights) / world.timestep
    # Bullet acts on an impact at whole steps.
    assert speeds.max() / -speeds.min() == pytest.approx(0.6, abs=0.03 if engine is MujocoWorld else 0.15)


def test_a_cabinet_holds_together(engine: Engine) -> None:
    """The drawer fills the carcass: contacts between links of one object would throw it out."""
    upright = dataclasses.replace(cabinet(), X_WO=pose(1.3, 0.4, 0.01, yaw=0.8))
    with engine(scene_of(upright)) as world:
        assert world.contacts() == []
        world.step(round(1 / world.timestep))
        assert world.state().joints["cabinet.slide"] == pytest.approx(0.07, abs=2e-3)


def test_a_sliding_joint_feels_its_damping_friction_and_limit(engine: Engine) -> None:
    """A drawer of 1.7 kg pulled by gravity alone along its axis, against 4 N s/m and 1.5 N, up to its stop."""
    item = cabinet()
    bare = dataclasses.replace(item.joints[0], armature=0.0, position=0.0)
    # Pitched by a quarter turn the cabinet's opening looks down, so that the drawer falls out of it.
    tipped = dataclasses.replace(item, joints=(bare, *item.joints[1:]), X_WO=pose(0, 0, 2, 0.0, -math.pi / 2, 0.0))
    with engine(scene_of(tipped)) as world:
        world.step(round(0.2 / world.timestep))
        t, rate, terminal = 0.2, 4.0 / 1.7, (1.7 * 9.81 - 1.5) / 4.0
        expected = terminal * (t - (1 - math.exp(-rate * t)) / rate)
        assert world.state().joints["cabinet.slide"] == pytest.approx(expected, rel=0.02)
        world.step(round(2 / world.timestep))
        assert world.state().joints["cabinet.slide"] == pytest.approx(0.28, abs=5e-3)


def test_joint_friction_holds_below_its_limit(engine: Engine) -> None:
    """The drawer weighs 16.7 N; 20 N of friction hold it."""
    item = cabinet()
    stiff = dataclasses.replace(item.joints[0], friction=20.0)
    tipped = dataclasses.replace(item, joints=(stiff, *item.joints[1:]), X_WO=pose(0, 0, 2, 0.0, -math.pi / 2, 0.0))
    with engine(scene_of(tipped)) as world:
        world.step(round(1 / world.timestep))
        assert world.state().joints["cabinet.slide"] == pytest.approx(0.07, abs=2e-3)


def test_a_run_repeats_to_the_last_bit(engine: Engine) -> None:
    def run() -> list[float]:
        with engine(full_scene()) as world:
            world.step(200)
            state = world.state()
        return [float(v) for X in state.poses.values() for v in (*X.p, *X.q)] + list(state.joints.values())

    assert run() == run()


def test_worlds_do_not_disturb_each_other(engine: Engine) -> None:
    with engine(primitives_scene()) as first, engine(scene_of(fan())) as second:
        before = second.state().poses["fan"].p
        first.step(50)
        np.testing.assert_array_equal(second.state().poses["fan"].p, before)
        first.close()
        first.close()
        second.step()
        assert second.state().poses["fan"].p[2] < before[2]


def test_native_noise_is_kept_off() -> None:
    pytest.importorskip("pybullet", reason="PyBullet is not installed")
    code = (
        "from simfoundry.worlds.pybullet_world import PybulletWorld\nfrom tests.scenes import full_scene\n"
        "with PybulletWorld(full_scene()) as world:\n    world.step(2)\nprint('done')"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60, check=True
    )
    assert (done.stdout, done.stderr) == ("done\n", "")


def test_worlds_opened_in_threads_leave_the_output_as_it_was() -> None:
    pytest.importorskip("pybullet", reason="PyBullet is not installed")
    code = (
        "import sys\nfrom concurrent.futures import ThreadPoolExecutor\n"
        "from simfoundry.worlds.pybullet_world import PybulletWorld\nfrom tests.scenes import primitives_scene\n"
        "scene = primitives_scene()\n"
        "with ThreadPoolExecutor(4) as pool:\n"
        "    list(pool.map(lambda _: PybulletWorld(scene).close(), range(8)))\n"
        "print('hello')\nprint('here', file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60, check=True
    )
    assert (done.stdout, done.stderr) == ("hello\n", "here\n")


def test_a_closed_world_says_so(engine: Engine) -> None:
    world = engine(primitives_scene())
    world.close()
    uses: dict[str, Callable[[], object]] = {
        "step": world.step, "reset": world.reset, "halt": world.halt, "state": world.state,
        "contacts": world.contacts, "trouble": world.trouble, "judge": lambda: world.judge("OnTop(crate, table)"),
    }  # fmt: skip
    for name, use in uses.items():
        with pytest.raises(ClosedWorldError, match=r"^the world of `\w+` is closed; open the scene again$"):
            print(name, use())


@pytest.mark.parametrize(("world", "module"), [(MujocoWorld, "mujoco"), (PybulletWorld, "pybullet")])
def test_a_missing_engine_says_how_to_install_it(world: Engine, module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingEngineError, match=r"is not installed; .*pip install"):
        world(primitives_scene())


def test_importing_worlds_loads_no_simulator() -> None:
    code = (
        "import sys, simfoundry.worlds, simfoundry.backends; print({'mujoco', 'pybullet', 'scipy'} & set(sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout == "set()\n"
