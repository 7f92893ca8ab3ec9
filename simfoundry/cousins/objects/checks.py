"""Whether a candidate can take the twin's place: its meshes, size and mass, the gripper, a table, and its task."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from simfoundry.assets import mass
from simfoundry.assets.mesh import open_edges, weld
from simfoundry.cousins.objects.needs import Needs
from simfoundry.cousins.objects.stuff import Sort, sort_of
from simfoundry.cousins.objects.trials import Outcome, moves, rests, stands
from simfoundry.cousins.reasons import Reason
from simfoundry.geometry.grasp_width import grasp_width
from simfoundry.geometry.tessellate import tessellate
from simfoundry.scene.lengths import length
from simfoundry.scene.model import Collider, SceneObject, Visual
from simfoundry.scene.object_shapes import bounds, solid
from simfoundry.spec.check.plausible import HEAVIEST, LIGHTEST
from simfoundry.spec.models.expressions import Call

SCALE = (0.6, 1.6)
"""Where nothing is known of its kind, the longest side may be so many times the twin's."""

WEIGHT = (0.25, 4.0)
"""And the mass so many times the twin's."""

MARGIN = 0.003
"""Room that a gripper needs on top of the width that it takes [m]."""


@dataclass(frozen=True, eq=False)
class Twin:
    """The thing that varies, lowered, and what it can do itself: only that is asked of its variants.

    ``rests`` are the calls that hold in its own trials, ``lacks`` those that do not, with why; ``opening`` [m] is that
    of the gripper, None where the twin itself cannot be taken.
    """

    item: SceneObject
    needs: Needs
    rests: tuple[Call, ...]
    lacks: tuple[str, ...]
    steady: bool
    opening: float | None

    @classmethod
    def of(cls, item: SceneObject, needs: Needs) -> Twin:
        """Try the twin itself."""
        kept, lacks = [], []
        for call in needs.rests:
            outcome = _rests(call, item, needs)
            if outcome.passed:
                kept.append(call)
            else:
                lacks.append(f"{call}: {outcome.why}")
        steady = stands(item)
        if not steady.passed:
            lacks.append(f"stands: {steady.why}")
        width = grasp_width(solid(item))
        opening = needs.opening
        if opening is not None and width > opening - MARGIN:
            lacks.append(f"the gripper opens {length(opening)}, and it is {length(width)} wide")
            opening = None
        return cls(item, needs, tuple(kept), tuple(lacks), steady.passed, opening)


def faults(item: SceneObject, twin: Twin, category: str) -> Iterator[Reason]:
    """Why a lowered candidate is none, the cheap checks first; nothing where it passes all."""
    yield from _open_meshes(item)
    yield from _size(item, twin.item, sort_of(category))
    if twin.opening is not None:
        width = grasp_width(solid(item))
        if width > twin.opening - MARGIN:
            text = f"it is {length(width)} wide at its narrowest, and the gripper opens {length(twin.opening)}"
            yield Reason("grip", text, {"width": width, "opening": twin.opening})
    jam = moves(item, twin.item) if twin.needs.joints else None
    if jam is not None:
        yield jam
    if twin.steady:
        outcome = stands(item)
        if not outcome.passed:
            yield Reason("stands", f"on a table it {outcome.why}")
    for call in twin.rests:
        outcome = _rests(call, item, twin.needs)
        if not outcome.passed:
            yield Reason("affordance", f"{call} no longer holds: {outcome.why}")


def _rests(call: Call, item: SceneObject, needs: Needs) -> Outcome:
    return rests(call, {**needs.others, item.name: item})


def _open_meshes(item: SceneObject) -> Iterator[Reason]:
    """Every surface, seen or touched, is closed and encloses a volume."""
    for link in item.links:
        pieces: list[Collider | Visual] = [*link.colliders, *link.visuals]
        for piece in pieces:
            mesh = tessellate(piece.geometry, 12)
            vertices, faces = weld(mesh.vertices, mesh.faces)
            gaps = open_edges(faces)
            volume = mass.mesh(vertices, faces).volume if len(faces) else 0.0
            if gaps or volume <= 0:
                text = f"`{piece.name}` of `{link.name}` has {gaps} open edges and a volume of {volume:.3g} m^3"
                yield Reason("mesh", text, {"gaps": float(gaps), "volume": volume})
                return


def _size(item: SceneObject, twin: SceneObject, sort: Sort | None) -> Iterator[Reason]:
    """Longest side, mass and density in the ranges of the kind, or near the twin's where that is not known."""
    low, high = bounds(item)
    side = float((high - low).max())
    weight = sum(link.mass for link in item.links)
    twin_low, twin_high = bounds(twin)
    before = float((twin_high - twin_low).max()), sum(link.mass for link in twin.links)
    sizes = sort.size if sort is not None else (SCALE[0] * before[0], SCALE[1] * before[0])
    weights = sort.mass if sort is not None else (WEIGHT[0] * before[1], WEIGHT[1] * before[1])
    if not sizes[0] <= side <= sizes[1]:
        text = f"it is {length(side)} long, and such things are {length(sizes[0])} to {length(sizes[1])}"
        yield Reason("size", text, {"side": side, "least": sizes[0], "most": sizes[1]})
    if not weights[0] <= weight <= weights[1]:
        text = f"it weighs {weight:.3g} kg, and such things weigh {weights[0]:g} to {weights[1]:g} kg"
        yield Reason("mass", text, {"mass": weight, "least": weights[0], "most": weights[1]})
    density = weight / float(np.prod(high - low))
    if not LIGHTEST / 4 <= density <= HEAVIEST:
        yield Reason("mass", f"its bounds hold {density:.3g} kg/m^3", {"density": density})
