"""Lint SF437: centers of mass outside the body."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from simfoundry.geometry.frames import Array
from simfoundry.geometry.hulls import Hulls, hulls_of
from simfoundry.lint.lints import Lint, Subject, warning
from simfoundry.scene.lengths import length
from simfoundry.scene.model import Link
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.models.asset import AssetSpec

# Distance outside the hull that is tolerated, as a fraction of the hull's diagonal: collision shapes are approximate.
# If the link also has parts that are only visual, the body may extend well beyond its collision shapes.
SLACK, SLACK_WITH_VISUALS = 0.1, 0.5

# Directions in which a hull is measured: the 26 directions to the corners, edges and faces of a cube.
DIRECTIONS = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])


def centers_outside(subject: Subject) -> Iterator[Diagnostic]:
    """Find links whose specified center of mass is outside the convex hull of their collision shapes."""
    spec = subject.loaded.spec
    assert isinstance(spec, AssetSpec)
    for link in subject.links:
        inertial = spec.links[link.name].inertial
        if inertial is None or not link.colliders:
            continue
        bare = all(part.use != "visual" for part in spec.links[link.name].parts.values())
        outside, size = _outside(link)
        if outside > (SLACK if bare else SLACK_WITH_VISUALS) * size:
            message = f"the center of mass of `{link.name}` is {length(outside)} outside the link"
            hint = f"`com` is in the frame of the link, in m; the link is {length(size)} across"
            yield warning(subject.loaded, "SF437", ("links", link.name, "inertial", "com"), message, hint, (link.name,))


def _outside(link: Link) -> tuple[float, float]:
    """Return a lower bound of the distance from a link's hull to its center of mass, and the hull's diagonal [m]."""
    hull: Hulls = hulls_of((collider.geometry, collider.X_LG, 0) for collider in link.colliders)
    low, high = hull.bounds()
    toward: Array = link.com - (low + high) / 2
    directions = [*DIRECTIONS, toward] if toward.any() else DIRECTIONS
    units = [np.asarray(d / np.linalg.norm(d)) for d in directions]
    return max(float(link.com @ d) - hull.extent(d)[1] for d in units), float(np.linalg.norm(high - low))


CENTER_OF_MASS = Lint("SF437", ("asset/1",), centers_outside)
