"""A scene that says all that a spec can, and robots, read back; and builds of them that are false."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene
from simfoundry.verify.compare import Comparison, compare
from simfoundry.verify.engines import engine_called
from simfoundry.verify.expected import expected_facts
from simfoundry.verify.process import Job, ask
from simfoundry.verify.run import built
from tests.targets.everything import write_everything
from tests.verify.test_readback import replaced

ENGINES = ("mujoco", "pybullet", "usd")


@pytest.fixture(scope="module")
def everything(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return lower_file(write_everything(tmp_path_factory.mktemp("everything")))


def read(scene: Scene, name: str, folder: Path, falsify: Callable[[Path], None] = lambda build: None) -> Comparison:
    """What comes of the comparison of a build that was tampered with."""
    pytest.importorskip({"usd": "pxr"}.get(name, name))
    engine = engine_called(name)
    subject = built("one", scene, [engine.target], folder)
    falsify(subject.builds[engine.target])
    (answer,) = ask(Path(sys.executable), name, [Job(subject.builds[engine.target])], timeout=60)
    assert answer.facts is not None, answer.error
    return compare(scene, answer.facts, engine, subject.losses[engine.target])


@pytest.mark.parametrize("name", ENGINES)
def test_all_that_a_spec_can_say_is_read_back(name: str, everything: Scene, tmp_path: Path) -> None:
    found = read(everything, name, tmp_path)
    assert [str(d) for d in found.mismatches] == []
    covered = {(d.name.partition(".")[0], d.quantity) for d in found.covered}
    assert covered == ({("tile", "bounds")} if name == "pybullet" else set())  # its tips are sharp
    assert found.stale == ()


def test_what_is_expected_of_it_has_every_quantity(everything: Scene) -> None:
    facts = expected_facts(everything, "mjcf")
    slide, along = facts.joints["cabinet.slide"], facts.joints["cabinet.along"]
    assert (slide.drive, slide.effort, slide.follows) == ((50.0, 5.0, 0.1), (), "")
    assert (along.follows, along.law) == ("cabinet.slide", (2.0, 0.0))
    assert facts.joints["cabinet.nod"].position == (1.0, 0.0, 0.0, 0.0)
    assert {n: facts.links[n].held for n in ("cup", "desk", "cabinet.lid", "cabinet.knob")} == {
        "cup": "free",
        "desk": "world",
        "cabinet.lid": "free",
        "cabinet.knob": "cabinet.door",
    }
    assert facts.silent is not None and {"cabinet|cup", "cabinet|cabinet.drawer"} <= set(facts.silent)
    (cup,) = facts.links["cup"].colliders or ()
    assert (cup.spinning, cup.rolling) == (0.002, 0.001)


def weak_motor(build: Path) -> None:
    replaced(build / "scene.xml", 'gainprm="50"', 'gainprm="49"')
    replaced(build / "scene.xml", 'biasprm="0 -50 -5"', 'biasprm="0 -49 -5"')


def other_ratio(build: Path) -> None:
    replaced(build / "scene.xml", 'polycoef="0 2 0 0 0"', 'polycoef="0 2.1 0 0 0"')


def they_touch(build: Path) -> None:
    replaced(build / "scene.xml", '<exclude body1="cabinet" body2="cup" />', "")


def it_rolls(build: Path) -> None:
    replaced(build / "scene.xml", 'friction="0.387298334621 0.002 0.001"', 'friction="0.387298334621 0.002 0.002"')


def stage_ratio(build: Path) -> None:
    replaced(build / "scene.usda", "float newton:mimicCoef1 = 2", "float newton:mimicCoef1 = 3")


FALSE: dict[str, tuple[str, Callable[[Path], None], str, str]] = {
    "drive": ("mujoco", weak_motor, "cabinet.slide", "drive"),
    "mimic": ("mujoco", other_ratio, "cabinet.along", "law"),
    "contact": ("mujoco", they_touch, "cabinet and cup", "contact"),
    "rolling": ("mujoco", it_rolls, "cup.shape", "rolling_friction"),
    "usd mimic": ("usd", stage_ratio, "cabinet.along", "law"),
}


@pytest.mark.parametrize("what", FALSE)
def test_what_is_false_is_found(what: str, everything: Scene, tmp_path: Path) -> None:
    name, falsify, where, quantity = FALSE[what]
    found = read(everything, name, tmp_path, falsify)
    assert (where, quantity) in {(d.name, d.quantity) for d in found.mismatches}, found.mismatches


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("robots", ["droid", "yam"])
def test_robots_are_read_back(robots: str, name: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    scene: Scene = request.getfixturevalue(robots)
    found = read(scene, name, tmp_path)
    assert [str(d) for d in found.mismatches] == []
    assert found.compared > 40


def moved_base(build: Path) -> None:
    replaced(build / "scene.xml", '<body name="left" pos="0 0.3 0"', '<body name="left" pos="0 0.31 0"')


def without_motor(build: Path) -> None:
    world = json.loads((build / "world.json").read_text())
    del world["robots"]["left"]["motors"]["joint3"]
    (build / "world.json").write_text(json.dumps(world))


def bent(build: Path) -> None:
    world = json.loads((build / "world.json").read_text())
    world["robots"]["left"]["joints"]["joint3"] += 0.1
    (build / "world.json").write_text(json.dumps(world))


@pytest.mark.parametrize(
    ("name", "falsify", "where", "quantity"),
    [
        ("mujoco", moved_base, "left", "position"),
        ("pybullet", without_motor, "left", "actuators"),
        ("pybullet", bent, "left.joint3", "joint position"),
    ],
)
def test_a_false_robot_is_found(
    name: str,
    falsify: Callable[[Path], None],
    where: str,
    quantity: str,
    yam: Scene,
    tmp_path: Path,
) -> None:
    found = read(yam, name, tmp_path, falsify)
    assert (where, quantity) in {(d.name, d.quantity) for d in found.mismatches}, found.mismatches
