"""Why there was no room: how much there is beside an anchor, how large the thing is, what became of the tries."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np

from simfoundry.cousins.placing import Found
from simfoundry.cousins.reasons import Reason
from simfoundry.cousins.sides import SIDES, side_axis
from simfoundry.cousins.support import Support
from simfoundry.cousins.table import Table, Thing
from simfoundry.cousins.twin import Twin
from simfoundry.spec.models.cousins import SceneAxis


def no_room(
    table: Table,
    thing: Thing,
    support: Support,
    found: Found,
    anchor: str = "",
    words: tuple[str, ...] = (),
    axis: SceneAxis | None = None,
) -> Reason:
    """Why a thing found no place, with how much of the support would do and how much of that is free."""
    there = table.there
    wide, free = thing.outline.width, max(0.0, support.area - there.area_on(support.height))
    numbers = {
        "width_m": wide,
        "shadow_m2": thing.outline.area,
        "support_m2": support.area,
        "free_m2": free,
        "tries": float(found.tried),
        "standing": float(found.standing),
        "allowed": float(found.allowed),
    }
    where = f"{' and '.join(SIDES.get(w, w) for w in words)} `{anchor}`" if anchor else f"on `{support.name}`"
    text = f"no room {where}: "
    strip = strip_beside(table.twin, anchor, support, words) if anchor else None
    if strip is not None:
        numbers |= {"strip_deep_m": strip[0], "strip_long_m": strip[1]}
        text += f"the strip of `{support.name}` there is {strip[0]:.2f} m x {strip[1]:.2f} m, "
    text += f"`{thing.name}` is {wide:.2f} m wide; {free:.3f} of {support.area:.3f} m^2 of `{support.name}` are free; "
    text += f"{found.tried:,} tries, {found.standing:,} on `{support.name}`"
    if axis is not None:
        text += f", {found.allowed:,} where asked, none free at a gap of {axis.gap[0]:g} to {axis.gap[1]:g} m"
    return Reason("no_room", text, MappingProxyType(numbers))


def strip_beside(twin: Twin, anchor: str, support: Support, words: tuple[str, ...]) -> tuple[float, float] | None:
    """Depth and length [m] of the part of a support beside an anchor, from its edge outwards; None without a side."""
    sides = [axis for word in words if (axis := side_axis(twin.scene.viewer, word)) is not None]
    if not sides:
        return None
    axis = sides[0]
    across = np.array([-axis[1], axis[0], 0.0])
    edge = twin.shape(anchor, twin.state.poses[anchor]).extent(axis)[1]
    corners = np.column_stack([support.corners, np.zeros(len(support.corners))])
    return max(0.0, float((corners @ axis).max()) - edge), float(np.ptp(corners @ across))
