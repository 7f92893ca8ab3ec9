"""A scene that says all that a spec can, and robots, read back; and builds of them that are false."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import pytest

from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene
from simfoundry.verify.compare import ReadbackComparison, compare
from simfoundry.verify.engines import find_engine
from simfoundry.verify.expected import expected_readback
from simfoundry.verify.process import EngineJob, ask
from simfoundry.verify.run import built
from tests.targets.everything import write_everything
from tests.verify.test_readback import replaced

ENGINES = ("mujoco", "pybullet", "usd")


@pytest.fixture(scope="module")
def everything(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return lower_file(write_everything(tmp_path_factory.mktemp("everything")))


Falsify = Callable[[Path], None]


def read(scene: Scene, name: str, folder: Path, falsified: Mapping[str, Falsify]) -> dict[str, ReadbackComparison]:
    """Compare what an engine holds of a build with its scene: untouched by ``""``, and of builds tampered with.

    One process reads them all: to start one takes longer than to read a build.
    """
    pytest.importorskip({"usd": "pxr"}.get(name, name), reason=f"{name} is not installed")
    engine = find_engine(name)
    subjects = [built(f"n{k}", scene, [engine], folder / name / f"n{k}") for k in range(len(falsified) + 1)]
    builds = [subject.builds[name] for subject in subjects]
    for falsify, build in zip(falsified.values(), builds[1:], strict=True):
        falsify(build)
    answers = ask(Path(sys.executable), engine.readback, [EngineJob(build) for build in builds], timeout=60)
    assert all(answer.facts is not None for answer in answers), [answer.error for answer in answers]
    return {
        what: compare(scene, answer.facts, engine, subject.losses[name])
        for what, answer, subject in zip(("", *falsified), answers, subjects, strict=True)
        if answer.facts is not None
    }


Readings = Callable[[str], dict[str, ReadbackComparison]]


@pytest.fixture(scope="module")
def readings(everything: Scene, tmp_path_factory: pytest.TempPathFactory) -> Readings:
    """What comes of comparing the builds of the scene, by engine and then by what was falsified."""
    folder = tmp_path_factory.mktemp("readings")
    return cache(
        lambda name: read(everything, name, folder, {w: change for w, (of, change, *_) in FALSE.items() if of == name})
    )


@pytest.mark.parametrize("name", ENGINES)
def test_all_that_a_spec_can_say_is_read_back(name: str, readings: Readings) -> None:
    found = readings(name)[""]
    assert [str(d) for d in found.mismatches] == []
    covered = {(d.name.partition(".")[0], d.quantity) for d in found.covered}
    known = {"pybullet": {("tile", "bounds")}, "mujoco": {("cabinet", "max_velocity")}}  # the tile's tips are sharp
    assert covered == known.get(name, set())
    assert found.stale == ()


def test_what_is_expected_of_it_has_every_quantity(everything: Scene) -> None:
    facts = expected_readback(everything, "mjcf")
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
    replaced(build / "scene.xml", 'friction="0.3 0.002 0.001"', 'friction="0.3 0.002 0.002"')


def stage_ratio(build: Path) -> None:
    replaced(build / "scene.usda", "float newton:mimicCoef1 = 2", "float newton:mimicCoef1 = 3")


FALSE: dict[str, tuple[str, Falsify, str, str]] = {
    "drive": ("mujoco", weak_motor, "cabinet.slide", "drive"),
    "mimic": ("mujoco", other_ratio, "cabinet.along", "law"),
    "contact": ("mujoco", they_touch, "cabinet and cup", "contact"),
    "rolling": ("mujoco", it_rolls, "cup.shape", "rolling_friction"),
    "usd mimic": ("usd", stage_ratio, "cabinet.along", "law"),
}


@pytest.mark.parametrize("what", FALSE)
def test_what_is_false_is_found(what: str, readings: Readings) -> None:
    name, _, where, quantity = FALSE[what]
    found = readings(name)[what]
    assert (where, quantity) in {(d.name, d.quantity) for d in found.mismatches}, found.mismatches


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


FALSE_ROBOTS: dict[str, tuple[str, Falsify, str, str]] = {
    "base": ("mujoco", moved_base, "left", "position"),
    "motor": ("pybullet", without_motor, "left", "actuators"),
    "joint": ("pybullet", bent, "left.joint3", "joint position"),
}


@pytest.fixture(scope="module")
def readings_of_yam(yam: Scene, tmp_path_factory: pytest.TempPathFactory) -> Readings:
    folder = tmp_path_factory.mktemp("readings_of_yam")
    return cache(
        lambda name: read(yam, name, folder, {w: change for w, (of, change, *_) in FALSE_ROBOTS.items() if of == name})
    )


@pytest.mark.slow  # 5 s: a robot
@pytest.mark.parametrize("name", ENGINES)
def test_two_arms_are_read_back(name: str, readings_of_yam: Readings) -> None:
    found = readings_of_yam(name)[""]
    assert [str(d) for d in found.mismatches] == []
    assert found.compared > 40


@pytest.mark.slow  # 5 s: a robot
@pytest.mark.parametrize("name", ENGINES)
def test_a_robot_is_read_back(name: str, droid: Scene, tmp_path: Path) -> None:
    found = read(droid, name, tmp_path, {})[""]
    assert [str(d) for d in found.mismatches] == []
    assert found.compared > 40


@pytest.mark.parametrize("what", FALSE_ROBOTS)
def test_a_false_robot_is_found(what: str, readings_of_yam: Readings) -> None:
    name, _, where, quantity = FALSE_ROBOTS[what]
    found = readings_of_yam(name)[what]
    assert (where, quantity) in {(d.name, d.quantity) for d in found.mismatches}, found.mismatches
