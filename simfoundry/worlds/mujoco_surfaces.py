"""The surfaces of geoms of a compiled model, as the objects have them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import mujoco


class OwnSurface(NamedTuple):
    """Friction, and resistance against spinning and rolling [m], of one collider."""

    friction: float
    spinning: float
    rolling: float


def own_surfaces(model: mujoco.MjModel, geoms: list[int]) -> list[OwnSurface]:
    """Return the surfaces of collision geoms; what they resist beyond sliding counts in contacts of more dimensions."""
    dimensions = [int(model.geom_condim[geom]) for geom in geoms]
    rows = [model.geom_friction[geom].tolist() for geom in geoms]
    return [
        OwnSurface(sliding, spinning * (count > 3), rolling * (count > 4))
        for count, (sliding, spinning, rolling) in zip(dimensions, rows, strict=True)
    ]
