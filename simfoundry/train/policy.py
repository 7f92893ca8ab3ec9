"""The baseline as a policy: ``simfoundry eval TASK -p baseline:FOLDER``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simfoundry.evaluate.policies.base import ImageSize, Observation, Policy, PolicyError, RobotReading
from simfoundry.evaluate.policies.checkpoint import Options, PolicyLoader
from simfoundry.evaluate.task import Task
from simfoundry.geometry.frames import Array, Pose, Poses
from simfoundry.runtime.extras import need_extra
from simfoundry.train.examples import ACTION_SPACE, absolute_actions
from simfoundry.train.network import create_network, sample_chunks
from simfoundry.train.policy_files import baseline_digest, read_baseline
from simfoundry.train.situations import Situations, box_numbers, check_fits, input_vectors, word_flags


class BaselinePolicy(Policy):
    """A trained baseline in one task.

    Without cameras, it reads the true poses of the objects, so it is a privileged policy like the expert. Samples
    depend only on the seed of the rollout and on the observations.
    """

    name = "baseline"
    action_space = ACTION_SPACE

    def __init__(self, folder: Path, task: Task) -> None:
        need_extra("train", "the baseline")
        need_extra("expert", "the baseline, which moves the hand by inverse kinematics")
        import torch

        stored = read_baseline(folder)
        check_fits(stored.spec.layout, task, f"the baseline in {folder}")
        self.control_hz = stored.spec.hz
        self.cameras = {name: ImageSize(*stored.spec.image_size) for name in stored.spec.cameras}
        self._spec, self._layout = stored.spec, stored.spec.layout
        self._network = create_network(stored.spec.shape)
        self._network.load_state_dict(dict(stored.weights))
        self._network.eval()
        self._normalization = stored.normalization
        self._boxes = {name: box_numbers(task, name)[None] for name in self._layout.objects}
        self._X_WB = task.scene.robot(self._layout.robots[0]).X_WB
        self._generator = torch.Generator()
        self._words = word_flags(self._layout, task.instruction)

    def reset(self, instruction: str, seed: int) -> None:
        """Start a rollout."""
        self._generator.manual_seed(seed)
        self._words = word_flags(self._layout, instruction)

    def infer(self, observation: Observation) -> Array:
        """Return the next actions, as an array of shape (executed, action size)."""
        import torch

        hands = {name: self._X_WB.inverse() @ observation.robots[name].X_WH for name in self._layout.robots}
        vector = input_vectors(self._layout, self._situation(observation, hands))
        norm = self._normalization
        with _one_thread():
            inputs = (torch.from_numpy(vector).float() - norm["inputs.mean"]) / norm["inputs.scale"]
            size = self._spec.shape.actions
            images = torch.from_numpy(self._images(observation))
            found = sample_chunks(self._network, inputs, images, size, self._spec.flow_steps, self._generator)
            chunk = (found * norm["actions.scale"] + norm["actions.mean"]).numpy().astype(np.float64)
        rows = chunk.reshape(self._spec.chunk, -1)[: self._spec.executed]
        return absolute_actions(rows, hands, self._X_WB)

    def _images(self, observation: Observation) -> NDArray[np.uint8]:
        """Return the images of all cameras, shape (1, cameras, height, width, 3)."""
        width, height = self._spec.image_size
        found = [observation.images[name] for name in self._spec.cameras]
        return np.array(found, np.uint8).reshape(1, len(found), height, width, 3)

    def _situation(self, observation: Observation, hands: dict[str, Pose]) -> Situations:
        X_BW = self._X_WB.inverse()
        readings: dict[str, RobotReading] = {name: observation.robots[name] for name in self._layout.robots}
        return Situations(
            hands={name: Poses.constant(X_BH, 1) for name, X_BH in hands.items()},
            grippers={name: np.array([reading.gripper]) for name, reading in readings.items()},
            objects={name: Poses.constant(X_BW @ observation.objects[name], 1) for name in self._layout.objects},
            boxes=self._boxes,
            joints={name: np.array([observation.joints[name]]) for name in self._layout.joints},
            words=self._words[None],
        )


@contextmanager
def _one_thread() -> Iterator[None]:
    """Compute in one thread: a single input is too small for more, and sums are then the same on every machine."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _open(folder: Path, task: Task, _: Options) -> Policy:
    return BaselinePolicy(folder, task)


def _digest(folder: Path, options: Options) -> str:
    """Return a digest of a baseline, which has no options.

    Raises:
        PolicyError: If there are options, or if the folder does not contain a baseline.
    """
    if options:
        raise PolicyError(f"`baseline` has no options, but `{next(iter(options))}` is given")
    return baseline_digest(folder)


BASELINE = PolicyLoader(open=_open, digest=_digest)
