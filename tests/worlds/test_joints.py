"""Joints, drives and contacts in the simulators: what is read back, and what physics says that they do."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest

from simfoundry.backends import compile_scene
from simfoundry.geometry.frames import Pose
from simfoundry.geometry.shapes import Sphere
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Drive, Joint, Scene
from simfoundry.scene.state import SceneState
from simfoundry.worlds.base import World
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.pybullet_world import PybulletWorld
from tests.mechanisms import chain, gripper, mechanisms, pendulum, pot, rough
from tests.readback import assert_joints, assert_links, poses_of, read_world
from tests.scenes import box, pose, scene_of, solid

TOLERANCE = 1e-9
Engine = Callable[[Scene], World]


@pytest.fixture(params=[MujocoWorld, PybulletWorld], ids=["mujoco", "pybullet"])
def engine(request: pytest.FixtureRequest) -> Engine:
    world: Engine = request.param
    if world is PybulletWorld:
        pytest.importorskip("pybullet", reason="PyBullet is not installed")
    return world


def run(world: World, seconds: float) -> None:
    world.step(round(seconds / world.timestep))


def assert_same(found: SceneState, expected: SceneState, tolerance: float = TOLERANCE) -> None:
    for poses, wanted in ((found.poses, expected.poses), (found.motions, expected.motions)):
        assert set(poses) == set(wanted)
        for name, X in wanted.items():
            assert np.linalg.norm(poses[name].p - X.p) < tolerance, name
            assert poses[name].angle_to(X) < tolerance, name
    assert dict(found.joints) == pytest.approx(dict(expected.joints), abs=tolerance)


def test_the_first_state_is_the_scenes(engine: Engine) -> None:
    scene = mechanisms()
    with engine(scene) as world:
        assert_same(world.state(), SceneState.initial(scene))
        assert_links(scene, read_world(world), TOLERANCE, TOLERANCE)


def test_joints_read_back(engine: Engine) -> None:
    scene = mechanisms()
    with engine(scene) as world:
        found = read_world(world)
    assert_joints(scene, found, TOLERANCE)
    if engine is MujocoWorld:  # nothing that could be compared is passed over
        assert found.joints["gripper.right_slide"].law == (-0.5, 0.02)
        assert found.joints["gripper.left_slide"].drive == (120.0, 6.0, 0.03)


def test_resistances_read_back_in_mujoco() -> None:
    with MujocoWorld(mechanisms()) as world:
        links = read_world(world).links
    for name, wanted in (("ball", (0.004, 0.002)), ("table", (0.0, 0.0))):
        assert [(c.spinning, c.rolling) for c in links[name].colliders or ()] == [wanted]


def test_reset_goes_to_any_state_and_back(engine: Engine) -> None:
    scene = mechanisms()
    initial = SceneState.initial(scene)
    asked = SceneState.of(
        {"pot": pose(1, 2, 3, 0.5, -0.1, 0.8)},
        {"gripper.left_slide": 0.03, "pot.hinge": 0.1},
        {"pot.rests": pose(0.1, 0.2, 0.3, -0.4, 0.2, 0.9), "pendulum.swing": pose(0, 0, 0, -0.6, 0.1, 1.2)},
    )
    joints = {**initial.joints, **asked.joints, "gripper.right_slide": 0.005}  # it follows
    expected = SceneState.of({**initial.poses, **asked.poses}, joints, {**initial.motions, **asked.motions})
    with engine(scene) as world:
        run(world, 0.2)
        world.reset(asked)
        assert_same(world.state(), expected)
        links = poses_of(read_world(world))
        item = scene.object("pot")
        X_WL = expected.poses["pot"] @ link_poses(item, expected.of_object(item))["knob"]
        assert np.linalg.norm(links["pot.knob"].p - X_WL.p) < TOLERANCE
        world.reset()
        assert_same(world.state(), initial)
        with pytest.raises(
            KeyError, match=r"the scene has no ball or free joint 'pot\.lid'; available names: pendulum\.swing"
        ):
            world.reset(SceneState.of({}, {}, {"pot.lid": Pose.of()}))


def test_halt_keeps_positions_and_stops_motion(engine: Engine) -> None:
    with engine(scene_of(pendulum(pose(0, 0, 0, 0.5)), pot())) as world:
        run(world, 0.1)
        before = world.state()
        world.halt()
        assert_same(world.state(), before)
        world.step()
        after, fallen = world.state(), 9.81 * world.timestep**2 * 1.5
    assert np.linalg.norm(after.poses["pot"].p - before.poses["pot"].p) < fallen
    assert after.motions["pendulum.swing"].angle_to(before.motions["pendulum.swing"]) < fallen / 0.3


def test_a_free_joint_holds_nothing(engine: Engine) -> None:
    """The lid falls as the pot does, although the pot is fixed."""
    with engine(scene_of(pot(fixed=True))) as world:
        before = poses_of(read_world(world))["pot.lid"].p
        run(world, 0.1)
        lid = poses_of(read_world(world))["pot.lid"].p
        assert np.linalg.norm(world.state().poses["pot"].p - pot().X_WO.p) < TOLERANCE
    # The flap's hinge, damped and rubbing, is within the lid and moves its center of mass hardly.
    assert before[2] - lid[2] == pytest.approx(9.81 * 0.1**2 / 2, rel=0.05)


def test_a_follower_moves_with_its_leader(engine: Engine) -> None:
    """Both fingers slide under gravity alone, tied together: one force, one inertia."""
    item = gripper(X_WO=pose(0, 0, 1, 0.0, -math.pi / 2, 0.0))
    joints = tuple(dataclasses.replace(j, limits=(-9.0, 9.0), damping=0.0) for j in item.joints)
    item = dataclasses.replace(item, joints=joints)
    with engine(scene_of(item)) as world:
        start = world.state().joints["gripper.left_slide"]
        worst = 0.0
        for _ in range(100):
            world.step()
            at = world.state().joints
            worst = max(worst, abs(at["gripper.right_slide"] - (0.02 - 0.5 * at["gripper.left_slide"])))
        moved, t = at["gripper.left_slide"] - start, 100 * world.timestep
    assert worst < 2e-4
    axes = [(item.X_WO @ j.X_PC).rotation @ j.axis for j in joints]
    force = -9.81 * (0.05 * axes[0][2] - 0.5 * 0.07 * axes[1][2])
    assert moved == pytest.approx(force / (0.05 + 0.25 * 0.07) * t * t / 2, rel=0.02)


def test_a_drive_pulls_a_mimic_pair_to_its_target(engine: Engine) -> None:
    """The spring sags under the weight of both fingers, by what statics says."""
    item = gripper(Drive(stiffness=400.0, damping=15.0, target=0.03))
    with engine(scene_of(item)) as world:
        run(world, 2.0)
        at = world.state().joints
    axes = [(item.X_WO @ j.X_PC).rotation @ j.axis for j in item.joints]
    sag = -9.81 * (0.05 * axes[0][2] - 0.5 * 0.07 * axes[1][2]) / 400.0
    assert abs(sag) > 3e-4
    assert at["gripper.left_slide"] == pytest.approx(0.03 + sag, abs=1e-4)
    assert at["gripper.left_slide"] == pytest.approx(0.03, rel=0.05)
    assert at["gripper.right_slide"] == pytest.approx(0.02 - 0.5 * at["gripper.left_slide"], abs=2e-4)


def slider(drive: Drive, X_WO: Pose) -> Scene:
    item = chain(2, gap=0.5, X_WO=X_WO)
    return scene_of(dataclasses.replace(item, joints=(dataclasses.replace(item.joints[0], drive=drive),)))


def test_a_drive_reaches_its_target(engine: Engine) -> None:
    with engine(slider(Drive(stiffness=200.0, damping=20.0, target=0.25), pose(0, 0, 1, 0.3, 0.0, 0.7))) as world:
        run(world, 0.1)
        # A damped oscillator from rest: 0.5 kg, 200 N/m, 20 N s/m is critically damped at 20 rad/s.
        assert world.state().joints["chain.slide_0"] == pytest.approx(0.25 * (1 - math.exp(-2.0) * 3.0), rel=0.02)
        run(world, 1.9)
        assert world.state().joints["chain.slide_0"] == pytest.approx(0.25, rel=1e-3)


@pytest.mark.parametrize(("stiffness", "damping"), [(1e7, 0.0), (1e7, 1e4), (1e4, 1e5)])
def test_a_drive_too_stiff_for_the_step_is_written_softer(engine: Engine, stiffness: float, damping: float) -> None:
    """It neither explodes nor is lost in silence, also where the joint moves a light finger on a heavy base."""
    scene = slider(Drive(stiffness, damping, target=0.25, force_limit=50.0), pose(0, 0, 1, 0.3, 0.4, 0.7))
    target = "mjcf" if engine is MujocoWorld else "pybullet"
    lost = [loss.reason for loss in compile_scene(scene, target).losses if loss.feature == "drive"]
    softer = "The drive's stiffness is reduced from 1e+07 to 1.25e+05, because a time step of 2 ms would diverge."
    assert (softer in lost) == (stiffness > 1e6)
    if stiffness < 1e6:
        assert [reason.split()[2] for reason in lost] == (["damping"] if target == "pybullet" else [])
    with engine(scene) as world:
        run(world, 3.0)
        before = world.state().joints["chain.slide_0"]
        run(world, 0.2)
        after = world.state().joints["chain.slide_0"]
    assert abs(after) < 0.6
    if 0 < damping < 1e5:
        assert after == pytest.approx(0.25, rel=0.01)
        assert abs(after - before) < 1e-3


@pytest.mark.parametrize("limit", [4.5, 5.3])
def test_a_drive_holds_its_force_limit(engine: Engine, limit: float) -> None:
    """The box weighs 4.905 N: it sinks with what is left of its weight, or rises with what the motor has beyond it."""
    upright = pose(0, 0, 1, 0.2, -math.pi / 2, 0.0)
    with engine(slider(Drive(stiffness=5000.0, damping=0.0, target=0.9, force_limit=limit), upright)) as world:
        run(world, 0.5)
        moved = world.state().joints["chain.slide_0"]
    assert moved == pytest.approx((limit - 0.5 * 9.81) / 0.5 * 0.5**2 / 2, rel=0.02)


def test_an_effort_limit_is_the_limit_of_the_drive(engine: Engine) -> None:
    """MuJoCo's motor of 9 N is held to the 5.3 N of its joint; lowering writes the smaller limit for other engines."""
    upright = pose(0, 0, 1, 0.2, -math.pi / 2, 0.0)
    scene = slider(Drive(5000.0, 0.0, 0.9, 9.0 if engine is MujocoWorld else 5.3), upright)
    joint = dataclasses.replace(scene.objects[0].joints[0], effort=5.3)
    item = dataclasses.replace(scene.objects[0], joints=(joint,))
    with engine(dataclasses.replace(scene, objects=(item,))) as world:
        run(world, 0.5)
        moved = world.state().joints["chain.slide_0"]
    assert moved == pytest.approx((5.3 - 0.5 * 9.81) / 0.5 * 0.5**2 / 2, rel=0.02)


def test_bullet_keeps_a_velocity_limit() -> None:
    upright = pose(0, 0, 1, 0.2, -math.pi / 2, 0.0)
    joint = dataclasses.replace(chain(2, gap=0.5, X_WO=upright).joints[0], velocity=0.4)
    with PybulletWorld(scene_of(dataclasses.replace(chain(2, gap=0.5, X_WO=upright), joints=(joint,)))) as world:
        run(world, 1.0)
        before = world.state().joints["chain.slide_0"]
        run(world, 0.5)
        after = world.state().joints["chain.slide_0"]
    assert after - before == pytest.approx(-0.2, rel=0.01)


def test_a_brake_slows_a_fall(engine: Engine) -> None:
    upright = pose(0, 0, 1, 0.2, -math.pi / 2, 0.0)
    with engine(slider(Drive(stiffness=0.0, damping=20.0), upright)) as world:
        run(world, 0.5)
        before = world.state().joints["chain.slide_0"]
        run(world, 0.5)
        speed = (world.state().joints["chain.slide_0"] - before) / 0.5
    assert speed == pytest.approx(-0.5 * 9.81 / 20.0, rel=0.01)


def period(engine: Engine, motion: Pose) -> float:
    """Time [s] from the third crossing of the middle to the fifth, interpolated."""
    with engine(scene_of(pendulum(motion))) as world:
        q0 = np.asarray(motion.rotation @ [0, 0, -1])[:2]
        side = q0 / np.linalg.norm(q0)
        times, last = [], 1.0
        for k in range(round(3.5 / world.timestep)):
            world.step()
            tip = world.state().motions["pendulum.swing"].rotation @ [0.0, 0.0, -1.0]
            now = float(tip[:2] @ side)
            if last * now < 0:
                times.append((k + last / (last - now)) * world.timestep)
            last = now
    assert len(times) >= 5
    return times[4] - times[2]


def test_a_ball_pendulum_swings_with_the_right_period(engine: Engine) -> None:
    """About an axis oblique to all coordinate axes; the bob is a solid sphere, the amplitude 0.1 rad."""
    half = 0.05
    axis = np.array([0.8, 0.6, 0.0])
    motion = Pose.of(q=[math.cos(half), *(math.sin(half) * axis)])
    inertia = 0.2 * 0.4**2 + 0.4 * 0.2 * 0.03**2
    expected = 2 * math.pi * math.sqrt(inertia / (0.2 * 9.81 * 0.4)) * (1 + 0.1**2 / 16)
    assert period(engine, motion) == pytest.approx(expected, rel=0.005)


def test_a_ball_joint_feels_its_friction(engine: Engine) -> None:
    """0.2 kg at 0.4 m and 0.5 rad pull with 0.376 N m; 0.6 N m of friction about each axis hold that."""
    tilt = pose(0, 0, 0, 0.5)
    with engine(scene_of(pendulum(tilt, friction=0.6))) as world:
        run(world, 1.0)
        assert world.state().motions["pendulum.swing"].angle_to(tilt) < 5e-3
    with engine(scene_of(pendulum(tilt, friction=0.1))) as world:
        run(world, 1.0)
        assert world.state().motions["pendulum.swing"].angle_to(tilt) > 0.1


def rolling_scene(resistance: float, friction: float, table: float, heading: float) -> Scene:
    ball = rough(solid("ball", Sphere(0.04), pose(0, 0, 0.04, 0.1, 0.2, 0.3), friction=friction), rolling=resistance)
    ground = solid("table", box(8.0, 8.0, 0.1), pose(0, 0, -0.05), friction=table, fixed=True)
    return scene_of(ball, ground, gravity=np.array([0.3 * math.cos(heading), 0.3 * math.sin(heading), -9.81]))


@pytest.mark.parametrize("heading", [0.0, 0.6])
def test_rolling_friction_slows_a_ball(engine: Engine, heading: float) -> None:
    """A slope of 0.3 to 9.81 pulls a ball of 4 cm that rolls with 0.6 mm of resistance: 5/7 of the difference."""
    scene = rolling_scene(0.0006, 0.5, 0.8, heading)
    with engine(scene) as world:
        run(world, 2.0)
        moved = float(np.linalg.norm(world.state().poses["ball"].p[:2]))
    expected = 5 / 7 * (0.3 - 9.81 * 0.0006 / 0.04) * 2.0**2 / 2
    assert moved == pytest.approx(expected, rel=0.02 if engine is MujocoWorld else 0.05)


def test_rolling_friction_holds_a_ball_on_a_slope(engine: Engine) -> None:
    with engine(rolling_scene(0.0016, 0.5, 0.8, 0.6)) as world:
        run(world, 2.0)
        assert np.linalg.norm(world.state().poses["ball"].p[:2]) < 2e-3


def chain_end(engine: Engine, scene: Scene) -> float:
    """Where the last box of a chain is along x after it was pulled toward the first for half a second [m]."""
    with engine(dataclasses.replace(scene, gravity=np.array([-5.0, 0.0, 0.0]))) as world:
        run(world, 0.5)
        at = world.state().joints
    return float(at["chain.slide_0"] + at["chain.slide_1"])


def test_linked_links_pass_and_others_do_not(engine: Engine) -> None:
    """The middle box falls into the first, which a joint connects; the last one is stopped by the first."""
    item = chain(3, gap=0.05)
    with engine(dataclasses.replace(scene_of(item), gravity=np.array([-5.0, 0.0, 0.0]))) as world:
        run(world, 0.5)
        at = world.state().joints
    assert at["chain.slide_0"] < -0.3
    assert at["chain.slide_0"] + at["chain.slide_1"] == pytest.approx(-0.2, abs=5e-3)


def test_pairs_without_contact_pass_through_each_other(engine: Engine) -> None:
    silent = chain(3, gap=0.05, no_contact=(("box_2", "box_0"),))
    assert chain_end(engine, scene_of(silent)) < -0.5


@pytest.mark.parametrize("frictions", [(0.5, 0.5), (0.2, 0.9)])
def test_objects_without_contact_pass_through_each_other(engine: Engine, frictions: tuple[float, float]) -> None:
    """With one friction or two: MuJoCo holds the latter as explicit pairs, which its exclusions leave alone."""
    table = solid("table", box(1, 1, 0.1), pose(0, 0, -0.05), friction=frictions[0], fixed=True)
    ball = solid("ball", Sphere(0.04), pose(0, 0, 0.1), friction=frictions[1])
    with engine(scene_of(table, ball)) as world:
        run(world, 0.5)
        assert world.state().poses["ball"].p[2] == pytest.approx(0.04, abs=1e-3)
    with engine(dataclasses.replace(scene_of(table, ball), no_contact=(("ball", "table"),))) as world:
        run(world, 0.5)
        assert world.state().poses["ball"].p[2] == pytest.approx(0.1 - 9.81 * 0.125, rel=0.01)
        assert world.contacts() == []


def test_a_lid_lies_on_its_pot(engine: Engine) -> None:
    """A free joint connects nothing, so its two links touch."""
    item = pot(fixed=True)
    lid = dataclasses.replace(item.joints[1], motion=Pose.of([0, 0, 0.02]))
    joints: tuple[Joint, ...] = (item.joints[0], lid)
    scene = scene_of(dataclasses.replace(item, links=item.links[:3], joints=joints, X_WO=pose(0, 0, 0.5, yaw=0.4)))
    with engine(scene) as world:
        run(world, 1.0)
        assert world.state().motions["pot.rests"].p[2] == pytest.approx(-0.005, abs=1e-3)


def test_torsional_friction_stops_a_spinning_ball(engine: Engine) -> None:
    """A ball of 4 cm that spins at 20 rad/s about the vertical, against 1 mm of resistance."""
    ball = rough(solid("ball", Sphere(0.04), pose(0, 0, 0.04, 0.1, 0.2, 0.3), mass=0.2, friction=0.5), torsional=0.001)
    table = solid("table", box(1, 1, 0.1), pose(0, 0, -0.05), friction=0.8, fixed=True)
    with engine(scene_of(ball, table)) as world:
        run(world, 0.2)  # it sinks in first
        world.halt()
        if isinstance(world, MujocoWorld):
            start = int(world.model.joint("ball").dofadr[0]) + 3
            world.data.qvel[start : start + 3] = world.state().poses["ball"].rotation.T @ [0, 0, 20.0]
        else:
            assert isinstance(world, PybulletWorld)
            spin = {"angularVelocity": [0, 0, 20.0], "physicsClientId": world.client}
            world._bullet.resetBaseVelocity(world.bodies["ball"], **spin)
        before = world.state().poses["ball"]
        run(world, 0.1)
        turned = world.state().poses["ball"].angle_to(before)
    slowed = 9.81 * 0.001 / (0.4 * 0.04**2)  # torque over inertia [rad/s^2]
    assert turned == pytest.approx(20.0 * 0.1 - slowed * 0.1**2 / 2, rel=0.01)
    assert slowed * 0.1**2 / 2 > 0.03 * turned
