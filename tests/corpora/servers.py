"""The clients of policies against the real servers' own classes, in an environment that has what these import.

``SIMFOUNDRY_OPENPI_SERVER`` names ``websocket_policy_server.py`` of openpi, ``SIMFOUNDRY_ROBOARENA_SERVER``
``policy_server.py`` of RoboArena or DreamZero, ``SIMFOUNDRY_GROOT_SERVER`` ``server_client.py`` of GR00T, each inside
its package; ``SIMFOUNDRY_SERVER_PYTHON`` a Python with ``openpi-client``, ``websockets`` and ``pyzmq``. What is not
named is not run, and said to be. ``--record`` keeps the exchanges that the tests replay.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from simfoundry.evaluate.policies.base import PolicyError
from simfoundry.evaluate.policies.groot import GrootPolicy
from simfoundry.evaluate.policies.remote import RemotePolicy
from tests.evaluate.drive import GOOD, HORIZON, assert_driven, drive, expected, observation, policy_of, spec_of
from tests.evaluate.exchange import relayed, write_exchange

SERVER = r"""
import importlib.util, pathlib, sys, time
import numpy as np

protocol, file, port = sys.argv[1], pathlib.Path(sys.argv[2]), int(sys.argv[3])
sys.path[:0] = [str(p) for p in list(file.parents)[:3]]


def chunk(joints):
    steps = np.arange(15)[:, None]
    return np.hstack([np.asarray(joints, dtype=np.float64) + 0.01 * steps, np.where(steps > 5, 0.9, 0.1)])


class Told:
    def infer(self, obs):
        if obs["prompt"] == "fail":
            raise ValueError("nothing is known of `fail`")
        if obs["prompt"] == "slow":
            time.sleep(8)
        actions = chunk(obs["observation/joint_position"])
        return {"actions": actions} if protocol == "openpi" else actions

    def reset(self, info=None, options=None):
        pass

    def get_action(self, observation, options=None):
        video, state = observation["video"], observation["state"]
        assert {v.dtype.str for v in video.values()} == {"|u1"} and {s.dtype.str for s in state.values()} == {"<f4"}
        assert video["wrist_image_left"].shape == (1, 2, 18, 32, 3), video["wrist_image_left"].shape
        assert state["eef_9d"].shape == (1, 1, 9)
        if observation["language"]["annotation.language.language_instruction"] == [["fail"]]:
            raise ValueError("nothing is known of `fail`")
        actions = chunk(state["joint_position"][0, 0])[None].astype(np.float32)
        return {"joint_position": actions[..., :7], "gripper_position": actions[..., 7:]}, {}

    def get_modality_config(self):
        from gr00t.data.types import ModalityConfig

        return {
            "video": ModalityConfig([-8, 0], ["exterior_image_1_left", "wrist_image_left"]),
            "state": ModalityConfig([0], ["eef_9d", "gripper_position", "joint_position"]),
            "action": ModalityConfig(list(range(15)), ["eef_9d", "gripper_position", "joint_position"]),
            "language": ModalityConfig([0], ["annotation.language.language_instruction"]),
        }


name = ".".join(file.with_suffix("").parts[-3:]) if protocol == "groot" else file.stem
spec = importlib.util.spec_from_file_location(name, file)
module = importlib.util.module_from_spec(spec)
sys.modules[name] = module
exec(compile(file.read_text(), str(file), "exec"), module.__dict__)  # tracebacks carry the relative path
if protocol == "openpi":
    module.WebsocketPolicyServer(Told(), "127.0.0.1", port, {}).serve_forever()
elif protocol == "roboarena":
    config = module.PolicyServerConfig((18, 32), True, 2, False, True, "joint_position")
    module.WebsocketPolicyServer(Told(), config, "127.0.0.1", port).serve_forever()
else:
    module.PolicyServer(Told(), "127.0.0.1", port).run()
"""
"""Runs a server's own class around a policy that says where it was told the joints are, moving on."""

Proof = Callable[[str, Path], str]
FILES = {protocol: f"SIMFOUNDRY_{protocol.upper()}_SERVER" for protocol in ("openpi", "roboarena", "groot")}


def free_port() -> int:
    """A port that nothing uses now."""
    with socket.socket() as tried:
        tried.bind(("127.0.0.1", 0))
        return int(tried.getsockname()[1])


@contextmanager
def server_of(protocol: str, file: Path, port: int) -> Iterator[subprocess.Popen[bytes]]:
    """A real server, once it listens. It sees its own file by a relative path, so that tracebacks carry no other."""
    python = os.environ.get("SIMFOUNDRY_SERVER_PYTHON", sys.executable)
    root = file.parents[min(2, len(file.parents) - 1)]
    command = [python, "-c", SERVER, protocol, str(file.relative_to(root)), str(port)]
    process = subprocess.Popen(command, cwd=root, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        for _ in range(200):
            with socket.socket() as tried:
                if tried.connect_ex(("127.0.0.1", port)) == 0:
                    break
            if process.poll() is not None:
                raise RuntimeError(f"the server of {protocol} ended at once; try {python} with {file}")
            time.sleep(0.1)
        yield process
    finally:
        process.kill()
        process.wait()


def driven(protocol: str, file: Path) -> str:
    """Chunks are carried out and errors recorded."""
    port = free_port()
    with server_of(protocol, file, port), relayed(f"127.0.0.1:{port}") as (address, noted):
        outcome = drive(protocol, address)
    assert_driven(outcome)
    if "--record" in sys.argv:
        write_exchange(protocol, noted)
    return f"3 chunks to the last digit; told: {outcome.error.rpartition(': ')[2]}"


def killed(protocol: str, file: Path) -> str:
    """A server that is killed and started again between two questions of a rollout, and between two rollouts."""
    port = free_port()
    policy: RemotePolicy
    spec = spec_of(protocol, f"127.0.0.1:{port}", retries=3)
    policy = GrootPolicy(spec) if protocol == "groot" else policy_of(spec)
    with server_of(protocol, file, port):
        policy.reset(GOOD, 0)
        np.testing.assert_allclose(policy.infer(observation(0)), expected(0), atol=1e-6)
    said = ""
    try:
        with server_of(protocol, file, port):
            try:
                np.testing.assert_allclose(policy.infer(observation(HORIZON)), expected(HORIZON), atol=1e-6)
                assert protocol != "roboarena", "its server forgot the rollout, which must not pass unsaid"
            except PolicyError as error:
                assert protocol != "openpi", error
                said = f"; the rollout failed: {str(error)[:70]}…"
            policy.reset(GOOD, 1)
            np.testing.assert_allclose(policy.infer(observation(2)), expected(2), atol=1e-6)
    finally:
        policy.close()
    record = policy.record
    assert record.connections >= 2 and record.failures == bool(said)
    return f"{record.connections} connections, the next rollout runs{said}"


def silent(protocol: str, file: Path) -> str:
    """A server that does not answer in time."""
    port = free_port()
    policy = policy_of(spec_of(protocol, f"127.0.0.1:{port}", timeout=1.0, warm_up=1.0))
    with server_of(protocol, file, port):
        policy.reset("slow", 0)
        try:
            policy.infer(observation(0))
        except PolicyError as error:
            return str(error).partition(" did ")[2]
        finally:
            policy.close()
    raise AssertionError("it answered")


def groot(protocol: str, file: Path) -> str:
    """GR00T's own server: what it takes, two questions with a picture of the past, an error, and what comes after."""
    port = free_port()
    policy = GrootPolicy(spec_of(protocol, f"127.0.0.1:{port}"))
    with server_of(protocol, file, port):
        policy.reset(GOOD, 0)
        for step in (0, HORIZON):
            np.testing.assert_allclose(policy.infer(observation(step)), expected(step), atol=1e-6)
        policy.reset("fail", 1)
        try:
            policy.infer(observation(0))
            raise AssertionError("nothing failed")
        except PolicyError as error:
            said = str(error).rpartition("failed: ")[2]
        policy.reset(GOOD, 2)
        np.testing.assert_allclose(policy.infer(observation(5)), expected(5), atol=1e-6)
        policy.close()
    assert policy.record.errors and said == "nothing is known of `fail`", policy.record.errors
    return f"3 chunks; told: {said}"


def main() -> int:
    """Print a table; 1 where a client does not do what it must."""
    failed = False
    for protocol, variable in FILES.items():
        named = os.environ.get(variable)
        if not named:
            print(f"{protocol:10} not run: {variable} names no server")
            continue
        proofs: dict[str, Proof] = {"answers": groot if protocol == "groot" else driven, "killed": killed}
        if protocol != "groot":
            proofs["silent"] = silent
        for what, proof in proofs.items():
            try:
                print(f"{protocol:10} {what:8} ok      {proof(protocol, Path(named).resolve())}", flush=True)
            except (AssertionError, PolicyError, RuntimeError) as error:
                failed = True
                print(f"{protocol:10} {what:8} FAILED  {error}", flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
