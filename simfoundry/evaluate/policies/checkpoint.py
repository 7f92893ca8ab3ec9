"""Policies in folders, such as ``baseline:build/train/policy``.

The package that makes a kind of policy opens it as well. It is above this one, and is imported when it is needed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name

from simfoundry.evaluate.policies.base import Policy
from simfoundry.evaluate.task import Task

# The options of a policy by name, as in ``augment:demos?select=random``.
Options = Mapping[str, str | int | float]


@dataclass(frozen=True)
class PolicyLoader:
    """A kind of policy that is stored in a folder.

    Attributes:
        open: Function that creates the policy for a task, with the given options.
        digest: Function that returns a digest of the options and of all in the folder that determines the policy.
    """

    open: Callable[[Path, Task, Options], Policy]
    digest: Callable[[Path, Options], str]


# The kinds of policies in folders, by the word before the folder.
LOADERS = {"augment": "simfoundry.augment.policy:AUGMENT", "baseline": "simfoundry.train.policy:BASELINE"}


@dataclass(frozen=True)
class CheckpointChoice:
    """A policy in a folder, with options. ``kind`` is a key of :data:`LOADERS`."""

    kind: str
    folder: Path
    options: tuple[tuple[str, str | int | float], ...] = ()

    @property
    def digest(self) -> str:
        """A digest of the policy.

        Raises:
            PolicyError: If the folder does not contain such a policy.
        """
        return self._loader.digest(self.folder, dict(self.options))

    def create(self, task: Task) -> Policy:
        """Create the policy for a task."""
        return self._loader.open(self.folder, task, dict(self.options))

    @property
    def _loader(self) -> PolicyLoader:
        loader: PolicyLoader = resolve_name(LOADERS[self.kind])
        return loader
