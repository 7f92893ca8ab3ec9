"""Convex decomposition at its coarsest, for tests in which only matters that CoACD takes a mesh, not how well it fits.

Patch ``FUNCTION`` of :mod:`simfoundry.assets.convex` with :data:`COARSE`, and lower without a cache: what is kept is
called by the settings of the product.
"""

from __future__ import annotations

from typing import Any
from unittest import mock

from simfoundry.assets import convex
from simfoundry.assets.mass import Array, Faces

COARSE = "tests.assets.coarse:run"

SETTINGS: dict[str, float | int] = {
    "threshold": 1.0,  # any concavity will do, so nothing is searched
    "preprocess_resolution": 20,  # the least that CoACD takes; an open mesh is made solid in a grid of so many cells
    "resolution": 100,
}


def run(vertices: Array, faces: Faces, preprocess_mode: str) -> list[Any]:
    """Decompose in this process."""
    with mock.patch.dict(convex.SETTINGS, SETTINGS):
        return convex.run(vertices, faces, preprocess_mode)
