"""Masses, and where they come from."""

from __future__ import annotations

import numpy as np
import pytest

from simfoundry.scene.lower import OBJECT_PASSES, Lowering
from simfoundry.scene.mass_facts import mass_source, object_mass, volume_text
from simfoundry.spec.load import load
from tests.conftest import REPOSITORY

SHAPES = """\
simfoundry: scene/1
name: a
materials:
  oak: {density: 500}
  tin: {density: 7000}
objects:
  given: {shape: {box: [0.1, 0.1, 0.1]}, mass: 2}
  guessed: {shape: {box: [0.1, 0.1, 0.1]}, mass: {value: 2, range: [1, 3], source: a table}}
  dense: {shape: {box: [0.1, 0.1, 0.1]}, density: 800}
  wooden: {shape: {box: [0.1, 0.1, 0.2]}, material: oak}
  still: {shape: {box: [1, 1, 1]}, fixed: true}
  mixed:
    shape:
      compound:
        a: {shape: {box: [0.1, 0.1, 0.1]}, material: oak}
        b: {shape: {box: [0.1, 0.1, 0.1]}, material: tin, pose: {xyz: [0.2, 0, 0]}}
"""


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("given", "given"),
        ("guessed", "estimated by a table, 1 to 3 kg"),
        ("dense", "800 kg/m³ × 1 l"),
        ("wooden", "500 kg/m³ (`oak`) × 2 l"),
        ("still", "1000 kg/m³ (assumed, because the object is fixed) × 1 m³"),
        ("mixed", "from the densities of `oak`, `tin`"),
    ],
)
def test_the_source_of_a_mass(name: str, expected: str) -> None:
    loaded = load(REPOSITORY / "a.scene.yaml", text=SHAPES)
    scene = Lowering(loaded, draft=True).run(OBJECT_PASSES)
    assert mass_source(loaded, scene.by_name[name]) == expected


def test_the_mass_of_an_articulated_object_is_that_of_its_links() -> None:
    loaded = load(REPOSITORY / "specs/assets/gallery.scene.yaml")
    item = Lowering(loaded, draft=True).run(OBJECT_PASSES).by_name["cabinet"]
    facts = object_mass(item)
    assert facts.mass == pytest.approx(sum(link.mass for link in item.links))
    assert mass_source(loaded, item) == "sum of 3 links"
    assert "650 kg/m³" in mass_source(loaded, item, "body")
    # An open drawer (11 cm) moves the center of mass to the front by its share of the mass.
    drawer = next(link for link in item.links if link.name == "drawer")
    body = next(link for link in item.links if link.name == "body")
    lower = next(link for link in item.links if link.name == "bottom_drawer")
    x = [body.com[0], drawer.com[0] + 0.11 + _joint_x(item, "drawer"), lower.com[0] + _joint_x(item, "bottom_drawer")]
    assert facts.com[0] == pytest.approx(np.average(x, weights=[body.mass, drawer.mass, lower.mass]))


def _joint_x(item: object, name: str) -> float:
    return next(float(j.X_PC.p[0]) for j in item.joints if j.name == name)  # type: ignore[attr-defined]


def test_volumes_have_a_readable_unit() -> None:
    assert [volume_text(v) for v in (2.0, 0.0123, 5.71e-4)] == ["2 m³", "12.3 l", "571 cm³"]
