"""Check policies: keys that depend on each other."""

from __future__ import annotations

from simfoundry.spec.check.checker import Checker
from simfoundry.spec.models.policy import PolicySpec


def check_policy(c: Checker, spec: PolicySpec) -> None:
    """Check a policy."""
    for key, view in spec.cameras.items():
        if view.render is not None and (view.render[0] < view.size[0] and view.render[1] < view.size[1]):
            path = ("cameras", key, "render")
            message = f"`{key}` is rendered smaller than the policy expects, and would be upscaled"
            c.add("SF104", path, message, f"render at least one side as `size`: {list(view.size)}")
