"""Contacts in MJCF: each is what its two surfaces mean together, in the files and in memory."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path

import mujoco
import numpy as np
import pytest

from simfoundry.backends.losses import Size
from simfoundry.backends.mjcf import compile_mjcf
from simfoundry.backends.mjcf.contact_rules import (
    MAX_PAIRS,
    PROXY,
    ContactSurface,
    desired_contact,
    solref,
)
from simfoundry.backends.mjcf.contacts import exact_model, object_geoms
from simfoundry.backends.names import InvalidSceneError
from simfoundry.geometry.shapes import Sphere
from simfoundry.runtime.files import shipped
from simfoundry.runtime.plugins import import_file
from simfoundry.scene.kinematics import excluded_link_pairs
from simfoundry.scene.model import Collider, Scene, SceneObject
from tests.backends.test_mjcf import load
from tests.mechanisms import mechanisms
from tests.scenes import box, full_scene, pose, scene_of, solid

HULLS = 6

Meetings = import_file(shipped("targets/mujoco") / "contacts.py").Meetings


def many(name: str, surface: ContactSurface, x: float, fixed: bool = False) -> SceneObject:
    """A stack of boxes, each a collider: as a decomposed thing."""
    plain = solid(name, box(0.1, 0.1, 0.02), pose(x, 0, 0.5), fixed=fixed)
    parts = tuple(
        Collider(f"part_{k}", box(0.1, 0.1, 0.02), surface.friction, surface.restitution, pose(0, 0, 0.02 * k),
                 surface.spinning, surface.rolling)
        for k in range(HULLS)
    )  # fmt: skip
    return replace(plain, links=(replace(plain.root, colliders=parts),))


def crowd(surfaces: int, each: int) -> Scene:
    """Things of so many surfaces, so many of each, with two tables and a floor like the first."""
    kinds = [
        ContactSurface(0.2 + 0.05 * k, 0.3 if k % 3 == 2 else 0.0, 0.004 if k == 1 else 0.0, 0.002 if k == 3 else 0.0)
        for k in range(surfaces)
    ]
    things = [many(f"thing_{k}_{n}", kind, 0.3 * n + 3 * k) for k, kind in enumerate(kinds) for n in range(each)]
    tables = [
        many("table", ContactSurface(0.9, 0.1, 0.0, 0.0), -5, fixed=True),
        many("desk", ContactSurface(0.5, 0.4, 0.001, 0.0), -8, fixed=True),
        many("floor", kinds[0], -9, fixed=True),
    ]
    return scene_of(*tables, *things)


def expected(scene: Scene) -> Iterator[tuple[str, str, ContactSurface]]:
    """Every two colliders that can meet, with what their contact should feel like."""
    silent = {frozenset((o.qualified(a), o.qualified(b))) for o in scene.objects for a, b in excluded_link_pairs(o)}
    silent |= {frozenset(pair) for pair in scene.no_contact}
    geoms = [geom for item in scene.objects for geom in object_geoms(item)]
    for a, b in product(geoms, geoms):
        if a.body < b.body and not (a.static and b.static) and frozenset((a.body, b.body)) not in silent:
            yield a.name, b.name, desired_contact(a.surface, b.surface)


def load_files(scene: Scene) -> mujoco.MjModel:
    return load(compile_mjcf(scene))


@pytest.mark.parametrize("scene", [crowd(1, 3), crowd(4, 2), crowd(5, 1), crowd(34, 1), full_scene(), mechanisms()])
def in_memory(scene: Scene) -> mujoco.MjModel:
    return exact_model(compile_mjcf(scene).files)


SCENES = {
    "one": crowd(1, 3),
    "four": crowd(4, 2),
    "five": crowd(5, 1),
    "full": full_scene(),
    "mechanisms": mechanisms(),
}


@pytest.mark.parametrize("read", [load_files, in_memory])
@pytest.mark.parametrize("name", SCENES)
def test_each_contact_is_what_its_surfaces_mean(name: str, read: Callable[[Scene], mujoco.MjModel]) -> None:
    check_contacts(SCENES[name], read(SCENES[name]))


def test_more_surfaces_than_masks_have_bits_are_exact_in_memory() -> None:
    scene = crowd(34, 1)
    check_contacts(scene, in_memory(scene))


def check_contacts(scene: Scene, model: mujoco.MjModel) -> None:
    found = {frozenset((a, b)): met for a, b, met in Meetings(model).contacts()}
    wanted = {frozenset((a, b)): surface for a, b, surface in expected(scene)}
    assert found.keys() == wanted.keys()
    for names, surface in wanted.items():
        right = (surface.friction, surface.spinning, surface.rolling)
        assert found[names] == pytest.approx(right, rel=1e-9), names


def test_mujoco_itself_makes_the_desired_contacts() -> None:
    """All things of a crowd in one place: friction, damping and dimensions are those of MuJoCo's own contacts."""
    scene = crowd(5, 2)
    model = in_memory(scene)
    data = mujoco.MjData(model)
    for k in range(model.nbody):
        model.body_pos[k] = (0, 0, 0) if PROXY in model.body(k).name else (0.001 * k, 0, 0)
    for joint in range(model.njnt):
        data.qpos[model.jnt_qposadr[joint] : model.jnt_qposadr[joint] + 7] = [0.001 * joint, 0, 0, 1, 0, 0, 0]
    mujoco.mj_forward(model, data)
    wanted = {frozenset((a, b)): surface for a, b, surface in expected(scene)}
    met: dict[frozenset[str], tuple[str, ...]] = {}
    for contact in data.contact:
        names = [model.geom(int(g)).name for g in contact.geom]
        pair = frozenset(name.partition(":")[0] for name in names)
        assert met.setdefault(pair, tuple(sorted(names))) == tuple(sorted(names))  # no two touch twice
        surface = wanted[pair]
        assert contact.dim == (6 if surface.rolling else 4 if surface.spinning else 3)
        right = [surface.friction, surface.spinning, surface.rolling]
        counts = [True, contact.dim > 3, contact.dim > 4]
        np.testing.assert_allclose(
            contact.friction[[0, 2, 3]][counts], np.maximum(right, mujoco.mjMINMU)[counts], rtol=1e-9
        )
        np.testing.assert_allclose(contact.solref, solref(surface.restitution), rtol=1e-9)
    links = {frozenset(name.partition(".")[0] for name in pair) for pair in met}
    assert links == {frozenset(name.partition(".")[0] for name in pair) for pair in wanted}


def test_every_geom_of_the_files_has_its_own_numbers() -> None:
    scene = crowd(5, 2)
    model = load_files(scene)
    for item in scene.objects:
        for geom in object_geoms(item):
            assert model.geom(geom.name).friction[0] == pytest.approx(geom.surface.friction, rel=1e-11)
    assert not model.geom_priority.any() and model.nbody == 1 + sum(len(item.links) for item in scene.objects)


def test_unlike_geoms_have_few_pairs_in_memory() -> None:
    scene = crowd(4, 2)
    model = in_memory(scene)
    colliders = sum(1 for item in scene.objects for _ in object_geoms(item))
    assert model.npair < 1000 and sum(PROXY in model.geom(k).name for k in range(model.ngeom)) < 3 * colliders
    assert load_files(scene).npair > 1000


def test_a_scene_of_many_pairs_has_those_of_its_tables_and_says_which_it_has_not() -> None:
    scene = crowd(4, 6)
    artifact = compile_mjcf(scene)
    assert artifact.files["contacts.xml"].count(b"<pair class") <= MAX_PAIRS
    (loss,) = [loss for loss in artifact.losses if loss.feature == "friction"]
    assert loss.element == "" and loss.size is not None and 0 < loss.size.value < 0.2
    assert loss.reason.startswith("load.py makes all contacts exact; without it, ")
    model = load_files(scene)
    tables = {frozenset(names) for names in pairs_of(model) if "table.part_0" in names}
    assert len(tables) == 4 * 6 * HULLS  # each hull of each thing
    assert not [loss for loss in compile_mjcf(crowd(4, 1)).losses if loss.feature == "friction"]
    check_contacts(scene, in_memory(scene))


def test_two_hundred_objects_of_three_frictions_fit_in_files_that_a_person_can_read() -> None:
    """8,778 pairs, 1.09 MB, when every pair was written."""
    table = with_material(solid("table", box(4, 4, 0.04), pose(0, 0, -0.02), friction=0.6, fixed=True), "wood")
    things = [
        with_material(
            solid(f"thing_{k}", box(0.05, 0.04, 0.06), pose(0.12 * (k % 15), 0.12 * (k // 15), 0.03), friction=mu), name
        )
        for k in range(200)
        for mu, name in [((0.3, 0.5, 0.7)[k % 3], ("ice", "ceramic", "rubber")[k % 3])]
    ]
    scene = scene_of(table, *things)
    files = compile_mjcf(scene).files
    sizes = {path: len(data) for path, data in files.items() if path.endswith(".xml")}
    assert sizes["scene.xml"] < 150_000 and sum(sizes.values()) < 400_000
    model = exact_model(files)
    for name in ("table.shape", "thing_1.shape"):
        assert friction(model, name, "thing_0.shape") == pytest.approx(
            math.sqrt(0.3 * (0.6 if "table" in name else 0.5))
        )


def pairs_of(model: mujoco.MjModel) -> list[tuple[str, str]]:
    ends = zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)
    return [(model.geom(a).name, model.geom(b).name) for a, b in ends]


def test_native_contacts_have_no_pairs_and_say_what_that_costs() -> None:
    scene = scene_of(
        solid("a", box(1, 1, 1), pose(0, 0, 0), friction=0.3), solid("b", box(1, 1, 1), pose(2, 0, 0), friction=0.7)
    )
    artifact = compile_mjcf(scene, contacts="native")
    assert "contacts.xml" not in artifact.files and b"include" not in artifact.files["scene.xml"]
    (loss,) = [loss for loss in artifact.losses if loss.feature == "friction"]
    assert loss.reason == "MuJoCo uses the larger of a pair: 0.7 for 0.3 and 0.7; the scene specifies 0.458."
    assert loss.size == Size(0.242, "1")
    with pytest.raises(InvalidSceneError, match="option `contacts` must be `exact` or `native`, not `both`"):
        compile_mjcf(scene, contacts="both")


def friction(model: mujoco.MjModel, a: str, b: str) -> float:
    meetings = Meetings(model)
    geoms = {name: found for by_name in meetings.colliders.values() for name, found in by_name.items()}
    return float(meetings.contact(geoms[a], geoms[b]).friction)


def with_material(item: SceneObject, name: str) -> SceneObject:
    colliders = tuple(replace(c, material=name) for c in item.root.colliders)
    return replace(item, links=(replace(item.root, colliders=colliders), *item.links[1:]))


def hulls(name: str, count: int, mu: float, fixed: bool) -> SceneObject:
    """An object of one friction with so many colliders."""
    plain = solid(name, box(0.1, 0.1, 0.1), pose(0, 0, -1 if fixed else 1), friction=mu, fixed=fixed)
    (first,) = plain.root.colliders
    parts = tuple(replace(first, name=f"part_{k}") for k in range(count))
    return replace(plain, links=(replace(plain.root, colliders=parts),))


def test_a_scene_opens_even_if_each_group_is_too_large_for_the_file(tmp_path: Path) -> None:
    """A bowl of so many hulls that is fixed: 3,600 pairs, of which none is between moving objects."""
    artifact = compile_mjcf(scene_of(hulls("rack", 60, 0.2, fixed=True), hulls("cup", 60, 0.8, fixed=False)))
    artifact.write(tmp_path / "build")
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "build/scene.xml")).npair == 0
    said = (tmp_path / "build/contacts.xml").read_text()
    (loss,) = [loss for loss in artifact.losses if loss.feature == "friction"]
    assert "3600 more pairs of geoms" in said and "3600 pairs of geoms" in loss.reason
    assert "moving" not in said + loss.reason


def test_a_material_may_be_called_like_two_others_in_contact() -> None:
    table = with_material(solid("table", box(2, 2, 0.1), pose(0, 0, -0.05), friction=0.5, fixed=True), "wood")
    steel = with_material(solid("a", box(0.1, 0.1, 0.1), pose(0, 0, 0.05), friction=0.8), "steel")
    both = with_material(solid("b", box(0.1, 0.1, 0.1), pose(0.3, 0, 0.05), friction=0.3), "wood_on_steel")
    assert load_files(scene_of(table, steel, both)).npair == 3


@pytest.mark.parametrize("speed", [1.0, 3.0])
@pytest.mark.parametrize("restitution", [0.05, 0.5, 0.9])
def test_the_report_says_how_deep_an_impact_sinks_in(restitution: float, speed: float) -> None:
    scene = falling(restitution, restitution)
    (per_speed,) = re.findall(r"sinks in by up to ([0-9.]+) mm", restitution_of(scene, "ball"))
    depth, _ = impact(load_files(scene), speed)
    assert 0.8 < 1000 * depth / (float(per_speed) * speed) < 1.05  # at 0.05, the step of 2 ms adds damping


def test_native_contacts_say_what_unlike_restitutions_cost() -> None:
    """MuJoCo averages time constants too: bouncing on something dead is 60 times softer than either."""
    artifact = compile_mjcf(falling(0.9, 0.0), contacts="native")
    (loss,) = [loss for loss in artifact.losses if loss.feature == "restitution" and "averages" in loss.reason]
    assert loss.reason == (
        "MuJoCo averages the damping of a pair: it rebounds at 0.289 for 0.9 and 0; the scene specifies 0. "
        "An impact sinks in by up to 84 mm per m/s of its speed."
    )
    depth, speed = impact(load(artifact), 0.3)
    assert depth == pytest.approx(0.3 * 0.084, rel=0.05) and speed / 0.3 == pytest.approx(0.289, abs=0.01)
    assert loss.size == Size(0.289, "1")


def falling(floor: float, ball: float) -> Scene:
    """A ball that touches a floor, both with a restitution, where nothing is heavy."""
    scene = scene_of(
        solid("floor", box(2, 2, 2), pose(0, 0, -1), restitution=floor, fixed=True),
        solid("ball", Sphere(0.2), pose(0, 0, 0.2), restitution=ball),
    )
    return replace(scene, gravity=np.zeros(3))


def restitution_of(scene: Scene, name: str) -> str:
    (reason,) = [s.reason for s in compile_mjcf(scene).losses if (s.feature, s.element) == ("restitution", name)]
    return reason


def impact(model: mujoco.MjModel, speed: float) -> tuple[float, float]:
    """Return how deep a ball sinks in [m] that meets the floor at a speed [m/s], and the speed with which it leaves."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qvel[2], lowest, fastest = -speed, 0.2, 0.0
    for _ in range(500):
        mujoco.mj_step(model, data)
        lowest, fastest = min(lowest, data.qpos[2]), max(fastest, data.qvel[2])
    return 0.2 - lowest, fastest


def test_the_contacts_of_a_robot_stay_as_mujoco_makes_them() -> None:
    """Geoms of a robot meet all others and no proxy; their masks are not taken."""
    text = compile_mjcf(crowd(4, 1)).files["scene.xml"].decode()
    hand = '<geom name="arm.hand" size="0.1" friction="0.2" contype="{}" conaffinity="{}" />'
    arm = f'<body name="arm">{hand}</body></worldbody>'
    text = text.replace("<custom>", '<custom><text name="simfoundry:robots" data="arm" />')
    for contype, conaffinity in ((1, 1), (5, 3)):
        with_arm = text.replace("</worldbody>", arm.format(contype, conaffinity))
        model = exact_model({"scene.xml": with_arm.encode()})
        proxies = np.array([PROXY in model.geom(k).name for k in range(model.ngeom)])
        hand = model.geom("arm.hand").id
        met = (model.geom_contype & model.geom_conaffinity[hand]) | (model.geom_contype[hand] & model.geom_conaffinity)
        own = np.array([model.geom(f"{name}.part_0").id for name in ("thing_0_0", "thing_3_0", "table", "floor")])
        assert proxies.any() and met[own].all() and not met[proxies].any()
        assert model.geom("arm.hand").friction[0] == 0.2
    deaf = exact_model({"scene.xml": text.replace("</worldbody>", arm.format(4, 1)).encode()})
    assert not any(PROXY in deaf.geom(k).name for k in range(deaf.ngeom)) and deaf.npair


def test_a_box_slides_where_its_two_surfaces_say() -> None:
    """With proxies, as decomposed objects have them: 26.10 degrees for 0.3 on 0.8, where the larger would be 38.7."""
    mu = math.sqrt(0.3 * 0.8)
    assert slides(math.atan(mu) + math.radians(1))
    assert not slides(math.atan(mu) - math.radians(1))


def slides(angle: float) -> bool:
    """Whether a stack of boxes on a table slides where gravity leans by ``angle`` [rad]."""
    thing = many("thing", ContactSurface(0.3, 0.0, 0.0, 0.0), 0)
    thing = replace(thing, X_WO=pose(0, 0, 0.01))  # on the table, whose top is at 0
    table = many("table", ContactSurface(0.8, 0.0, 0.0, 0.0), 0, fixed=True)
    table = replace(
        table,
        X_WO=pose(0, 0, -0.3),
        links=(replace(table.root, colliders=tuple(
            replace(c, geometry=box(4, 4, 0.1), X_LG=pose(0, 0, 0.25 - 0.1 * k))
            for k, c in enumerate(table.root.colliders)
        )),),
    )  # fmt: skip
    gravity = 9.81 * np.array([math.sin(angle), 0, -math.cos(angle)])
    model = in_memory(replace(scene_of(table, thing), gravity=gravity))
    assert any(PROXY in model.geom(k).name for k in range(model.ngeom))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, 500)
    return bool(abs(data.qvel[0]) > 0.02)
