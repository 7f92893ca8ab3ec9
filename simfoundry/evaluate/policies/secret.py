"""Keys of servers, which stand in the environment and nowhere else."""

from __future__ import annotations

import os

from simfoundry.evaluate.policies.base import PolicyError
from simfoundry.spec.models.policy import PolicySpec


def secret(spec: PolicySpec) -> str | None:
    """The key for a policy's server, None where it wants none; raises :class:`PolicyError` where it is not set."""
    if spec.api_key is None:
        return None
    key = os.environ.get(spec.api_key, "").strip()
    if not key:
        raise PolicyError(f"{spec.name} takes the key of its server from {spec.api_key}, which is not set")
    if not key.isascii() or not key.isprintable():
        raise PolicyError(f"what {spec.api_key} holds is no key: it has signs that no header can carry")
    return key
