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


def own_surfaces(model: mujoco.MjModel, body: str, geoms: list[int]) -> list[OwnSurface]:
    """The surfaces of the collision ``geoms`` of a body, in their order.

    Where geoms are written as the contacts that they decide on, a custom number of the file says what is their own.
    """
    for k in range(model.nnumeric):
        if model.numeric(k).name == f"{body}:surface":
            start, size = int(model.numeric_adr[k]), int(model.numeric_size[k])
            rows = model.numeric_data[start : start + size].reshape(-1, 4).tolist()
            own = [OwnSurface(friction, spinning, rolling) for friction, _, spinning, rolling in rows]
            return own * len(geoms) if len(own) == 1 else own
    return [_surface(model, geom) for geom in geoms]


def _surface(model: mujoco.MjModel, geom: int) -> OwnSurface:
    """What a geom says of spinning and rolling counts in contacts of as many dimensions only."""
    sliding, spinning, rolling = (float(value) for value in model.geom_friction[geom])
    dimensions = int(model.geom_condim[geom])
    return OwnSurface(sliding, spinning * (dimensions > 3), rolling * (dimensions > 4))
