"""Contacts in MJCF: whatever way they are written, each is what its two surfaces mean together."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import mujoco
import numpy as np
import pytest

from simfoundry.backends.mjcf import compile_mjcf
from simfoundry.backends.mjcf.contacts import contacts_of
from simfoundry.backends.mjcf.foreign_geoms import Guests
from simfoundry.backends.mjcf.restitution import solref
from simfoundry.backends.mjcf.surfaces import Surface, felt, meant
from simfoundry.runtime.plugins import import_file
from simfoundry.runtime.shipped import shipped
from simfoundry.scene.model import Collider, Scene, SceneObject
from simfoundry.scene.touching import silent_pairs
from tests.backends.test_mjcf import load
from tests.mechanisms import mechanisms
from tests.scenes import box, full_scene, pose, scene_of, solid

HULLS = 6

Meetings = import_file(shipped("targets/mujoco") / "contacts.py").Meetings


def many(name: str, surface: Surface, x: float, fixed: bool = False) -> SceneObject:
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
        Surface(0.2 + 0.05 * k, 0.3 if k % 3 == 2 else 0.0, 0.004 if k == 1 else 0.0, 0.002 if k == 3 else 0.0)
        for k in range(surfaces)
    ]
    things = [many(f"thing_{k}_{n}", kind, 0.3 * n + 3 * k) for k, kind in enumerate(kinds) for n in range(each)]
    tables = [
        many("table", Surface(0.9, 0.1, 0.0, 0.0), -5, fixed=True),
        many("desk", Surface(0.5, 0.4, 0.001, 0.0), -8, fixed=True),
        many("floor", kinds[0], -9, fixed=True),
    ]
    return scene_of(*tables, *things)


def expected(scene: Scene) -> Iterator[tuple[str, str, Surface]]:
    """Every two colliders that can meet, with what their contact should feel like."""
    silent = {frozenset((o.qualified(a), o.qualified(b))) for o in scene.objects for a, b in silent_pairs(o)}
    silent |= {frozenset(pair) for pair in scene.no_contact}
    geoms = [geom for item in scene.objects for geom in felt(item)]
    for a, b in product(geoms, geoms):
        if a.link < b.link and not (a.static and b.static) and frozenset((a.link, b.link)) not in silent:
            yield a.geom, b.geom, meant(a.surface, b.surface)


@pytest.mark.parametrize("scene", [crowd(1, 3), crowd(4, 2), crowd(5, 1), crowd(34, 1), full_scene(), mechanisms()])
def test_each_contact_is_what_its_surfaces_mean(scene: Scene) -> None:
    model = load(compile_mjcf(scene))
    found = {frozenset((a, b)): met for a, b, met in Meetings(model).contacts()}
    wanted = {frozenset((a, b)): surface for a, b, surface in expected(scene)}
    assert found.keys() == wanted.keys()
    for names, surface in wanted.items():
        right = (surface.friction, surface.spinning, surface.rolling)
        assert found[names] == pytest.approx(right, rel=1e-9), names


def test_mujoco_itself_makes_the_contacts_that_are_meant() -> None:
    """All things of a crowd in one place: friction, damping and dimensions are those of MuJoCo's own contacts."""
    scene = crowd(5, 2)
    model = load(compile_mjcf(scene))
    data = mujoco.MjData(model)
    for k in range(model.nbody):
        model.body_pos[k] = (0, 0, 0) if ":" in model.body(k).name else (0.001 * k, 0, 0)
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


def test_tables_need_no_pairs_and_things_of_few_surfaces_hardly_any() -> None:
    assert load(compile_mjcf(crowd(1, 5))).npair == 0
    assert load(compile_mjcf(crowd(2, 1))).npair == 0
    model = load(compile_mjcf(crowd(4, 1)))
    assert 0 < model.npair <= 3 * HULLS**2  # of six kinds of contact, three are decided by priority


def guest(friction: float, priority: int = 0, masks: tuple[int, int] = (1, 1), soft: bool = True) -> Guests:
    return Guests(
        np.array([masks]), np.array([priority]), np.array([3]), np.array([[friction, 0.005, 0.0001]]), np.array([soft])
    )


def test_what_a_robot_touches_stays_as_mujoco_has_it() -> None:
    """A geom of a robot is the larger friction of the two or its own; surfaces that this would change stay as is."""
    scene = crowd(7, 1)
    slippery = contacts_of(scene, guest(0.3))
    for surface, way in slippery.ways.items():
        assert (way.priority, way.surface) == (0, surface) or surface.friction <= 0.3
    rough = contacts_of(scene, guest(1.0))
    decided = [(surface, way) for surface, way in rough.ways.items() if way.priority]
    assert decided and all(way.priority < 0 and not surface.restitution and not surface.rolling
                           for surface, way in decided)  # fmt: skip
    assert contacts_of(scene, guest(0.1, priority=1)).ways == contacts_of(scene, Guests()).ways
    assert all(way.priority == 0 for way in contacts_of(scene, guest(0.1, priority=-1)).ways.values())
    assert all(way.priority == 0 for way in contacts_of(scene, guest(1.0, soft=False)).ways.values())


def test_masks_are_none_that_a_robot_has() -> None:
    scene = crowd(4, 1)
    plan = contacts_of(scene, guest(1.0, masks=(0b101, 0b11)))
    assert plan.twins
    used = plan.shared | sum(plan.bits.values())
    assert not used & 0b111
    assert contacts_of(scene, guest(1.0, masks=(0b100, 1))).twins == {}  # it would not be heard by the tables


def test_a_box_slides_where_its_two_surfaces_say() -> None:
    """With twins, as decomposed things have them: 26.10 degrees for 0.3 on 0.8, where the larger would be 38.7."""
    mu = math.sqrt(0.3 * 0.8)
    assert slides(math.atan(mu) + math.radians(1))
    assert not slides(math.atan(mu) - math.radians(1))


def slides(angle: float) -> bool:
    """Whether a stack of boxes on a table slides where gravity leans by ``angle`` [rad]."""
    thing = many("thing", Surface(0.3, 0.0, 0.0, 0.0), 0)
    thing = replace(thing, X_WO=pose(0, 0, 0.01))  # on the table, whose top is at 0
    table = many("table", Surface(0.8, 0.0, 0.0, 0.0), 0, fixed=True)
    table = replace(
        table,
        X_WO=pose(0, 0, -0.3),
        links=(replace(table.root, colliders=tuple(
            replace(c, geometry=box(4, 4, 0.1), X_LG=pose(0, 0, 0.25 - 0.1 * k))
            for k, c in enumerate(table.root.colliders)
        )),),
    )  # fmt: skip
    gravity = 9.81 * np.array([math.sin(angle), 0, -math.cos(angle)])
    model = load(compile_mjcf(replace(scene_of(table, thing), gravity=gravity)))
    assert any(":touch" in model.body(k).name for k in range(model.nbody))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, 500)
    return bool(abs(data.qvel[0]) > 0.02)
