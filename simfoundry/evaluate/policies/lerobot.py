"""Serve LeRobot checkpoints over openpi's protocol: ``python -m simfoundry.evaluate.policies.lerobot CHECKPOINT``.

Run this server in an environment with LeRobot and PyTorch, which SimFoundry itself does not require. Evaluations in any
other environment can then connect to it with a policy document that sets ``protocol: openpi``. The message keys are the
names of the checkpoint's features (``observation.state``, ``observation.images.front``), and the instruction is sent as
``prompt``. LeRobot's own remote protocol is not used because it unpickles received data.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from simfoundry.evaluate.policies.base import PolicyError
from simfoundry.evaluate.policies.remote import needed
from simfoundry.evaluate.policies.serve import Infer, serve
from simfoundry.runtime.extras import install_line

INSTALL = f"install it where the checkpoint runs (`{install_line('policies')} lerobot`)"


def load_checkpoint(checkpoint: str, device: str | None = None) -> tuple[Infer, dict[str, Any]]:
    """Load a checkpoint from a folder or the Hub.

    Inference is not seeded, so a stochastic policy draws new random numbers for each request.

    Returns:
        The inference function of the checkpoint, its input features and its output features.

    Raises:
        PolicyError: If LeRobot is missing or the checkpoint is invalid.
    """
    torch = needed("torch", "a LeRobot checkpoint", INSTALL)
    factory = needed("lerobot.policies.factory", "a LeRobot checkpoint", INSTALL)
    configs = needed("lerobot.configs.policies", "a LeRobot checkpoint", INSTALL)
    try:
        config = configs.PreTrainedConfig.from_pretrained(checkpoint)
        config.device = device or ("cuda" if torch.cuda.is_available() else "cpu")
        policy = factory.get_policy_class(config.type).from_pretrained(checkpoint, config=config).to(config.device)
        places = {"device_processor": {"device": config.device}}
        before, after = factory.make_pre_post_processors(config, checkpoint, preprocessor_overrides=places)
    except Exception as error:  # LeRobot raises many kinds of exceptions for invalid checkpoints
        reason = str(error).strip().splitlines()[0][:200] if str(error).strip() else type(error).__name__
        raise PolicyError(f"{checkpoint} is not a checkpoint that the installed LeRobot can load: {reason}") from None
    if getattr(config, "n_obs_steps", 1) > 1:
        message = f"{checkpoint} needs {config.n_obs_steps} observation steps, but a request provides only one"
        raise PolicyError(f"{message}; only policies with `n_obs_steps: 1` can be served (act, pi0, pi05, smolvla)")
    policy.eval()
    takes = {name: list(feature.shape) for name, feature in config.input_features.items()}

    def infer(question: Mapping[str, Any]) -> Mapping[str, Any]:
        batch = {name: torch.from_numpy(feature(question, name, shape)) for name, shape in takes.items()}
        with torch.inference_mode():
            ready = before({**batch, "task": str(question.get("prompt", ""))})
            policy.reset()
            actions = after(policy.predict_action_chunk(ready))
        return {"actions": actions[0].to("cpu", torch.float32).numpy()}

    gives = {name: list(feature.shape) for name, feature in config.output_features.items()}
    return infer, {"policy": config.type, "takes": takes, "gives": gives}


def feature(question: Mapping[str, Any], name: str, shape: list[int]) -> np.ndarray[Any, Any]:
    """Convert a single feature of a request to LeRobot's format.

    A uint8 image of shape (h, w, 3) is converted to floats from 0 to 1 with shape (3, h, w).

    Raises:
        ValueError: If the feature is missing or invalid. The message contains the name of the feature.
    """
    value = question.get(name)
    if not isinstance(value, np.ndarray):
        there = ", ".join(key for key in question if isinstance(key, str))
        raise ValueError(f"the checkpoint needs `{name}`, but the request contains {there}")
    if value.dtype == np.uint8 and value.ndim == 3 and len(shape) == 3:
        value = np.moveaxis(value, -1, 0).astype(np.float32) / 255
    if list(value.shape) != shape:
        raise ValueError(f"the checkpoint needs `{name}` of shape {shape}, not {list(value.shape)}")
    return np.ascontiguousarray(value, dtype=np.float32)


def main(arguments: list[str] | None = None) -> int:
    """Serve a checkpoint until the process is stopped."""
    parser = argparse.ArgumentParser(prog="python -m simfoundry.evaluate.policies.lerobot", description=__doc__)
    parser.add_argument("checkpoint", help="folder that contains config.json and weights, or a repository on the Hub")
    hosts = "network address to bind; 0.0.0.0 accepts connections from every network"
    parser.add_argument("--host", default="127.0.0.1", help=hosts)
    parser.add_argument("--port", type=int, default=8000)
    parser.add_argument("--device", help="cuda or cpu; defaults to cuda if it is available")
    chosen = parser.parse_args(arguments)
    try:
        infer, metadata = load_checkpoint(chosen.checkpoint, chosen.device)
        server = serve(infer, metadata, chosen.host, chosen.port)
    except PolicyError as error:
        print(error, file=sys.stderr)
        return 2
    except OSError as error:
        print(f"could not listen on {chosen.host}:{chosen.port}: {error.strerror or error}", file=sys.stderr)
        return 2
    for name, shape in metadata["takes"].items():
        print(f"takes {name} {shape}")
    print(f"serving {chosen.checkpoint} ({metadata['policy']}) at ws://{chosen.host}:{server.socket.getsockname()[1]}")
    sys.stdout.flush()
    with server, suppress(KeyboardInterrupt):
        server.serve_forever()
    return 0


if __name__ == "__main__":
    sys.exit(main())
