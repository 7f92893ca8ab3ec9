"""A backend: the function that compiles a scene, and the table of features that it preserves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from simfoundry.backends.artifact import Artifact
from simfoundry.backends.features import Cells


@dataclass(frozen=True)
class Backend:
    """A compiler for one format: ``compile(scene, **options)`` returns an artifact; ``features`` gives each fidelity.

    The parameters of ``compile`` after the scene are the options that a target profile can set.
    """

    compile: Callable[..., Artifact]
    features: Cells
