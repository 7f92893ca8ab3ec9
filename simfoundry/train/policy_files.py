"""The files of a trained baseline: ``baseline.json`` and ``weights.safetensors`` in one folder.

Both are data and contain no code. Equal policies have equal bytes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError

from simfoundry.evaluate.policies.base import PolicyError
from simfoundry.runtime.extras import need_extra
from simfoundry.runtime.files import write_atomically
from simfoundry.train.examples import ROBOT_SIZE
from simfoundry.train.network import NetworkShape, check_weights
from simfoundry.train.situations import InputLayout

if TYPE_CHECKING:
    from torch import Tensor

ABOUT, WEIGHTS = "baseline.json", "weights.safetensors"

# Maximum sizes of the two files to read [bytes]; those of a baseline of the default size take 2 kB and 10 MB.
MOST_ABOUT, MOST_WEIGHTS = 2**20, 2**29

# Tensors beside those of the network: what maps inputs and actions to about zero mean and unit variance.
NORMALIZATION = ("inputs.mean", "inputs.scale", "actions.mean", "actions.scale")

_Word = Annotated[str, StringConstraints(min_length=1, max_length=200)]
_Words = Annotated[tuple[_Word, ...], Field(max_length=1000)]


class _Data(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=False)


class TrainingFacts(_Data):
    """The origin of a baseline.

    Attributes:
        tasks: The names of the tasks.
        demonstrations: The number of demonstrations, including those for validation.
        inputs: The digest of the demonstrations and the options.
        seed: The seed of the training.
        steps: The number of optimization steps.
        loss: The last validation loss, or the training loss if no demonstrations were set aside.
        versions: The versions of SimFoundry, PyTorch and MuJoCo, keyed by name.
    """

    tasks: _Words
    demonstrations: int
    inputs: _Word
    seed: int
    steps: int
    loss: float
    versions: dict[_Word, _Word]


class BaselineSpec(_Data):
    """The content of ``baseline.json``.

    Attributes:
        robots: The robots, as in :class:`InputLayout`; also the objects, joints and words.
        chunk: The number of actions that the network predicts.
        executed: The number of these actions to execute before the next prediction.
        hz: The number of actions per second [Hz].
        flow_steps: The number of integration steps from noise to actions.
        cameras: The cameras whose images are inputs instead of true poses.
        image_size: The width and the height of the images [px]; 0 without cameras.
        width: The number of units in each layer.
        blocks: The number of residual blocks.
        training: The origin of the weights.
    """

    simfoundry: Literal["baseline/1"] = "baseline/1"
    robots: Annotated[_Words, Field(min_length=1)]
    objects: _Words
    joints: _Words
    words: _Words
    chunk: Annotated[int, Field(ge=1, le=1000)]
    executed: Annotated[int, Field(ge=1, le=1000)]
    hz: Annotated[float, Field(gt=0, le=1000)]
    flow_steps: Annotated[int, Field(ge=1, le=1000)]
    cameras: _Words = ()
    image_size: tuple[Annotated[int, Field(ge=0, le=1024)], Annotated[int, Field(ge=0, le=1024)]] = (0, 0)
    width: Annotated[int, Field(ge=1, le=4096)]
    blocks: Annotated[int, Field(ge=0, le=64)]
    training: TrainingFacts

    @property
    def layout(self) -> InputLayout:
        """The entries of the input vector."""
        return InputLayout(self.robots, self.objects, self.joints, self.words, self.cameras, *self.image_size)

    @property
    def shape(self) -> NetworkShape:
        """The dimensions of the network."""
        actions = self.chunk * len(self.robots) * ROBOT_SIZE
        return NetworkShape(self.layout.size, actions, self.width, self.blocks, len(self.cameras), *self.image_size)


@dataclass(frozen=True, eq=False)
class StoredBaseline:
    """A baseline as it is stored: its description, the weights of its network, and its normalization.

    ``normalization`` contains the tensors :data:`NORMALIZATION`.
    """

    spec: BaselineSpec
    weights: Mapping[str, Tensor]
    normalization: Mapping[str, Tensor]


def write_baseline(folder: Path, baseline: StoredBaseline) -> None:
    """Write a baseline. ``baseline.json`` is written last, so that an incomplete folder is not a policy."""
    from safetensors.torch import save

    about = json.dumps(baseline.spec.model_dump(mode="json"), indent=1, ensure_ascii=False) + "\n"
    tensors = {f"network.{name}": tensor.contiguous() for name, tensor in baseline.weights.items()}
    write_atomically(folder / WEIGHTS, save({**tensors, **baseline.normalization}))
    write_atomically(folder / ABOUT, about.encode())


def read_about(folder: Path) -> BaselineSpec:
    """Read the description of a baseline.

    Raises:
        PolicyError: If the folder does not contain a baseline.
    """
    path = folder / ABOUT
    try:
        if path.stat().st_size > MOST_ABOUT or (folder / WEIGHTS).stat().st_size > MOST_WEIGHTS:
            raise PolicyError(f"{folder} contains larger files than a baseline; train it again")
        spec = BaselineSpec.model_validate_json(path.read_bytes())
    except (FileNotFoundError, NotADirectoryError) as error:
        name = Path(str(error.filename)).name
        raise PolicyError(f"{folder} does not contain a trained baseline: {name} is missing") from None
    except (ValidationError, RecursionError) as error:
        first = error.errors()[0] if isinstance(error, ValidationError) else {"loc": (), "msg": "too deeply nested"}
        at = ".".join(map(str, first["loc"]))
        raise PolicyError(
            f"{path} is not a description of a baseline: {f'`{at}`: ' if at else ''}{first['msg']}"
        ) from None
    if bool(spec.cameras) != all(spec.image_size):
        raise PolicyError(
            f"{path} is not a description of a baseline: `cameras` and `image_size` contradict each other"
        )
    if spec.executed > spec.chunk:
        raise PolicyError(f"{path} is not a description of a baseline: `executed` exceeds `chunk`")
    return spec


def read_baseline(folder: Path) -> StoredBaseline:
    """Read a baseline.

    Raises:
        PolicyError: If the folder does not contain a baseline, or if a file is damaged.
    """
    spec = read_about(folder)
    need_extra("train", "the baseline")
    from safetensors import SafetensorError
    from safetensors.torch import load

    path = folder / WEIGHTS
    try:
        tensors = load(path.read_bytes())
    except (SafetensorError, ValueError, KeyError) as error:
        raise PolicyError(f"{path} is not a file of tensors: {error}") from None
    weights = {name.removeprefix("network."): t for name, t in tensors.items() if name.startswith("network.")}
    rest = {name: t for name, t in tensors.items() if not name.startswith("network.")}
    if trouble := check_weights(spec.shape, weights) or _normalization_fault(spec, rest):
        raise PolicyError(f"{path} does not match {ABOUT}: {trouble}")
    return StoredBaseline(spec, weights, rest)


def baseline_digest(folder: Path) -> str:
    """Return a digest of the description and the weights of a baseline."""
    read_about(folder)
    digest = hashlib.sha256()
    for name in (ABOUT, WEIGHTS):
        digest.update(hashlib.sha256((folder / name).read_bytes()).digest())
    return digest.hexdigest()[:16]


def _normalization_fault(spec: BaselineSpec, tensors: Mapping[str, Tensor]) -> str:
    import torch

    if tensors.keys() != set(NORMALIZATION):
        return f"it does not contain exactly the tensors {', '.join(NORMALIZATION)} beside the network"
    for name, tensor in tensors.items():
        size = spec.shape.inputs if name.startswith("inputs") else spec.shape.actions
        if tensor.shape != (size,) or tensor.dtype != torch.float32 or not bool(torch.isfinite(tensor).all()):
            return f"tensor `{name}` does not consist of {size} finite numbers in float32"
    return ""
