"""Losses of what only some formats have a place for: variants, and what is seen around a scene."""

from __future__ import annotations

from collections.abc import Iterator

from simfoundry.backends.artifact import Fidelity, Loss
from simfoundry.scene.model import Scene


def variant_losses(scene: Scene, format_: str) -> Iterator[Loss]:
    """One loss for each object with variants, of a format that holds one thing at a time."""
    for item in scene.objects:
        if item.variants:
            others = ", ".join(f"`{v.variant}`" for v in item.variants)
            reason = f"{format_} holds one variant: `{item.variant}` stands, {others} are left out"
            yield Loss(f"{item.name}.variants", Fidelity.DROPPED, reason)


def splat_losses(scene: Scene, format_: str) -> Iterator[Loss]:
    """The loss of a Gaussian splat in a format that shows surfaces only."""
    if scene.background is not None and scene.background.splat is not None:
        reason = f"{format_} shows surfaces, and a Gaussian splat is none"
        yield Loss("background", Fidelity.DROPPED, reason, "background_splat")
