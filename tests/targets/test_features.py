"""What a compile reports is what the tables say, feature by feature and backend by backend."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from simfoundry.backends import BACKENDS, compile_scene, features_of
from simfoundry.backends.features import FEATURES, Fidelity, SupportCell
from simfoundry.backends.losses import Loss, approximate, count_fates, drop
from simfoundry.backends.names import InvalidSceneError
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene
from simfoundry.scene.random_values import RandomQuantity, RandomValue
from simfoundry.targets.build import report, table
from simfoundry.targets.compile import compile_target
from simfoundry.targets.find import find_target, target_names
from simfoundry.targets.generated import cells_of
from tests.scenes import all_scenes, full_scene
from tests.targets.everything import LIGHTS, write_everything

OF_ROBOTS = ("robots", "robot_motors", "robot_contacts", "mounted_cameras")

APART = {name: name for name in (*LIGHTS, "background_mesh", "background_splat")} | dict.fromkeys(OF_ROBOTS, "robots")
APART |= {"dome_textures": "dome_textures", **dict.fromkeys(("ellipsoid", "cone"), "hulls")}
APART |= {"vary": "vary"} | dict.fromkeys(("options", "native", "sites", "sensors", "actuators"), "attachments")
"""Features that are looked at one at a time: a picture has one light, one background; robots; attachments.

Without its model a robot is left out, in all targets alike.
"""


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Scene]:
    """The scene by the feature that is added to it; without any by ``""``."""
    names = ("", *dict.fromkeys(APART.values()))
    found = {name: lower_file(write_everything(tmp_path_factory.mktemp("scene"), name)) for name in names}
    mass = RandomValue("object.cup.mass", RandomQuantity.MASS, ("cup",), "objects", "scale", "uniform", (0.8, 1.2))
    return found | {"vary": replace(found["vary"], random_values=(mass,))}


@pytest.fixture(scope="module")
def variety() -> dict[str, Scene]:
    return all_scenes()


@pytest.fixture(scope="module")
def losses(scenes: dict[str, Scene]) -> Callable[[str, str], tuple[Loss, ...]]:
    """What a target loses of one of the scenes, each compiled once."""
    return cache(lambda target, name: compile_target(scenes[name], find_target(target)).losses)


@pytest.fixture(scope="module")
def reported(
    losses: Callable[[str, str], tuple[Loss, ...]],
) -> Callable[[str, str], dict[str, set[Fidelity]]]:
    """What becomes of each feature that a target does not keep in one of the scenes."""

    def found(target: str, name: str) -> dict[str, set[Fidelity]]:
        fidelities: dict[str, set[Fidelity]] = {}
        for loss in losses(target, name):
            fidelities.setdefault(loss.feature, set()).add(loss.fidelity)
        return fidelities

    return cache(found)


def test_the_scene_uses_every_feature(scenes: dict[str, Scene]) -> None:
    unused = [name for name, f in FEATURES.items() if not any(f.users(scenes[APART.get(name, "")]))]
    assert unused == []


@pytest.mark.parametrize("backend", BACKENDS.names())
def test_every_backend_decides_on_every_feature(backend: str) -> None:
    assert set(features_of(backend)) == set(FEATURES)
    assert all(cell.reason for cell in features_of(backend).values() if cell.fidelity is not None)


@pytest.mark.parametrize("feature", FEATURES)
@pytest.mark.parametrize("target", target_names())
def test_a_compile_reports_what_the_table_says(
    target: str, feature: str, reported: Callable[[str, str], dict[str, set[Fidelity]]]
) -> None:
    fidelity = cells_of(find_target(target))[feature].fidelity
    found = reported(target, APART.get(feature, "")).get(feature, set())
    assert found == (set() if fidelity is None else {fidelity})


@pytest.mark.parametrize("target", target_names())
def test_every_loss_belongs_to_a_feature(target: str, variety: dict[str, Scene]) -> None:
    for scene in variety.values():
        for loss in compile_target(scene, find_target(target)).losses:
            assert loss.feature in FEATURES, loss
            fates = count_fates(scene, [loss])
            assert loss.feature not in fates or fates[loss.feature].get(loss.fidelity.value), loss


def test_users_are_counted_once_each_and_the_worst_counts() -> None:
    scene = full_scene()
    objects = len(scene.objects)
    assert count_fates(scene, [])["mass"] == {"kept": objects}
    one = approximate("friction", "puck", "")
    assert count_fates(scene, [one])["friction"] == {"kept": objects - 1, "approximated": 1}
    worse = drop("friction", "puck", "")
    assert count_fates(scene, [one, worse])["friction"] == count_fates(scene, [worse, one])["friction"]
    assert count_fates(scene, [worse])["friction"] == {"kept": objects - 1, "dropped": 1}
    everywhere = approximate("friction", "", "")
    assert count_fates(scene, [everywhere])["friction"] == {"approximated": objects}
    hinge = drop("joint_friction", "cabinet.hinge", "")
    assert count_fates(scene, [hinge])["joint_friction"] == {"kept": 2, "dropped": 1}
    assert "friction" in count_fates(scene, [hinge]) and count_fates(scene, [hinge])["friction"] == {"kept": objects}


def test_an_element_named_like_a_feature_is_not_that_feature(tmp_path: Path) -> None:
    """A dome light called `box` is approximated; the boxes of the scene are kept."""
    path = tmp_path / "lit.scene.yaml"
    path.write_text(
        "simfoundry: scene/1\nname: lit\nobjects: {crate: {mass: 1, shape: {box: [0.1, 0.1, 0.1]}}}\n"
        "lights: {box: {type: dome, intensity: 0.3}}\n"
    )
    scene = lower_file(path)
    (losses,) = (entry["losses"] for entry in report(scene, [compile_scene(scene, "mjcf")]).values())
    found = count_fates(scene, compile_scene(scene, "mjcf").losses)
    assert found["box"] == {"kept": 1} and found["dome_lights"] == {"approximated": 1}
    (light,) = (loss for loss in losses if loss["element"] == "box")
    assert (light["feature"], light["fidelity"], light["size"]) == ("dome_lights", "approximated", None)


def test_a_backend_rejects_what_it_cannot_compile(monkeypatch: pytest.MonkeyPatch) -> None:
    """A scene that uses a rejected feature gives one sentence, and no files."""
    backend = BACKENDS.load("urdf")
    cells = {**backend.features, "capsule": SupportCell(Fidelity.REJECTED, "It knows no capsules.")}
    monkeypatch.setattr("simfoundry.backends.urdf.BACKEND", replace(backend, features=cells))
    scene = all_scenes()["primitives"]
    with pytest.raises(InvalidSceneError, match=r"rejects collision capsules \(`pill`\): It knows no capsules\."):
        compile_scene(scene, "urdf")


def test_counts_of_a_report_add_up_to_the_users(scenes: dict[str, Scene]) -> None:
    scene = scenes["distant_lights"]
    data = report(scene, [compile_scene(scene, backend) for backend in BACKENDS.names()])
    for entry in data.values():
        counts = {name: sum(found.values()) for name, found in entry["features"].items()}
        assert counts == {n: len(list(f.users(scene))) for n, f in FEATURES.items() if any(f.users(scene))}
    assert json.loads(json.dumps(data)) == data
    assert data["usd"]["features"]["variants"] == {"kept": 1}
    assert data["mjcf"]["features"]["variants"] == {"dropped": 1}


def test_the_table_shows_what_some_target_does_not_keep(scenes: dict[str, Scene]) -> None:
    scene = scenes[""]
    lines = table(report(scene, [compile_scene(scene, backend) for backend in ("mjcf", "usd")]))
    assert lines[0].split() == ["not", "kept", "mjcf", "usd"]
    assert [line.split()[0] for line in lines[1:-1]] == [
        "robots",
        "robot_motors",
        "robot_contacts",
        "mounted_cameras",
        "variants",
        "collision_shape",
        "friction",
        "restitution",
        "torsional_friction",
        "rolling_friction",
        "several_axes",
        "joint_velocity",
    ]
    assert lines[1].split() == ["robots", "-1", "-1"]
    assert lines[5].split() == ["variants", "-1"]
    in_use = sum(1 for f in FEATURES.values() if any(f.users(scene)))
    assert lines[-1] == f"preserved by all targets: {in_use - 12} of the {in_use} features in use"


def test_a_robot_that_is_there_is_told_from_one_that_is_not(
    scenes: dict[str, Scene], losses: Callable[[str, str], tuple[Loss, ...]]
) -> None:
    def told(name: str, target: str) -> list[dict[str, int]]:
        found = count_fates(scenes[name], losses(target, name))
        return [found[feature] for feature in OF_ROBOTS]

    kept, near, lost = ({fate: 1} for fate in ("kept", "approximated", "dropped"))
    assert scenes[""].robots == () and all(told("", target) == [lost] * 4 for target in target_names())
    assert told("robots", "mujoco") == [kept, kept, near, kept]
    assert told("robots", "pybullet") == [near, near, near, lost]
    assert told("robots", "urdf") == [near, lost, lost, lost]
    assert told("robots", "sapien") == told("robots", "drake") == [near, kept, near, lost]
    assert told("robots", "usd") == [near, kept, near, kept]


def test_the_page_is_what_the_tables_say() -> None:
    from simfoundry.targets.generated import PAGE, support_page

    assert (Path(__file__).resolve().parents[2] / PAGE).read_text() == support_page()
