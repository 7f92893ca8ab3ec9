"""Policies in folders, such as ``baseline:build/train/policy``.

The package that trains a kind of policy opens it as well. It is above this one, and is imported when it is needed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name

from simfoundry.evaluate.policies.base import Policy
from simfoundry.evaluate.task import Task


@dataclass(frozen=True)
class PolicyLoader:
    """A kind of policy that is stored in a folder.

    Attributes:
        open: Function that creates the policy for a task.
        digest: Function that returns a digest of everything in the folder that determines the policy.
    """

    open: Callable[[Path, Task], Policy]
    digest: Callable[[Path], str]


# The kinds of policies in folders, by the word before the folder.
LOADERS = {"baseline": "simfoundry.train.policy:BASELINE"}


@dataclass(frozen=True)
class CheckpointChoice:
    """A policy in a folder. ``kind`` is a key of :data:`LOADERS`."""

    kind: str
    folder: Path

    @property
    def digest(self) -> str:
        """A digest of the policy.

        Raises:
            PolicyError: If the folder does not contain such a policy.
        """
        return self._loader.digest(self.folder)

    def create(self, task: Task) -> Policy:
        """Create the policy for a task."""
        return self._loader.open(self.folder, task)

    @property
    def _loader(self) -> PolicyLoader:
        loader: PolicyLoader = resolve_name(LOADERS[self.kind])
        return loader
