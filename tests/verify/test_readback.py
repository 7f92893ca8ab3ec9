"""Builds as MuJoCo, PyBullet and USD hold them; and builds that were tampered with, each of which must be found."""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from simfoundry.backends.losses import drop
from simfoundry.scene.model import Scene
from simfoundry.targets import profile
from simfoundry.targets.profile import QUANTITIES
from simfoundry.verify.behaviors import BEHAVIORS
from simfoundry.verify.compare import FLOORS, compare
from simfoundry.verify.engines import VerifyEngine, all_engines, find_engine
from simfoundry.verify.expected import expected_readback
from simfoundry.verify.process import EngineJob, ask
from simfoundry.verify.readback import WorldReadback
from simfoundry.verify.run import ProofStatus, SceneBuilds, built, judge_result
from tests.scenes import full_scene

HERE = Path(sys.executable)
ENGINES = ("mujoco", "pybullet", "usd")


@pytest.fixture(scope="module")
def scene() -> Scene:
    return full_scene()


@pytest.fixture(scope="module")
def subject(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> SceneBuilds:
    return built("full", scene, map(find_engine, ENGINES), tmp_path_factory.mktemp("builds"))


@pytest.fixture(scope="module")
def facts(subject: SceneBuilds) -> dict[str, WorldReadback]:
    """What each engine says of the untouched build."""
    found = {}
    for name in ENGINES:
        if name == "pybullet":
            pytest.importorskip("pybullet", reason="PyBullet is not installed")
        (answer,) = ask(HERE, find_engine(name).readback, [EngineJob(subject.builds[name])], timeout=60)
        assert answer.error == ""
        assert answer.facts is not None
        found[name] = answer.facts
    return found


@pytest.mark.parametrize("name", ENGINES)
def test_what_an_engine_holds_is_what_the_scene_says(
    name: str, scene: Scene, subject: SceneBuilds, facts: dict[str, WorldReadback]
) -> None:
    engine = find_engine(name)
    found = compare(scene, facts[name], engine, subject.losses[engine.name])
    assert [str(d) for d in found.mismatches] == []
    assert found.compared > 150
    covered = {(d.name, d.quantity) for d in found.covered}
    wedge = {(f"wedge.{part}", "friction") for part in ("ramp", "heel", "knob")}
    assert covered == (wedge if name == "pybullet" else set())  # Bullet has one friction a link
    assert found.stale == ()


def test_the_engines_tell_what_they_should(facts: dict[str, WorldReadback]) -> None:
    """A reader that tells nothing would agree with everything."""
    scene = full_scene()
    for name, told in facts.items():
        wanted = expected_readback(scene, find_engine(name).target.backend)
        assert set(told.links) == set(wanted.links)
        assert set(told.joints) == set(wanted.joints)
        assert told.gravity is not None
        for link in told.links.values():
            assert link.pose is not None
            assert link.colliders is not None
            assert all(c.friction is not None and c.kind not in (None, "other") for c in link.colliders)
        for joint in told.joints.values():
            assert None not in (joint.type, joint.axis, joint.limits, joint.damping, joint.friction, joint.position)
    pairs, wanted_pairs = facts["mujoco"].pairs or {}, expected_readback(scene, "mjcf").pairs or {}
    assert len(wanted_pairs) > 100
    assert {name: pairs.get(name) for name in wanted_pairs} == pytest.approx(dict(wanted_pairs), rel=1e-9)


def replaced(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


Falsify = Callable[[Path], None]


def heavier(folder: Path) -> None:
    replaced(folder / "scene.xml", 'mass="0.31"', 'mass="0.311"')


def wider_limit(folder: Path) -> None:
    replaced(folder / "scene.xml", 'range="0 0.28"', 'range="0 0.281"')


def slippery(folder: Path) -> None:
    replaced(folder / "scene.xml", 'friction="0.1"', 'friction="0.11"')


def native_contacts(folder: Path) -> None:
    replaced(folder / "scene.xml", '<include file="contacts.xml" />', "")


def renamed(folder: Path) -> None:
    replaced(folder / "scene.xml", '<body name="puck"', '<body name="duck"')


def shifted(folder: Path) -> None:
    text = (folder / "scene.xml").read_text(encoding="utf-8")
    start = text.index('<body name="table" pos="') + len('<body name="table" pos="')
    replaced(folder / "scene.xml", text[start : start + 4], "0.46")


def drag(folder: Path) -> None:
    replaced(folder / "scene.xml", 'damping="4"', 'damping="4.001"')


def other_shape(folder: Path) -> None:
    text = (folder / "scene.xml").read_text(encoding="utf-8")
    can = text[text.index('name="can.shape"') :]
    replaced(folder / "scene.xml", can, can.replace('type="cylinder"', 'type="capsule"', 1))


def bullet_friction(folder: Path) -> None:
    """The friction that one coefficient of a link approximates may not leave the range of what it stands for."""
    world = json.loads((folder / "world.json").read_text())
    world["objects"]["wedge"]["links"]["body"]["lateral_friction"] = 0.9
    (folder / "world.json").write_text(json.dumps(world))


def bullet_pose(folder: Path) -> None:
    world = json.loads((folder / "world.json").read_text())
    world["objects"]["crate"]["p"][0] += 0.001
    (folder / "world.json").write_text(json.dumps(world))


def usd_mass(folder: Path) -> None:
    replaced(folder / "scene.usda", "float physics:mass = 0.35", "float physics:mass = 0.36")


def usd_limit(folder: Path) -> None:
    replaced(folder / "scene.usda", "float physics:upperLimit = 0.28", "float physics:upperLimit = 0.3")


FALSE: dict[str, tuple[str, Falsify, str, str]] = {
    "mass": ("mujoco", heavier, "wedge", "mass"),
    "limit": ("mujoco", wider_limit, "cabinet.slide", "limits"),
    "friction": ("mujoco", slippery, "puck.shape", "friction"),
    "pair": ("mujoco", native_contacts, " and ", "friction"),
    "name": ("mujoco", renamed, "duck", "link"),
    "pose": ("mujoco", shifted, "table", "position"),
    "damping": ("mujoco", drag, "cabinet.slide", "damping"),
    "shape": ("mujoco", other_shape, "can.shape", "shape"),
    "bullet friction": ("pybullet", bullet_friction, "wedge.ramp", "friction"),
    "bullet pose": ("pybullet", bullet_pose, "crate", "position"),
    "usd mass": ("usd", usd_mass, "can", "mass"),
    "usd limit": ("usd", usd_limit, "cabinet.slide", "limits"),
}


@pytest.mark.parametrize("what", FALSE)
def test_a_false_build_is_found(what: str, scene: Scene, tmp_path: Path) -> None:
    name, falsify, where, quantity = FALSE[what]
    pytest.importorskip({"usd": "pxr"}.get(name, name), reason=f"{name} is not installed")
    engine = find_engine(name)
    false = built("full", scene, [engine], tmp_path)
    falsify(false.builds[name])
    (answer,) = ask(HERE, find_engine(name).readback, [EngineJob(false.builds[name])], timeout=60)
    assert answer.facts is not None, answer.error
    found = compare(scene, answer.facts, engine, false.losses[name])
    assert any(where in d.name and d.quantity == quantity for d in found.mismatches), found.mismatches


def test_a_loss_covers_its_own_quantity_and_no_other(scene: Scene) -> None:
    engine = find_engine("mujoco")
    wanted = expected_readback(scene, "mjcf")
    slide = dataclasses.replace(wanted.joints["cabinet.slide"], armature=0.0, damping=9.0)
    told = dataclasses.replace(wanted, joints={**wanted.joints, "cabinet.slide": slide})
    lost = [drop("armature", "cabinet.slide", "there is none"),
            drop("joint_damping", "cabinet.hinge", "of another joint"),
            drop("friction", "cabinet", "of its surfaces")]  # fmt: skip
    found = compare(scene, told, engine, lost)
    assert [(d.name, d.quantity) for d in found.mismatches] == [("cabinet.slide", "damping")]
    assert [(d.quantity, d.covered) for d in found.covered] == [("armature", "there is none")]
    assert set(found.stale) == {"cabinet.hinge.damping", "cabinet.friction"}


def test_nothing_is_passed_over_in_silence(scene: Scene) -> None:
    engine = find_engine("mujoco")
    wanted = expected_readback(scene, "mjcf")
    nan = dataclasses.replace(wanted.links["ball"], mass=float("nan"))
    none = dataclasses.replace(wanted.links["can"], mass=None)
    bare = dataclasses.replace(wanted.links["crate"], colliders=())
    links = {**wanted.links, "ball": nan, "can": none, "crate": bare, "ghost": none}
    del links["fan.rotor"]
    found = compare(scene, dataclasses.replace(wanted, links=links, pairs=None), engine, [])
    assert sorted((d.name, d.quantity) for d in found.mismatches) == [
        ("ball", "mass"),
        ("can", "mass"),
        ("crate", "colliders"),
        ("fan.rotor", "link"),
        ("ghost", "link"),
    ]


def test_profiles_know_the_quantities_and_the_behaviors() -> None:
    """Their names are checked where verify is not loaded."""
    assert {name.replace(" ", "_") for name in FLOORS} == set(QUANTITIES)
    assert {behavior.name for behavior in BEHAVIORS} == set(profile.BEHAVIORS)


@pytest.mark.parametrize(
    ("name", "quantity"), [(e.name, q) for e in all_engines() for q in e.target.profile.tolerances]
)
def test_each_tolerance_of_a_profile_is_what_verify_compares_with(name: str, quantity: str, scene: Scene) -> None:
    """With 1e-30 in its place what passed is a mismatch."""
    engine = find_engine(name)
    tolerance = profile.Tolerance(value=1e-30, reason="nothing is as exact")
    tolerances = {**engine.target.profile.tolerances, quantity: tolerance}
    spec = engine.target.profile.model_copy(update={"tolerances": tolerances})
    strict = VerifyEngine(dataclasses.replace(engine.target, profile=spec))
    if quantity in profile.BEHAVIORS:
        behavior = next(b for b in BEHAVIORS if b.name == quantity)
        verdicts = [judge_result(behavior, e, behavior.expected + 1e-6).verdict for e in (engine, strict)]
        assert verdicts == [ProofStatus.OK, ProofStatus.MISMATCH]
        return
    wanted = expected_readback(scene, engine.target.backend)
    links = {n: dataclasses.replace(link, mass=(link.mass or 0.0) * (1 + 1e-9)) for n, link in wanted.links.items()}
    told = dataclasses.replace(wanted, links=links)
    assert compare(scene, told, engine, ()).mismatches == ()
    assert "mass" in {d.quantity for d in compare(scene, told, strict, ()).mismatches}
