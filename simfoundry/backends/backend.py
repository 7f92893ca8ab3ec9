"""A backend: the function that compiles a scene, and the table of the features that it keeps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from simfoundry.backends.artifact import Artifact
from simfoundry.backends.features import Cells


@dataclass(frozen=True)
class Backend:
    """A backend: ``compile(scene, **options)`` returns the files of a target; ``features`` decides on every feature.

    The parameters of ``compile`` after the scene are the options that a target's profile can set.
    """

    compile: Callable[..., Artifact]
    features: Cells
