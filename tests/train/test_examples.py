"""Examples: inputs that move with the scene, and actions that survive the way through the hand's frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import simfoundry as sf
from simfoundry.data.action_conversion import ActionConverter
from simfoundry.data.trajectory import TrajectorySampler
from simfoundry.evaluate.task import load_task
from simfoundry.geometry.frames import Pose, Poses, quat_from_rpy
from simfoundry.train.examples import ACTION_SPACE, ExampleReader, Examples, absolute_actions, displaced
from simfoundry.train.situations import InputLayout, Situations, input_layout, input_vectors, word_flags

LAYOUT = InputLayout(("left", "right"), ("cup", "bowl", "lid"), ("cabinet.drawer",), ("cup", "spoon"))


def situations(n: int = 5) -> Situations:
    rng = np.random.default_rng(3)

    def poses() -> Poses:
        return Poses.of(rng.normal(size=(n, 3)), rng.normal(size=(n, 4)))

    return Situations(
        hands={name: poses() for name in LAYOUT.robots},
        grippers={name: rng.uniform(size=n) for name in LAYOUT.robots},
        objects={name: poses() for name in LAYOUT.objects},
        boxes={name: rng.uniform(size=(n, 6)) for name in LAYOUT.objects},
        joints={name: rng.uniform(size=n) for name in LAYOUT.joints},
        words=np.ones((n, 2)),
    )


def moved(now: Situations, X: Pose) -> Situations:
    first = Poses.constant(X, len(now.words))
    hands = {name: first @ pose for name, pose in now.hands.items()}
    objects = {name: first @ pose for name, pose in now.objects.items()}
    return Situations(hands, now.grippers, objects, now.boxes, now.joints, now.words)


def test_inputs_have_the_size_of_the_layout_and_follow_their_order() -> None:
    now = situations()
    found = input_vectors(LAYOUT, now)
    assert found.shape == (5, LAYOUT.size)
    away = now.objects["cup"].p - now.hands["left"].p
    np.testing.assert_allclose(found[:, 10:13], away)
    np.testing.assert_allclose(found[:, 13:16], [R.T @ v for R, v in zip(now.hands["left"].R, away, strict=True)])
    np.testing.assert_allclose(found[:, -3], now.joints["cabinet.drawer"])


def test_only_the_hands_say_where_the_scene_is() -> None:
    now, X = situations(), Pose.of([0.3, -0.2, 0.1])
    changed = ~np.isclose(input_vectors(LAYOUT, now), input_vectors(LAYOUT, moved(now, X))).all(axis=0)
    assert np.flatnonzero(changed).tolist() == [0, 1, 2, 28, 29, 30]  # the position of each hand


@pytest.fixture(scope="module")
def examples(demos: Path) -> tuple[Examples, np.ndarray]:
    found = sf.demonstrations(demos)
    layout = input_layout([found.task])
    with TrajectorySampler(found.task) as sampler:
        actions = ActionConverter(sampler, ACTION_SPACE).convert(sampler.sample(found[1])).values
        reader = ExampleReader(found.task, layout, sampler, None)
        return Examples.joined([reader.read(found[k]) for k in (0, 1)]), actions


def test_actions_survive_the_way_through_a_displaced_hand(examples: tuple[Examples, np.ndarray]) -> None:
    """However its hand is displaced, an example has the same targets, and they never reach into another episode."""
    found, actions = examples
    first = int(np.flatnonzero(found.episode == 1)[0])
    index = np.array([first, first + 3, len(found) - 2])
    rng = np.random.default_rng(0)
    hands = displaced({name: pose.at(index) for name, pose in found.now.hands.items()}, 0.05, 0.4, rng)
    assert not np.allclose(hands["arm"].p, found.now.hands["arm"].p[index], atol=1e-3)
    chunks = found.chunks(index, hands, 6)
    X_WB = Pose.of([0, 0, 0])  # the base of the arm of this scene is at the origin
    for row, k in enumerate(index - first):
        hand = Pose.from_matrix(_matrix(hands["arm"].p[row], hands["arm"].R[row]))
        rows = absolute_actions(chunks[row], {"arm": hand}, X_WB)
        expected = actions[np.minimum(np.arange(k, k + 6), len(actions) - 1)]
        np.testing.assert_allclose(rows, expected, atol=1e-9)


def test_actions_turn_with_the_base() -> None:
    chunk = np.array([[0.01, -0.02, 0.03, *np.eye(3)[:2].ravel(), 0.4]])
    hand, X_WB = Pose.of([0.4, 0.1, 0.3], quat_from_rpy(0.3, -0.8, 1.9)), Pose.of([1, 2, 0.5], quat_from_rpy(0, 0, 1.2))
    (row,) = absolute_actions(chunk, {"arm": hand}, X_WB)
    target = X_WB @ Pose.of(hand.p + chunk[0, :3], hand.q)
    np.testing.assert_allclose(row, [*target.p, *target.rotation[:2].ravel(), 0.4], atol=1e-12)


def test_only_words_that_distinguish_instructions_are_inputs(bench: Path) -> None:
    from dataclasses import replace

    task = load_task(bench)
    other = replace(task, instruction="Shove the block away!")
    assert input_layout([task]).words == ()
    layout = input_layout([task, other])
    assert layout.words == ("push", "shove")
    assert word_flags(layout, "PUSH it.").tolist() == [1, 0] and word_flags(layout, "Kick it.").tolist() == [0, 0]


def _matrix(p: np.ndarray, R: np.ndarray) -> np.ndarray:
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = R, p
    return found
