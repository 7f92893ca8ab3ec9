"""Scenes compiled to USD, and what the tests read from their stages."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from simfoundry.backends.usd import compile_usd
from simfoundry.scene.model import (
    Scene,
    SceneObject,
)
from tests.mechanisms import mechanisms
from tests.scenes import all_scenes

if TYPE_CHECKING:
    from pxr import Usd

SCENES = all_scenes() | {"mechanisms": mechanisms()}
ROOT = Path(__file__).resolve().parents[2]


def open_stage(folder: Path) -> Usd.Stage:
    from pxr import Usd

    return Usd.Stage.Open(str(folder / "scene.usda"))


def written(scene: Scene, folder: Path) -> Usd.Stage:
    compile_usd(scene).write(folder)
    return open_stage(folder)


def links_of(scene: Scene) -> Iterator[tuple[str, SceneObject, int]]:
    for item in scene.objects:
        for k, link in enumerate(item.links):
            yield item.qualified(link.name), item, k


def validation_errors(stage: Usd.Stage) -> list[str]:
    from pxr import UsdValidation

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    names = {validator.GetMetadata().name for validator in validators}
    assert {"usdPhysicsValidators:ArticulationChecker", "usdShadeValidators:ShaderSdrCompliance"} <= names
    return [str(e.GetErrorAsString()) for e in UsdValidation.ValidationContext(validators).Validate(stage)]
