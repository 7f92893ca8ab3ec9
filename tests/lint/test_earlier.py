"""Drafts that reuse the objects of an earlier draft of the same document."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np

from simfoundry.lint.draft import DraftScene, drafted
from simfoundry.lint.lints import lint, lint_subject, subject_of
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.load import load

SCENE = """\
simfoundry: scene/1
name: desk
materials:
  oak: {density: 700, friction: 0.5}
frames:
  corner: {xyz: [0.2, 0.1, 0], yaw_deg: 30}
  shelf_top: {on: shelf}
objects:
  desk: {shape: {box: [2, 2, 0.1]}, material: oak, fixed: true, pose: {xyz: [0, 0, -0.05]}}
  shelf: {shape: {box: [0.4, 0.3, 0.2]}, material: oak, place: {on: desk, xy: [0.5, 0.5]}}
  box: {shape: {box: [0.1, 0.1, 0.1]}, material: oak, place: {on: shelf}}
  ball: {shape: {sphere: 0.04}, mass: 0.2, place: {on: desk, left_of: shelf, gap: 0.05, seen_from: corner}}
  cube: {shape: {box: [0.1, 0.1, 0.1]}, material: oak, place: {on: desk, frame: corner, xy: [0, 0]}}
  lid: {shape: {box: [0.1, 0.1, 0.02]}, material: oak, pose: {frame: shelf_top, xyz: [0.1, 0, 0.01]}}
  rod: {shape: {cylinder: {radius: 0.01, height: 0.1}}, mass: 0.1, place: {on: desk, behind: ball, seen_from: eye}}
cameras:
  eye: {pose: {xyz: [2, 0, 1], look_at: ball}, fov_deg: 60, size: [64, 48]}
viewpoint: eye
relations: [OnTop(box, shelf), LeftOf(ball, shelf)]
"""

EDITS = (
    ("xy: [0.5, 0.5]", "xy: [0.3, 0.4]"),
    ("friction: 0.5", "friction: 0.7"),
    ("yaw_deg: 30", "yaw_deg: 80"),
    ("sphere: 0.04", "sphere: 0.05"),
    ("[2, 0, 1]", "[0, 2, 1]"),
    ("gap: 0.05", "gap: 0.1"),
    ("[0.4, 0.3, 0.2]", "[0.4, 0.3, 0.3]"),
    ("look_at: ball", "look_at: shelf"),
    ("{on: shelf}}", "{on: desk}}"),
    ("viewpoint: eye", "viewpoint: corner"),
    ("mass: 0.1", "category: stick, mass: 0.1"),
    ("behind: ball", "right_of: shelf"),
    ("frame: corner, xy: [0, 0]", "frame: corner, xy: [0.1, 0]"),
    ("relations", "no_contact: [[box, lid]]\nrelations"),
)


def test_reused_objects_are_those_of_a_new_draft(tmp_path: Path) -> None:
    chance, path = random.Random(0), tmp_path / "desk.scene.yaml"
    chosen, earlier, reused = set[int](), None, 0
    for _ in range(60):
        chosen ^= {chance.randrange(len(EDITS))}
        text = SCENE
        for number in sorted(chosen):
            text = text.replace(*EDITS[number])
        loaded = load(path, text=text)
        if loaded.errors:
            continue
        subject, errors = subject_of(loaded, earlier=earlier)
        assert lint_subject(loaded, subject, errors) == lint(loaded)
        if subject is not None:
            draft = subject.scene
            before = earlier.scene.objects if earlier is not None else ()
            reused += len({*map(id, before)} & {*map(id, draft.scene.objects)})
            assert_equal(draft, drafted(loaded))
            earlier = draft
    assert reused > 100


def assert_equal(one: DraftScene, other: DraftScene) -> None:
    assert list(one.scene.by_name) == list(other.scene.by_name)
    for name, item in one.scene.by_name.items():
        new = other.scene.by_name[name]
        assert (item.category, item.fixed, item.no_contact) == (new.category, new.fixed, new.no_contact)
        np.testing.assert_array_equal(item.X_WO.p, new.X_WO.p)
        np.testing.assert_array_equal(item.X_WO.q, new.X_WO.q)
        for link, fresh in zip(item.links, new.links, strict=True):
            assert link.mass == fresh.mass
            assert [c.friction for c in link.colliders] == [c.friction for c in fresh.colliders]


def test_a_draft_that_fails_leaves_the_earlier_one_usable(tmp_path: Path) -> None:
    path = tmp_path / "desk.scene.yaml"
    earlier = drafted(load(path, text=SCENE))
    off = load(path, text=SCENE.replace("xy: [0.5, 0.5]", "xy: [5, 5]"))
    try:
        drafted(off, earlier=earlier)
    except SpecError as error:
        assert [d.code for d in error.diagnostics] == ["SF210"]
    assert_equal(drafted(load(path, text=SCENE), earlier=earlier), earlier)
