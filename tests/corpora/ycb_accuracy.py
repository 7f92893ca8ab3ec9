"""Reconstruct synthetic pictures of YCB objects: ``python -m tests.corpora.ycb_accuracy isolated|piles [--cad]``.

``isolated`` takes each of 21 objects at rest in a random pose, with the noise of three sensors; ``piles`` eight objects
dropped into a square of 40 cm, once with the true masks and once with those found in the depth. ``--cad`` adds the 21
meshes as a library. Shapes are judged as they are fitted, before the scene settles. An object that was not found has an
F1 of 0. Seeds below 100 were looked at while the code was made; those from 100 were not.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simfoundry.assets.cache import Cache
from simfoundry.assets.convex import hull
from simfoundry.assets.deviation import surface_samples
from simfoundry.capture.accuracy.scene_accuracy import SAME_OBJECT, surface_distance
from simfoundry.capture.cad.explain import explained_segmentation
from simfoundry.capture.cad.library import CadLibrary, open_library
from simfoundry.capture.cad.match import CadLookup, ModelMatch
from simfoundry.capture.frame import CaptureError, Frame, SupportSurface
from simfoundry.capture.reconstruct import fit_segments
from simfoundry.capture.segment.decompose import decompose
from simfoundry.capture.segment.find_support import find_support
from simfoundry.capture.segment.masks import Labels, Mask
from simfoundry.capture.shapes.fit import FittedShape, fit_shape
from simfoundry.capture.statements.stated import stated_segmentation
from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.shapes import Mesh, tessellate
from tests.corpora.synthetic_tables import SyntheticTable
from tests.corpora.ycb_scenes import DATA, HALVES, isolated, pile

NEAR, THIN = 0.02, 0.005
"""Errors of the position and of the smallest extent [m] that the bars allow."""


@dataclass(frozen=True)
class Result:
    """One object: what became of it, the error of its position [m], its F1 at 1 cm, and of its smallest extent [m]."""

    name: str
    group: str
    family: str
    position: float = float("inf")
    f1: float = 0.0
    thickness: float = float("inf")


def smallest_extent(points: Array) -> float:
    """The least distance between two parallel planes that enclose the points [m]."""
    corners, faces = hull(points)
    a, b, c = (corners[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals[lengths > 1e-9] / lengths[lengths > 1e-9, None]
    return float(np.ptp(corners @ normals.T, axis=0).min())


def judged(table: SyntheticTable, support: SupportSurface, shapes: Sequence[FittedShape], group: str) -> list[Result]:
    """Match the true objects with the shapes by the middles of their boxes, and compare them."""
    from scipy.optimize import linear_sum_assignment

    X_found_true = support.X_WC @ table.camera.X_WC.inverse()
    objects = [o for o in table.scene.objects if not o.fixed]
    truths = [(tessellate(o.root.visuals[0].geometry), X_found_true @ o.X_WO) for o in objects]
    found = [(tessellate(s.geometry), s.X_WO) for s in shapes]
    results = [Result(o.category, group, "lost") for o in objects]
    if not found:
        return results
    a, b = (np.array([_middle(mesh, pose) for mesh, pose in each]) for each in (truths, found))
    distance = np.linalg.norm(a[:, None] - b[None], axis=2)
    for i, j in zip(*linear_sum_assignment(np.minimum(distance, SAME_OBJECT)), strict=True):
        if distance[i, j] <= SAME_OBJECT:
            (true, X_true), (mesh, X_mesh) = truths[i], found[j]
            f1 = surface_distance(samples_of(true, X_true), samples_of(mesh, X_mesh))[1]
            thin = abs(smallest_extent(true.vertices) - smallest_extent(np.asarray(mesh.vertices)))
            family = shapes[j].model or type(shapes[j].geometry).__name__.lower()
            results[i] = Result(objects[i].category, group, family, float(distance[i, j]), f1, thin)
    return results


def _middle(mesh: Mesh, pose: Pose) -> Array:
    points = pose.apply(mesh.vertices)
    return np.asarray((points.min(axis=0) + points.max(axis=0)) / 2)


def samples_of(mesh: Mesh, pose: Pose) -> Array:
    return pose.apply(surface_samples(np.asarray(mesh.vertices), mesh.faces, 4000)[0])


def fitted(table: SyntheticTable, masks: Labels | None, library: CadLibrary | None, group: str) -> list[Result]:
    """Reconstruct a picture, with the masks or with those that are found."""
    try:
        support = find_support(table.frame)
        found = None if masks is None else stated_segmentation(table.frame, support, masks)
        segmentation = found or decompose(table.frame, support)
        matches: Mapping[int, ModelMatch] = {}
        if library is not None and found is None:
            explained = explained_segmentation(table.frame, support, segmentation, library)
            segmentation, matches = explained.segmentation, explained.matches

        def fit(frame: Frame, mask: Mask, base_z: float, others: Labels, k: int) -> FittedShape:
            if library is None:
                return fit_shape(frame, support, mask, base_z, labels=others)
            lookup = CadLookup(library, matches.get(k))
            base_z = lookup.base_z(base_z)
            return fit_shape(frame, support, mask, base_z, labels=others, suggest=lookup.candidates)

        shapes = fit_segments(table.frame, support, segmentation, lambda stage, share: None, fit)[0]
    except CaptureError:
        return [Result(o.category, group, "lost") for o in table.scene.objects if not o.fixed]
    return judged(table, support, list(shapes.values()), group)


def results(
    kind: str, seeds: Sequence[int], library: CadLibrary | None, depth_only: bool = False
) -> Iterator[list[Result]]:
    """Draw the pictures of the seeds, and reconstruct them."""
    for seed in seeds:
        if kind == "isolated":
            for half, names in zip("AB", HALVES, strict=True):
                for name in names:
                    table = isolated(name, seed)
                    yield fitted(table, table.truth, library, f"half {half}, {table.sensor}")
        else:
            table = pile(seed)
            for group, masks in (("true masks", table.truth), ("masks from depth", None))[depth_only:]:
                yield fitted(table, masks, library, group)


def summary(found: Sequence[Result]) -> str:
    """Means over some objects."""
    position = np.array([r.position for r in found])
    f1, thickness = np.array([r.f1 for r in found]), np.array([r.thickness for r in found])
    return (
        f"{len(found):4d} objects: F1 {f1.mean():.3f}, within 2 cm {np.mean(position < NEAR):.0%}, "
        f"smallest extent within 5 mm {np.mean(thickness < THIN):.0%}"
    )


def main() -> None:
    """Print a line for each object, and the means of each group and of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=("isolated", "piles"))
    parser.add_argument("--seeds", type=int, nargs="+", default=[100, 101, 102])
    parser.add_argument("--cad", action="store_true", help="add the 21 meshes as a library")
    parser.add_argument(
        "--depth-only", action="store_true", help="take only the masks of piles that are found in the depth"
    )
    arguments = parser.parse_args()
    library = open_library(Path(DATA), cache=Cache.default()) if arguments.cad else None
    every: list[Result] = []
    start = time.process_time()
    for some in results(arguments.kind, arguments.seeds, library, arguments.depth_only):
        for r in some:
            numbers = f"{1000 * r.position:6.1f} mm  F1 {r.f1:.2f}  {1000 * r.thickness:6.1f} mm"
            print(f"{r.name:22s} {r.group:32s} {r.family:18s} {numbers}", flush=True)
        every += some
    print()
    for group in sorted({r.group for r in every}):
        print(f"{group:32s} {summary([r for r in every if r.group == group])}")
    print(f"{'all':32s} {summary(every)}; {time.process_time() - start:.0f} s of processor time")


if __name__ == "__main__":
    main()
