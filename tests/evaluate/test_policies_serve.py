"""Our own policy server, as the clients of openpi see it."""

from __future__ import annotations

import threading
import urllib.request
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pytest

from simfoundry.evaluate.policies.openpi import OpenpiPolicy
from simfoundry.evaluate.policies.serve import serve
from tests.evaluate.drive import GOOD, HORIZON, assert_driven, drive, expected, observation, spec_of
from tests.evaluate.exchange import running


@pytest.fixture
def door() -> Iterator[str]:
    """Our own server around a policy that fails where it is told to."""

    def infer(question: Mapping[str, Any]) -> Mapping[str, Any]:
        if question["prompt"] == "fail":
            raise ValueError("nothing is known of `fail`")
        steps = np.arange(15)[:, None]
        return {"actions": np.hstack([question["observation/joint_position"].astype(float) + 0.01 * steps, steps > 5])}

    with running(serve(infer, {"policy": "told"}, port=0)) as address:
        yield address


def test_our_own_server_speaks_as_openpi_does(door: str) -> None:
    assert_driven(drive("openpi", door))


def test_our_own_server_says_that_it_is_there(door: str) -> None:
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    with opener.open(f"http://{door}/healthz", timeout=5) as answer:
        assert (answer.status, answer.read()) == (200, b"OK\n")


def test_our_own_server_answers_one_at_a_time_and_everybody(door: str) -> None:
    results: list[bool] = []

    def ask(step: int) -> None:
        policy = OpenpiPolicy(spec_of("openpi", door))
        policy.reset(GOOD, 0)
        results.append(all(np.allclose(policy.infer(observation(step + k)), expected(step + k)) for k in range(3)))
        policy.close()

    threads = [threading.Thread(target=ask, args=(HORIZON * k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(10)
    assert results == [True] * 4
