"""Reconstruct the real pictures of ``posecnn_demo``: ``python -m tests.corpora.real_ycb [--cad] [--correct]``.

The five pictures show 21 YCB objects, whose meshes and so sizes are known, but not where they are. The truth is what a
person sees: the name of the object at a pixel. Each found object is compared with the mesh of its name, which is
registered with the pixels of the object: so the F1 says how well the shape fits, and with ``--cad`` whether the right
model was retrieved, but not whether the pose is right. ``--correct`` takes the error of the camera's depth out first,
which makes objects 3 % too small at 1 m.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from simfoundry.assets.cache import Cache
from simfoundry.capture.accuracy.scene_accuracy import surface_distance
from simfoundry.capture.cad.explain import explained_segmentation
from simfoundry.capture.cad.library import CadLibrary, open_library
from simfoundry.capture.cad.match import CadLookup, ModelMatch
from simfoundry.capture.frame import Frame
from simfoundry.capture.reconstruct import fit_segments
from simfoundry.capture.segment.decompose import decompose
from simfoundry.capture.segment.find_support import find_support
from simfoundry.capture.segment.masks import Labels, Mask
from simfoundry.capture.shapes.evidence import gather
from simfoundry.capture.shapes.fit import FittedShape, fit_shape
from simfoundry.capture.shapes.register_mesh import register_mesh
from simfoundry.geometry.shapes import tessellate
from tests.capture.test_shapes_real import TOO_NEAR, load
from tests.corpora.ycb_accuracy import THIN, Result, samples_of, smallest_extent
from tests.corpora.ycb_scenes import DATA

OBJECTS: tuple[dict[str, tuple[int, int]], ...] = (
    {"power_drill": (160, 300), "banana": (200, 413), "mustard_bottle": (360, 340), "cracker_box": (400, 170),
     "tomato_soup_can": (427, 320)},
    {"scissors": (107, 357), "sugar_box": (267, 373), "bleach_cleanser": (260, 173), "master_chef_can": (353, 247),
     "tomato_soup_can": (440, 308)},
    {"potted_meat_can": (200, 270), "tomato_soup_can": (227, 387), "bowl": (433, 327)},
    {"pitcher_base": (333, 240), "tuna_fish_can": (271, 387), "mustard_bottle": (387, 370)},
    {"cracker_box": (233, 147), "bleach_cleanser": (167, 213), "power_drill": (300, 187), "sugar_box": (280, 373),
     "large_clamp": (420, 320)},
)  # fmt: skip
"""The names of the objects in each picture, with a pixel (column, row) on each."""


def fitted(frame: Frame, library: CadLibrary, cad: bool, names: Mapping[str, tuple[int, int]]) -> list[Result]:
    """Reconstruct a picture, and compare the objects at the pixels with the meshes of their names."""
    support = find_support(frame)
    segmentation, matches = decompose(frame, support), dict[int, ModelMatch]()
    if cad:
        explained = explained_segmentation(frame, support, segmentation, library)
        segmentation, matches = explained.segmentation, explained.matches

    def fit(seen: Frame, mask: Mask, base_z: float, others: Labels, k: int) -> FittedShape:
        if not cad:
            return fit_shape(seen, support, mask, base_z, labels=others)
        lookup = CadLookup(library, matches.get(k))
        return fit_shape(seen, support, mask, lookup.base_z(base_z), labels=others, suggest=lookup.candidates)

    shapes = fit_segments(frame, support, segmentation, lambda stage, share: None, fit)[0]
    out, used = [], set[int]()
    for name, (u, v) in names.items():
        near = segmentation.labels[v - 5 : v + 6, u - 5 : u + 6]
        k = int(np.bincount(near[near > 0]).argmax()) if (near > 0).any() else 0
        if k not in shapes or k in used:
            out.append(Result(name, "", "lost"))
            continue
        used.add(k)
        shape, model = shapes[k], library.named(name)
        template, mesh = library.template(model), library.mesh(model)
        assert template is not None
        evidence = gather(frame, support, segmentation.labels == k, 0.0, segmentation.labels)
        X_true, found = register_mesh(evidence, template).X_WO, tessellate(shape.geometry)
        f1 = surface_distance(samples_of(mesh, X_true), samples_of(found, shape.X_WO))[1]
        thin = abs(smallest_extent(mesh.vertices) - smallest_extent(np.asarray(found.vertices)))
        out.append(Result(name, "", shape.model or type(shape.geometry).__name__.lower(), 0.0, f1, thin))
    return out


def main() -> None:
    """Print a line for each object, and the means."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cad", action="store_true", help="use the meshes of 21 YCB objects as a library")
    parser.add_argument("--correct", action="store_true", help="correct the error of the camera's depth")
    arguments = parser.parse_args()
    library = open_library(Path(DATA), cache=Cache.default())
    every: list[Result] = []
    for index, names in enumerate(OBJECTS):
        frame = load("posecnn_demo", index)[0]
        if arguments.correct:
            frame = replace(frame, depth=1 / (1 / frame.depth - TOO_NEAR))
        for r in fitted(frame, library, arguments.cad, names):
            print(f"{index + 1} {r.name:18s} {r.family:18s} F1 {r.f1:.2f}  {1000 * r.thickness:6.1f} mm", flush=True)
            every.append(r)
    f1, thin = np.array([r.f1 for r in every]), np.array([r.thickness for r in every])
    right = sum(r.family == r.name for r in every)
    print(f"{len(every)} objects: F1 {f1.mean():.3f}, smallest extent within 5 mm {np.mean(thin < THIN):.0%}, ", end="")
    print(f"{right} are their models, {sum(r.family == 'lost' for r in every)} lost")


if __name__ == "__main__":
    main()
