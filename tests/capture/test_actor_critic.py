"""Joints from a vision-language model: its answers are recorded here, and everything else is real."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pydantic_ai", reason="the extra `vlm` is not installed")
from pydantic_ai import BinaryContent
from pydantic_ai.messages import UserPromptPart

from simfoundry.assets.mesh import merged, read_mesh
from simfoundry.capture.articulation.actor_critic import ROUNDS, propose_joints
from simfoundry.capture.articulation.segments import SegmentedMesh, divide, in_object_frame
from simfoundry.models.contract import ModelError
from simfoundry.models.offline import OfflineMeshes
from tests.capture.meshes import number_of, write_cabinet
from tests.models.test_vlm import answering

pytestmark = pytest.mark.slow  # 5 s: a server answers in each


@pytest.fixture(scope="module")
def cabinet(tmp_path_factory: pytest.TempPathFactory) -> SegmentedMesh:
    pieces = in_object_frame(read_mesh(write_cabinet(tmp_path_factory.mktemp("mesh") / "cabinet.obj")), "-y")
    return divide(pieces, OfflineMeshes().segment_mesh(*merged(pieces)).labels)


def door(cabinet: SegmentedMesh, hinge: str) -> str:
    boxes = [(segment.low, segment.high) for segment in cabinet.segments]
    segments = [number_of(name, boxes) for name in ("door", "door_handle")]
    joint = {"name": "door", "segments": segments, "type": "revolute", "hinge": hinge, "opens": "front", "travel": 100}
    return json.dumps({"joints": [joint]})


def critique(rating: int, fault: str, suggestion: str = "") -> str:
    return json.dumps({"rating": rating, "fault": fault, "suggestion": suggestion})


def said(sent: list[Any], index: int) -> tuple[str, int]:
    """Return the text of a request, and the number of its pictures."""
    (part,) = [p for p in sent[index][0][0].parts if isinstance(p, UserPromptPart)]
    return str(part.content[-1]), sum(isinstance(piece, BinaryContent) for piece in part.content)


def test_the_critic_s_advice_reaches_the_actor(cabinet: SegmentedMesh) -> None:
    physics = json.dumps(
        {"parts": [{"name": "door", "mass": 1.5, "joint_friction": 0.02}, {"name": "body", "mass": 9}]}
    )
    vlm, sent = answering(
        door(cabinet, "front_right"),
        critique(4, "joint_axis", "its handle is at the right, so that the hinge is at the left"),
        door(cabinet, "front_left"),
        critique(9, "none"),
        physics,
    )
    found = propose_joints(vlm, cabinet)
    (joint,) = found.joints
    assert joint.axis == pytest.approx((0, 0, -1)) and found.rating == 9
    assert [c.rating for c in found.critiques] == [4, 9]
    assert found.physics["door"].mass == 1.5 and found.physics["body"].joint_damping is None
    actor, pictures = said(sent, 0)
    assert "- 9: " in actor and pictures == 2
    again, _ = said(sent, 2)
    assert "its handle is at the right" in again and '"front_right"' in again
    assert said(sent, 1)[1] == 2 and "door (revolute)" in said(sent, 1)[0]
    assert len(sent) == 5


def test_joints_that_do_not_fit_are_told_to_the_actor(cabinet: SegmentedMesh) -> None:
    wrong = door(cabinet, "front_left").replace('"segments": [', '"segments": [77, ')
    vlm, sent = answering(wrong, door(cabinet, "front_left"), critique(8, "none"), '{"parts": []}')
    assert propose_joints(vlm, cabinet).rating == 8
    assert "there is no segment 77" in said(sent, 1)[0]


@pytest.mark.slow  # 4 s: it renders five rounds
def test_the_best_round_counts_and_the_rounds_end(cabinet: SegmentedMesh) -> None:
    rounds = [door(cabinet, "front_left"), critique(6, "joint_limit")]
    for _ in range(ROUNDS - 1):
        rounds += [door(cabinet, "front_right"), critique(2, "joint_axis", "worse")]
    vlm, sent = answering(*rounds, '{"parts": []}')
    found = propose_joints(vlm, cabinet)
    assert (found.rating, found.joints[0].axis[2], len(sent)) == (6, -1, 2 * ROUNDS + 1)


def test_a_model_that_finds_nothing(cabinet: SegmentedMesh) -> None:
    vlm, sent = answering('{"joints": []}')
    with pytest.raises(ModelError, match="did not place joints on the mesh in 5 attempts: no part moves"):
        propose_joints(vlm, cabinet)
    assert len(sent) == ROUNDS


def test_a_provider_that_may_not_be_used_commercially(tmp_path: Path) -> None:
    from simfoundry.models.open import open_provider
    from simfoundry.models.setup import load_setup

    (tmp_path / "simfoundry.yaml").write_text("models: {tasks: {articulate: {vlm: test}}}")
    assert open_provider(load_setup(tmp_path, {}), "articulate") is not None
    with pytest.raises(ModelError, match="no known licence for commercial use"):
        open_provider(load_setup(tmp_path, {}, commercial_only=True), "articulate")
    (tmp_path / "simfoundry.yaml").write_text("models: {accepted: [test], tasks: {articulate: {vlm: test}}}")
    assert open_provider(load_setup(tmp_path, {}, commercial_only=True), "articulate") is not None
