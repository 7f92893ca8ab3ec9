"""The network of the baseline: a residual perceptron that predicts the velocity of a flow from noise to actions.

If there are images, a small convolutional network finds points in them, which are additional inputs.

Flow matching (Lipman et al., 2023): with noise e, actions a and a time t from 0 to 1, the network learns the velocity
a - e of the straight line x = (1 - t) e + t a. Integrating it from noise gives samples of the demonstrated actions.

If actions were standard normal and independent of the inputs, the expected velocity would be (2 t - 1) x / v with v =
t^2 + (1 - t)^2, the variance of x, and its error would have the variance 1 / v. The network therefore predicts only the
difference from it, in units of its standard deviation, as Karras et al. (2022) precondition diffusion models.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from simfoundry.runtime.extras import need_extra

if TYPE_CHECKING:
    from torch import Generator, Tensor, nn

# Frequencies of the time embedding: half a period to fifty periods between times 0 and 1.
TIME_FREQUENCIES, SLOWEST, FASTEST = 16, math.pi, 100.0 * math.pi

# Number of points to find in the images of all cameras, as in Levine et al. (2016) 32 for one camera.
POINTS = 64


@dataclass(frozen=True)
class NetworkShape:
    """The dimensions of the network.

    Attributes:
        inputs: The length of the input vector.
        actions: The number of values in a chunk.
        width: The number of units in each layer.
        blocks: The number of residual blocks of two layers.
        cameras: The number of cameras.
        image_width: The width of the images [px].
        image_height: The height of the images [px].
    """

    inputs: int
    actions: int
    width: int = 512
    blocks: int = 4
    cameras: int = 0
    image_width: int = 0
    image_height: int = 0


def create_network(shape: NetworkShape) -> nn.Module:
    """Create a network that initially samples standard normal actions, with weights from torch's global generator.

    ``context(inputs, images)`` takes normalized inputs (n, inputs) and color images (n, cameras, height, width, 3).
    ``forward(context, x, t)`` takes its result, points of the flow (n, actions) and times (n,), and returns velocities
    (n, actions).
    """
    need_extra("train", "the baseline")
    import torch
    from torch import nn

    class VelocityNetwork(nn.Module):  # type: ignore[misc]  # torch may not be installed where types are checked
        def __init__(self) -> None:
            super().__init__()
            points = 2 * POINTS * bool(shape.cameras)
            self.encoder = _encoder(shape) if shape.cameras else nn.Identity()
            self.first = nn.Linear(shape.inputs + points + shape.actions + 2 * TIME_FREQUENCIES, shape.width)
            self.blocks = nn.ModuleList(
                nn.Sequential(
                    nn.LayerNorm(shape.width),
                    nn.Linear(shape.width, shape.width),
                    nn.SiLU(),
                    nn.Linear(shape.width, shape.width),
                )
                for _ in range(shape.blocks)
            )
            self.last = nn.Linear(shape.width, shape.actions)
            nn.init.zeros_(self.last.weight)
            nn.init.zeros_(self.last.bias)

        def context(self, inputs: Tensor, images: Tensor) -> Tensor:
            if not shape.cameras:
                return inputs
            n, cameras, height, width, _ = images.shape
            channels = images.permute(0, 1, 4, 2, 3).reshape(n, 3 * cameras, height, width)
            maps = self.encoder(channels / 255.0 - 0.5)
            return torch.cat([inputs, _expected_places(maps)], dim=1)

        def forward(self, context: Tensor, x: Tensor, t: Tensor) -> Tensor:
            frequencies = torch.logspace(math.log10(SLOWEST), math.log10(FASTEST), TIME_FREQUENCIES)
            t = t[:, None]
            variance = t.square() + (1 - t).square()
            phase = t * frequencies
            hidden = self.first(torch.cat([context, x * variance.rsqrt(), phase.sin(), phase.cos()], dim=1))
            for block in self.blocks:
                hidden = hidden + block(hidden)
            difference: Tensor = self.last(nn.functional.silu(hidden))
            return (2 * t - 1) / variance * x + variance.rsqrt() * difference

    return VelocityNetwork()


def _encoder(shape: NetworkShape) -> nn.Module:
    """Return convolutions from the colors of all cameras to :data:`POINTS` maps of an eighth of the resolution."""
    from torch import nn

    return nn.Sequential(
        nn.Conv2d(3 * shape.cameras, 32, 5, stride=2, padding=2),
        nn.SiLU(),
        nn.Conv2d(32, 64, 3, stride=2, padding=1),
        nn.SiLU(),
        nn.Conv2d(64, POINTS, 3, stride=2, padding=1),
    )


def _expected_places(maps: Tensor) -> Tensor:
    """Return the expected place in each map, from -1 to 1 in x and y: a spatial softmax (Levine et al., 2016)."""
    import torch

    n, points, height, width = maps.shape
    weights = maps.reshape(n, points, -1).softmax(dim=2).reshape(n, points, height, width)
    x = (weights.sum(dim=2) * torch.linspace(-1, 1, width)).sum(dim=2)
    y = (weights.sum(dim=3) * torch.linspace(-1, 1, height)).sum(dim=2)
    return torch.cat([x, y], dim=1)


def flow_loss(
    network: nn.Module, inputs: Tensor, images: Tensor, actions: Tensor, weights: Tensor, generator: Generator
) -> Tensor:
    """Return the mean squared error of the predicted velocities for one random time and noise per example.

    ``weights`` are those of the values of a chunk, shape (actions,), with a mean of 1.
    """
    import torch

    t = torch.rand(len(actions), generator=generator)
    noise = torch.randn(actions.shape, generator=generator)
    x = torch.lerp(noise, actions, t[:, None])
    context = network.context(inputs, images)
    found: Tensor = ((network(context, x, t) - (actions - noise)).square() * weights).mean()
    return found


def sample_chunks(
    network: nn.Module, inputs: Tensor, images: Tensor, actions: int, steps: int, generator: Generator
) -> Tensor:
    """Draw a normalized chunk of actions for each input, shape (n, actions), with ``steps`` Euler steps."""
    import torch

    with torch.inference_mode():
        context = network.context(inputs, images)
        x = torch.randn(len(inputs), actions, generator=generator)
        for k in range(steps):
            x = x + network(context, x, torch.full((len(inputs),), k / steps)) / steps
    return x


def check_weights(shape: NetworkShape, weights: Mapping[str, Tensor]) -> str:
    """Return why tensors are not the weights of a network, or an empty string."""
    import torch

    with torch.device("meta"):
        expected = create_network(shape).state_dict()
    if weights.keys() != expected.keys():
        return f"it has the tensors {', '.join(sorted(weights)[:5])}…, not those of the network"
    for name, tensor in expected.items():
        if weights[name].shape != tensor.shape or weights[name].dtype != tensor.dtype:
            return f"tensor `{name}` has shape {tuple(weights[name].shape)}, not {tuple(tensor.shape)}"
        if not bool(torch.isfinite(weights[name]).all()):
            return f"tensor `{name}` is not finite"
    return ""
