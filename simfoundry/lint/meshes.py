"""Meshes, profiles and outlines that lowering refuses (SF301, SF302, SF303), found without opening them twice."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from simfoundry.assets.errors import (
    MeshError,
    implausible_size,
    profile_misses_axis,
    profile_off_axis,
    shape_crosses_itself,
)
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.files import is_document
from simfoundry.spec.loaded import Loaded
from simfoundry.spec.models.base import LatheShape, PrismShape, Shape
from simfoundry.spec.models.scene import SceneSpec

if TYPE_CHECKING:
    from simfoundry.spec.models.asset import AssetSpec

SMALLEST_AREA = 1e-8
"""A profile or outline of less than this [m^2] has no area; as in lowering."""

Point = tuple[float, float]


def mesh_faults(loaded: Loaded, spec: SceneSpec | AssetSpec) -> Iterator[Diagnostic]:
    """What lowering will refuse of the shapes and meshes that a document names, at the same places."""
    faults = _of_scene(loaded, spec) if isinstance(spec, SceneSpec) else _of_asset(loaded, spec)
    for path, wrong in faults:
        yield loaded.finding(wrong.code, path, wrong.message, wrong.hint)


Fault = tuple[tuple[str, ...], MeshError]


def _of_scene(loaded: Loaded, spec: SceneSpec) -> Iterator[Fault]:
    for name, item in spec.objects.items():
        path = ("objects", name)
        if item.shape is not None:
            wrong = shape_fault(item.shape)
            if wrong is not None:
                yield (*path, "shape"), wrong
        elif item.asset is not None and not is_document(item.asset):
            wrong = _mesh_fault(loaded.file(item.asset), item.scale, item.solid, item.collision)
            if wrong is not None:
                yield (*path, "asset"), wrong
        if item.visual is not None:
            wrong = _visual_fault(loaded.file(item.visual), item.scale)
            if wrong is not None:
                yield (*path, "visual"), wrong


def _of_asset(loaded: Loaded, spec: AssetSpec) -> Iterator[Fault]:
    for link_name, link in spec.links.items():
        for name, part in link.parts.items():
            if part.shape is not None:
                wrong = shape_fault(part.shape)
            elif part.use == "visual":
                wrong = _visual_fault(loaded.file(part.mesh or ""), part.scale)
            else:
                solid = "given" if link.weighed else link.solid
                wrong = _mesh_fault(loaded.file(part.mesh or ""), part.scale, solid, link.collision)
            if wrong is not None:
                yield ("links", link_name, "parts", name), wrong


def _mesh_fault(file: Path, scale: float, solid: str, collision: str) -> MeshError | None:
    from simfoundry.assets.mesh_summary import mesh_facts

    try:
        return mesh_facts(file).fault(file.name, scale, solid, collision)
    except MeshError as error:
        return error


def _visual_fault(file: Path, scale: float) -> MeshError | None:
    from simfoundry.assets.mesh_summary import mesh_facts

    try:
        return implausible_size(file.name, mesh_facts(file).size * scale, scale)
    except MeshError as error:
        return error


def shape_fault(shape: Shape) -> MeshError | None:
    """What is wrong with a profile or an outline."""
    match shape:
        case LatheShape():
            return _profile_fault(shape.lathe.profile)
        case PrismShape():
            return shape_crosses_itself("outline") if _is_crossed(shape.prism.outline) else None
    return None


@lru_cache(maxsize=4096)
def _profile_fault(profile: tuple[Point, ...]) -> MeshError | None:
    if profile[0][0] != 0 or profile[-1][0] != 0:
        return profile_misses_axis()
    if any(r <= 0 for r, _ in profile[1:-1]):
        return profile_off_axis()
    return shape_crosses_itself("profile") if _is_crossed(profile) else None


@lru_cache(maxsize=4096)
def _is_crossed(corners: tuple[Point, ...]) -> bool:
    """Whether a ring of corners crosses or touches itself, or has no area."""
    ring = [p for p, q in pairwise((*corners, corners[0])) if p != q]
    if len(ring) < 3:
        return True
    doubled = sum(a[0] * b[1] - a[1] * b[0] for a, b in pairwise((*ring, ring[0])))
    if abs(doubled) / 2 < SMALLEST_AREA:
        return True
    sides = list(pairwise((*ring, ring[0])))
    n = len(sides)
    return any(_meet(*sides[i], *sides[j]) for i in range(n) for j in range(i + 2, n) if (i, j) != (0, n - 1))


def _meet(a: Point, b: Point, c: Point, d: Point) -> bool:
    """Whether two sides that are no neighbours meet."""
    if max(a[0], b[0]) < min(c[0], d[0]) or max(c[0], d[0]) < min(a[0], b[0]):
        return False
    if max(a[1], b[1]) < min(c[1], d[1]) or max(c[1], d[1]) < min(a[1], b[1]):
        return False
    return _turn(a, b, c) * _turn(a, b, d) <= 0 and _turn(c, d, a) * _turn(c, d, b) <= 0


def _turn(a: Point, b: Point, c: Point) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
