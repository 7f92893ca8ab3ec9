"""Quadric decimation of large meshes before their shape is searched, within a bounded error."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Faces = NDArray[np.int32]

ENOUGH_FACES = 4096
"""Triangles that suffice: of the banana of YCB (16,384) so many take 0.6 s to cut instead of 4.3 s, as well."""

ALLOWED = 0.005
"""Distance of the simplified surface from the mesh, as a share of the longest side: a tenth of what hulls have."""

SAMPLES = 20_000
"""Points of the original surface on which the distance is measured."""


def simplified(vertices: Array, faces: Faces, enough: int = ENOUGH_FACES) -> tuple[Array, Faces, float]:
    """A mesh of about ``enough`` triangles, or of as many more as it needs, and how far it is from the original [m].

    The mesh itself where it has no more, or where none with fewer triangles is near enough.
    """
    if len(faces) <= enough:
        return vertices, faces, 0.0
    import fast_simplification

    from simfoundry.assets.deviation import greatest_distance, surface_samples

    size = float(np.ptp(vertices, axis=0).max())
    points, _ = surface_samples(vertices, faces, SAMPLES)
    count = enough
    while count < len(faces) // 2:
        corners, sides = fast_simplification.simplify(vertices, faces, target_count=count)
        fewer = np.asarray(corners, dtype=np.float64), np.asarray(sides, dtype=np.int32)
        lost = greatest_distance(points, *fewer) if len(sides) else np.inf
        if lost <= ALLOWED * size:
            return *fewer, lost
        count *= 4
    return vertices, faces, 0.0
