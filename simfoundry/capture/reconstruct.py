"""Reconstruction of a scene spec with meshes from one frame: pure stages in their order."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from simfoundry.capture.annotate import SUPPORT, TABLE, color_word, kind_of, unique_names
from simfoundry.capture.describe import (
    SUPPORT_NAME,
    camera_spec,
    material_spec,
    mesh_files,
    meters,
    object_spec,
    support_spec,
)
from simfoundry.capture.errors import CaptureError
from simfoundry.capture.fit_segments import fit_segments, footprint
from simfoundry.capture.frame import Frame, Segmentation, SupportSurface
from simfoundry.capture.segment.decompose import decompose
from simfoundry.capture.segment.find_support import find_support
from simfoundry.capture.shapes.fit import FittedShape
from simfoundry.capture.shapes.texture import dominant_color, textured_mesh
from simfoundry.capture.support_object import beneath, support_mesh, thickness
from simfoundry.spec.models.base import Origin
from simfoundry.spec.models.expressions import parse_call
from simfoundry.spec.models.scene import LightSpec, SceneSpec

Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """A spec, the files it refers to by relative path, and the results of the stages.

    ``names`` gives the number of each object in ``segmentation``; ``skipped`` says why a segment became no object.
    """

    spec: SceneSpec
    files: dict[str, bytes]
    support: SupportSurface
    segmentation: Segmentation
    names: dict[str, int]
    shapes: dict[str, FittedShape]
    skipped: tuple[str, ...] = field(default=())


def reconstruct(
    name: str, frame: Frame, given_names: dict[str, int] | None = None, progress: Progress | None = None
) -> Reconstruction:
    """Reconstruct one picture as a scene spec called ``name``.

    ``given_names`` names objects by their number in ``frame.instances``. Raises :class:`CaptureError` where the picture
    holds no support or no object.
    """
    report = progress or (lambda stage, share: None)
    report("support", 0.0)
    support = find_support(frame)
    report("objects", 0.1)
    segmentation = decompose(frame, support)
    shapes, carriers, skipped = fit_segments(
        frame, support, segmentation, lambda stage, share: report(stage, 0.3 + 0.4 * share)
    )
    if not shapes:
        raise CaptureError("SF504", "no object could be fitted", "; ".join(skipped))
    colors = {k: dominant_color(frame, segmentation.labels == k) for k in shapes}
    names = _names(frame, segmentation, shapes, colors, given_names or {})
    grounded = [footprint(shape) for k, shape in shapes.items() if not carriers[k]]
    support = replace(support, outline=beneath(support.outline, grounded))
    slab = thickness(frame, support)
    files = mesh_files(SUPPORT_NAME, support_mesh(frame, support, segmentation.labels, slab.value))
    objects = {SUPPORT_NAME: support_spec(name, support, slab)}
    materials = {SUPPORT.name: material_spec(SUPPORT)}
    for done, (k, shape) in enumerate(shapes.items()):
        report(names[k], 0.7 + 0.3 * done / len(shapes))
        mesh = textured_mesh(shape, frame, support, segmentation.labels == k)
        files |= mesh_files(names[k], mesh)
        substance = TABLE[kind_of(shape.geometry, shape.hollow)]
        materials[substance.name] = material_spec(substance)
        objects[names[k]] = object_spec(name, names[k], shape, mesh, substance, colors[k])
    relations = tuple(f"OnTop({names[k]}, {names.get(carriers[k], SUPPORT_NAME)})" for k in shapes)
    spec = SceneSpec(
        simfoundry="scene/1",
        name=name,
        viewpoint="view",
        materials=materials,
        objects=objects,
        cameras={"view": camera_spec(frame, support)},
        lights={
            "key": LightSpec(type="distant", intensity=0.45, direction=(0.4, -0.3, -1.0)),
            "sky": LightSpec(type="dome", intensity=0.7),
        },
        relations=relations,
        origin=Origin(capture=name, fit_error=meters(support.residual)),
    )
    return Reconstruction(
        spec,
        files,
        support,
        segmentation,
        {n: k for k, n in names.items()},
        {names[k]: s for k, s in shapes.items()},
        skipped,
    )


def without(built: Reconstruction, names: Collection[str], reason: str) -> Reconstruction:
    """Remove objects from the reconstruction; objects that stood on them now stand on the table."""
    gone = set(names)
    files = {path: data for path, data in built.files.items() if Path(path).stem not in gone}
    relations = []
    for text in built.spec.relations:
        call = parse_call(text)
        upper, lower = call.args
        if upper not in gone:
            relations.append(f"{call.predicate}({upper}, {SUPPORT_NAME if lower in gone else lower})")
    objects = {name: item for name, item in built.spec.objects.items() if name not in gone}
    used = {item.material for item in objects.values()}
    materials = {name: item for name, item in built.spec.materials.items() if name in used}
    update = {"objects": objects, "materials": materials, "relations": tuple(relations)}
    return replace(
        built,
        spec=built.spec.model_copy(update=update),
        files=files,
        names={n: k for n, k in built.names.items() if n not in gone},
        shapes={n: s for n, s in built.shapes.items() if n not in gone},
        skipped=(*built.skipped, *(f"{name}: {reason}" for name in sorted(gone))),
    )


def with_supports(spec: SceneSpec, supports: Mapping[str, Sequence[str]]) -> SceneSpec:
    """Return the spec with the ``OnTop`` relations that hold: its own where they do, else the present supports."""
    relations = []
    for text in spec.relations:
        call = parse_call(text)
        upper, lower = call.args
        holds = supports.get(upper, ())
        relations += [text] if lower in holds else [f"{call.predicate}({upper}, {other})" for other in holds]
    return spec.model_copy(update={"relations": tuple(relations)})


def _names(
    frame: Frame,
    segmentation: Segmentation,
    shapes: dict[int, FittedShape],
    colors: dict[int, tuple[float, float, float]],
    given: dict[str, int],
) -> dict[int, str]:
    """Name every object: by the capture if it has a name, else by its color and shape."""
    wanted: dict[int, str] = {}
    if frame.instances is not None:
        for name, number in given.items():
            covered = segmentation.labels[(frame.instances == number) & (segmentation.labels > 0)]
            if len(covered):
                wanted[int(np.bincount(covered).argmax())] = name
    for k, shape in shapes.items():
        wanted.setdefault(k, f"{color_word(colors[k])}_{kind_of(shape.geometry, shape.hollow)}")
    return dict(zip(shapes, unique_names((wanted[k] for k in shapes), [SUPPORT_NAME]), strict=True))
