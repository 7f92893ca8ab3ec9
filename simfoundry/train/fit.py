"""Training of the baseline on examples.

All randomness of a step derives from the seed and the number of the step, and computations use one thread. A training
that is killed and resumed from its last checkpoint therefore gives the same bytes as one that is not.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from simfoundry.errors import OutputError
from simfoundry.geometry.frames import Array, Index
from simfoundry.runtime.files import write_atomically
from simfoundry.train.examples import Examples, displaced
from simfoundry.train.network import NetworkShape, create_network, flow_loss
from simfoundry.train.situations import InputLayout, input_vectors

if TYPE_CHECKING:
    from torch import Tensor

CHECKPOINT = "checkpoint.safetensors"

# Number of points of the loss curve. Checkpoints are written at these points.
POINTS = 100

# Minimum time between two checkpoints [s]: writing one of 40 MB takes a tenth of a second.
CHECKPOINT_S = 10.0

# Inputs with smaller standard deviations are ignored: 1 mm, 1 mrad, or 0.1% of the gripper. A network could not use
# them in scenes in which they have other values.
LEAST_SCALE = 1e-3

# Motions below 2 cm, 0.05 in rows of a rotation matrix, or a tenth of the gripper's are corrections, which need less
# relative accuracy than larger ones: the weights of such values in the loss fall with their variance.
LEAST_ACTION = np.array([0.02] * 3 + [0.05] * 6 + [0.1])

# Smallest standard deviation of an action, so that constant ones can be divided by it.
TINY = 1e-6

# Standard deviation of noise that is added to gripper readings, which are about as uncertain as this.
GRIPPER_NOISE = 0.01

# Number of frames for the validation loss; its standard error is then about 2%.
VALIDATION_FRAMES = 2048

# Steps over which the learning rate rises, and the largest decay of the average of the weights: the average of about a
# thousand steps.
WARM_UP, DECAY = 200, 0.999

# Weight decay of AdamW, and the largest norm of a gradient.
WEIGHT_DECAY, LARGEST_GRADIENT = 1e-4, 1.0


@dataclass(frozen=True)
class FitOptions:
    """The options of a training.

    Attributes:
        seed: The seed of all random numbers.
        steps: The number of optimization steps.
        batch: The number of examples in a step.
        learning_rate: The largest learning rate; it falls to zero along a cosine.
        chunk: The number of actions in a chunk.
        width: The number of units in each layer.
        blocks: The number of residual blocks.
        shift: The largest standard deviation by which hands are displaced [m].
        turn: The largest standard deviation by which hands are turned [rad].
        validation: The fraction of demonstrations that are set aside to measure the loss.
    """

    seed: int = 0
    steps: int = 10_000
    batch: int = 256
    learning_rate: float = 1e-3
    chunk: int = 16
    width: int = 512
    blocks: int = 3
    shift: float = 0.01
    turn: float = 0.03
    validation: float = 0.1


@dataclass(frozen=True)
class LossPoint:
    """A point of the loss curve.

    Attributes:
        step: The number of steps.
        train: The mean loss since the previous point.
        validation: The loss of the averaged weights on the demonstrations that were set aside, or None without any.
    """

    step: int
    train: float
    validation: float | None


@dataclass(frozen=True, eq=False)
class Fitted:
    """The result of a training: averaged weights, normalization, and the loss curve."""

    shape: NetworkShape
    weights: Mapping[str, Tensor]
    normalization: Mapping[str, Tensor]
    losses: tuple[LossPoint, ...]


# Callback that receives the number of steps so far, and the last point of the loss curve.
Fitting = Callable[[int, LossPoint | None], None]


def fit(
    examples: Examples, layout: InputLayout, options: FitOptions, folder: Path, seen: Fitting = lambda step, point: None
) -> Fitted:
    """Train a network. An interrupted training in ``folder`` is resumed from its checkpoint.

    The caller ensures that a checkpoint in the folder belongs to the same examples and options.
    """
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        training = _Training(examples, layout, options)
        training.restore(folder / CHECKPOINT)
        written = time.monotonic()
        for step in range(training.step, options.steps):
            training.advance(step)
            seen(step + 1, training.losses[-1] if training.losses else None)
            if training.is_at_point and time.monotonic() - written > CHECKPOINT_S and step + 1 < options.steps:
                training.save(folder / CHECKPOINT)
                written = time.monotonic()
        return training.result()
    finally:
        torch.set_num_threads(threads)


def seconds_per_step(examples: Examples, layout: InputLayout, options: FitOptions, seconds: float = 3.0) -> float:
    """Measure how long a step takes on this machine, without a result.

    Args:
        examples: The examples.
        layout: The entries of the input vector.
        options: The options.
        seconds: The duration of the measurement [s].
    """
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        training, times = _Training(examples, layout, options), list[float]()
        begun = time.monotonic()
        while time.monotonic() - begun < seconds or len(times) < 3:
            before = time.monotonic()
            training.optimize(len(times))
            times.append(time.monotonic() - before)
        return float(np.mean(times[1:]))
    finally:
        torch.set_num_threads(threads)


class _Training:
    """A training in progress."""

    def __init__(self, examples: Examples, layout: InputLayout, options: FitOptions) -> None:
        import torch

        self._examples, self._layout, self._options = examples, layout, options
        self._train, self._held_out = _split(examples, options)
        # Displacements are part of what is normalized: where they vary nothing else does, they are the only scale.
        inputs, actions = self._arrays(self._train, np.random.default_rng(options.seed))
        self._mean, self._scale = _input_scales(inputs)
        self._action_mean, self._action_scale = actions.mean(axis=0), np.maximum(actions.std(axis=0), TINY)
        self._weights = torch.from_numpy(_loss_weights(self._action_scale).astype(np.float32))
        sizes = layout.size, actions.shape[1], options.width, options.blocks
        self.shape = NetworkShape(*sizes, len(layout.cameras), layout.width, layout.height)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(options.seed)
            self._network, self._average = create_network(self.shape), create_network(self.shape)
        self._average.load_state_dict(self._network.state_dict())
        self._optimizer = torch.optim.AdamW(
            self._network.parameters(), lr=options.learning_rate, weight_decay=WEIGHT_DECAY, foreach=True
        )
        self.step = 0
        self.losses: list[LossPoint] = []
        self._sum, self._count = 0.0, 0
        self._every = max(1, options.steps // POINTS)

    @property
    def is_at_point(self) -> bool:
        """True if the last step was a point of the loss curve."""
        return self.step % self._every == 0

    def advance(self, step: int) -> None:
        """Carry out step ``step``, and extend the loss curve if it is due."""
        self._sum += self.optimize(step)
        self._count += 1
        self.step = step + 1
        if self.is_at_point or self.step == self._options.steps:
            self.losses.append(LossPoint(self.step, self._sum / self._count, self._validation_loss()))
            self._sum, self._count = 0.0, 0

    def optimize(self, step: int) -> float:
        """Carry out one optimization step, and return its loss."""
        import torch

        options, rng = self._options, np.random.default_rng([self._options.seed, step])
        rate = options.learning_rate * min(1.0, (step + 1) / WARM_UP)
        for group in self._optimizer.param_groups:
            group["lr"] = rate * 0.5 * (1.0 + math.cos(math.pi * step / options.steps))
        index = self._train[rng.integers(0, len(self._train), options.batch)]
        inputs, actions = self._tensors(*self._arrays(index, rng))
        generator = torch.Generator().manual_seed(int(rng.integers(0, 2**62)))
        images = torch.from_numpy(self._examples.images[index])
        loss = flow_loss(self._network, inputs, images, actions, self._weights, generator)
        self._optimizer.zero_grad()
        torch.autograd.backward(loss)
        torch.nn.utils.clip_grad_norm_(self._network.parameters(), LARGEST_GRADIENT)
        self._optimizer.step()
        with torch.no_grad():
            share = 1.0 - min(DECAY, (1.0 + step) / (10.0 + step))
            torch._foreach_lerp_(list(self._average.parameters()), list(self._network.parameters()), share)
        return float(loss.item())

    def result(self) -> Fitted:
        """Return the averaged weights, the normalization and the loss curve."""
        import torch

        numbers = {
            "inputs.mean": self._mean,
            "inputs.scale": self._scale,
            "actions.mean": self._action_mean,
            "actions.scale": self._action_scale,
        }
        normalization = {name: torch.from_numpy(array.astype(np.float32)) for name, array in numbers.items()}
        return Fitted(self.shape, self._average.state_dict(), normalization, tuple(self.losses))

    def save(self, path: Path) -> None:
        """Write a checkpoint."""
        import torch
        from safetensors.torch import save

        tensors = {f"network.{name}": t for name, t in self._network.state_dict().items()}
        tensors |= {f"average.{name}": t for name, t in self._average.state_dict().items()}
        for name, parameter in self._network.named_parameters():
            state = self._optimizer.state[parameter]
            tensors |= {f"mean.{name}": state["exp_avg"], f"square.{name}": state["exp_avg_sq"]}
        rows = [[p.step, p.train, math.nan if p.validation is None else p.validation] for p in self.losses]
        tensors["losses"] = torch.tensor(rows, dtype=torch.float64)
        write_atomically(path, save(tensors))

    def restore(self, path: Path) -> None:
        """Continue from a checkpoint, if there is one.

        Raises:
            OutputError: If the file is damaged.
        """
        import torch
        from safetensors import SafetensorError
        from safetensors.torch import load

        if not path.exists():
            return
        try:
            tensors = load(path.read_bytes())
            for head, network in (("network.", self._network), ("average.", self._average)):
                network.load_state_dict({n.removeprefix(head): t for n, t in tensors.items() if n.startswith(head)})
            rows = tensors["losses"].tolist()
            self.losses = [LossPoint(int(s), t, None if math.isnan(v) else v) for s, t, v in rows]
            self.step = self.losses[-1].step
            for name, parameter in self._network.named_parameters():
                mean, square = tensors[f"mean.{name}"], tensors[f"square.{name}"]
                step = torch.tensor(float(self.step))
                self._optimizer.state[parameter] = {"step": step, "exp_avg": mean, "exp_avg_sq": square}
        except (SafetensorError, ValueError, KeyError, IndexError, RuntimeError, TypeError):
            raise OutputError(f"{path} is not a checkpoint of this training; remove it, and train again") from None

    def _validation_loss(self) -> float | None:
        import torch

        if not len(self._held_out):
            return None
        rng = np.random.default_rng(self._options.seed)
        index = self._held_out
        if len(index) > VALIDATION_FRAMES:
            index = rng.choice(index, VALIDATION_FRAMES, replace=False)
        inputs, actions = self._tensors(*self._arrays(index, None))
        with torch.inference_mode():
            generator = torch.Generator().manual_seed(0)
            images = torch.from_numpy(self._examples.images[index])
            loss = flow_loss(self._average, inputs, images, actions, self._weights, generator)
        return float(loss.item())

    def _arrays(self, index: Index, rng: np.random.Generator | None) -> tuple[Array, Array]:
        """Return the inputs and the chunks of examples. With a generator, their hands are displaced."""
        options, now = self._options, self._examples.now.at(index)
        if rng is not None:
            # An image shows where the hand really is, so that hands stay there.
            scale = 0.0 if self._layout.cameras else 1.0
            hands = displaced(now.hands, scale * options.shift, scale * options.turn, rng)
            noise = {name: g + rng.normal(0.0, GRIPPER_NOISE, len(g)) for name, g in now.grippers.items()}
            now = now.with_robots(hands, noise)
        chunks = self._examples.chunks(index, now.hands, options.chunk)
        return input_vectors(self._layout, now), chunks.reshape(len(index), -1)

    def _tensors(self, inputs: Array, actions: Array) -> tuple[Tensor, Tensor]:
        import torch

        inputs = (inputs - self._mean) / self._scale
        actions = (actions - self._action_mean) / self._action_scale
        return torch.from_numpy(inputs.astype(np.float32)), torch.from_numpy(actions.astype(np.float32))


def _split(examples: Examples, options: FitOptions) -> tuple[Index, Index]:
    """Return the frames for training and for validation. Each demonstration belongs to one of them as a whole."""
    episodes = int(examples.episode[-1]) + 1
    count = round(options.validation * episodes)
    chosen = np.random.default_rng(options.seed).permutation(episodes)[:count]
    held_out = np.isin(examples.episode, chosen)
    return np.flatnonzero(~held_out), np.flatnonzero(held_out)


def _input_scales(inputs: Array) -> tuple[Array, Array]:
    scale = inputs.std(axis=0)
    # A constant input is divided by infinity's stand-in, so that it is 0 also where a rollout has another value.
    return inputs.mean(axis=0), np.where(scale < LEAST_SCALE, 1e9, scale)


def _loss_weights(scale: Array) -> Array:
    """Return the weight of each value of a chunk from its standard deviation."""
    least = np.tile(LEAST_ACTION, len(scale) // len(LEAST_ACTION))
    weights = np.minimum(1.0, (scale / least) ** 2)
    return np.asarray(weights / weights.mean())
