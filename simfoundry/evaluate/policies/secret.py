"""API keys of servers, which are read only from the environment."""

from __future__ import annotations

import os

from simfoundry.evaluate.policies.base import PolicyError
from simfoundry.spec.models.policy import PolicySpec


def secret(spec: PolicySpec) -> str | None:
    """Return the key for a policy's server, or None if it needs none; raises :class:`PolicyError` if it is not set."""
    if spec.api_key is None:
        return None
    key = os.environ.get(spec.api_key, "").strip()
    if not key:
        raise PolicyError(f"{spec.name} takes the key of its server from {spec.api_key}, which is not set")
    if not key.isascii() or not key.isprintable():
        raise PolicyError(
            f"the value of {spec.api_key} is not a valid key: it has characters that are not allowed in a header"
        )
    return key
