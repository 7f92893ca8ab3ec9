"""Reconstruct a scene with meshes from a single image, stage by stage."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from simfoundry.capture import describe
from simfoundry.capture.describe import SUPPORT_NAME, mesh_files
from simfoundry.capture.findings import NOT_FOLLOWED, CaptureFinding
from simfoundry.capture.frame import CaptureError, Frame, Segmentation, SupportSurface
from simfoundry.capture.kinds import SUPPORT, kind_of
from simfoundry.capture.reconstruct import Progress, Reconstruction, fit_segments, footprint
from simfoundry.capture.segment.decompose import decompose
from simfoundry.capture.segment.find_support import find_support
from simfoundry.capture.segment.masks import Labels, Mask
from simfoundry.capture.shapes.fit import FittedShape, fit_shape
from simfoundry.capture.shapes.texture import dominant_color, textured_mesh
from simfoundry.capture.stages.codec import digest_of
from simfoundry.capture.stages.runner import StageResult, StageRunner, StaleStageError
from simfoundry.capture.support_object import DEFAULT_THICKNESS, beneath, measured_thickness, support_mesh
from simfoundry.geometry.shapes import Mesh
from simfoundry.spec.models.base import Material
from simfoundry.spec.models.origin import Origin
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.surroundings import LightSpec

CONSTRAINT_HINT = "compare the pixels under `decomposition` with segments.png"


def reconstruct(
    name: str, source: StageResult[Frame], given_names: Mapping[str, int], progress: Progress, stages: StageRunner
) -> Reconstruction:
    """Reconstruct a scene spec called ``name`` from a single image.

    Args:
        name: Name of the scene.
        source: The image, as the stage of frames returns it.
        given_names: Numbers in the image's instance masks, by the names of objects.
        progress: Called with the current stage and the fraction that is done.
        stages: Runs the stages, or reuses their earlier results.

    Raises:
        CaptureError: No support or no object is found in the image.
    """
    frame = source.value
    seen = {"image": digest_of([frame.color, frame.depth, frame.K])}
    progress("support", 0.0)
    support = stages.run("support", seen, lambda: find_support(frame))
    progress("objects", 0.1)
    stated = "" if frame.decomposition is None else frame.decomposition.model_dump_json()
    inputs = seen | {"support": support.digest, "masks": digest_of(frame.instances), "decomposition": stated}
    given = frame.instances is not None
    segmentation = stages.run("segment", inputs, lambda: decompose(frame, support.value), quick=given)
    objects = fit_objects(frame, support, segmentation.value, seen, progress, stages)
    inputs = seen | {"segments": segmentation.digest, "shapes": digest_of(list(objects.shapes.values()))}
    inputs |= {"masks": digest_of(frame.instances), "given": json.dumps(dict(given_names))}
    names = stages.run("name", inputs, lambda: _names(frame, segmentation.value, objects.shapes, given_names)).value
    spec = scene_spec(name, frame, support.value, objects, names)
    files = mesh_files(SUPPORT_NAME, objects.top)
    for k, mesh in objects.meshes.items():
        files |= mesh_files(names[k], mesh)
    unmet = (CaptureFinding(NOT_FOLLOWED, text, CONSTRAINT_HINT) for text in segmentation.value.unmet)
    return Reconstruction(
        spec,
        files,
        objects.support,
        segmentation.value,
        {name: k for k, name in names.items()},
        {names[k]: shape for k, shape in objects.shapes.items()},
        (*unmet, *objects.findings),
    )


@dataclass(frozen=True, eq=False)
class FittedObjects:
    """The objects of an image, by their numbers in the segmentation.

    ``supports`` contains the number of the object that supports each of them, or 0. ``support`` is the table beneath
    all of them, ``thickness`` its measured thickness [m], or None, and ``top`` its textured mesh.
    """

    shapes: dict[int, FittedShape]
    supports: dict[int, int]
    meshes: dict[int, Mesh]
    support: SupportSurface
    thickness: float | None
    top: Mesh
    findings: tuple[CaptureFinding, ...]


def fit_objects(
    frame: Frame,
    found: StageResult[SupportSurface],
    segmentation: Segmentation,
    seen: Mapping[str, str],
    progress: Progress,
    stages: StageRunner,
) -> FittedObjects:
    """Fit a textured solid to each segment, and extend the support beneath them.

    ``seen`` contains the digests of the image.

    Raises:
        CaptureError: No object could be fitted.
    """
    labels = segmentation.labels

    def fit(frame: Frame, mask: Mask, base_z: float, others: Labels, k: int) -> FittedShape:
        inputs = {**seen, "support": found.digest, "mask": digest_of(mask), "others": digest_of(others)}
        inputs |= {"base_z": repr(base_z), "occluded": digest_of(frame.depth)}
        return stages.run(
            "shape", inputs, lambda: fit_shape(frame, found.value, mask, base_z, labels=others), str(k)
        ).value

    shapes, supports, findings = fit_segments(
        frame, found.value, segmentation, lambda stage, share: progress(stage, 0.3 + 0.4 * share), fit
    )
    if not shapes:
        raise CaptureError("SF504", "could not fit any object", "; ".join(f.message for f in findings))
    meshes = {}
    for done, (k, shape) in enumerate(shapes.items()):
        progress(f"texture {k}", 0.7 + 0.3 * done / len(shapes))
        inputs = {**seen, "support": found.digest, "mask": digest_of(labels == k), "shape": digest_of(shape)}
        paint = partial(textured_mesh, shape, frame, found.value, labels == k)
        with suppress(StaleStageError):
            meshes[k] = stages.run("texture", inputs, paint, str(k)).value
    grounded = [footprint(shape) for k, shape in shapes.items() if not supports[k]]
    support = replace(found.value, outline=beneath(found.value.outline, grounded))
    thickness = measured_thickness(frame, support)
    inputs = {**seen, "support": digest_of(support), "labels": digest_of(labels), "thickness": repr(thickness)}
    slab = partial(support_mesh, frame, support, labels, thickness or DEFAULT_THICKNESS)
    top = stages.run("texture", inputs, slab, SUPPORT_NAME).value
    return FittedObjects(shapes, supports, meshes, support, thickness, top, findings)


def scene_spec(
    name: str,
    frame: Frame,
    support: SupportSurface,
    fitted: FittedObjects,
    names: Mapping[int, str],
) -> SceneSpec:
    """Return the scene of the fitted objects, which have the given names."""
    objects = {SUPPORT_NAME: describe.support_spec(name, fitted.support, fitted.thickness)}
    for k, shape in fitted.shapes.items():
        objects[names[k]] = describe.object_spec(name, names[k], shape, k)
    priors = [SUPPORT, *(kind_of(shape).material for shape in fitted.shapes.values())]
    key_light = LightSpec(type="distant", intensity=0.45, direction=(0.4, -0.3, -1.0))
    return SceneSpec(
        simfoundry="scene/1",
        name=name,
        viewpoint="view",
        materials={prior.name: Material(density=prior.density, friction=prior.friction) for prior in priors},
        objects=objects,
        cameras={"view": describe.camera_spec(frame, fitted.support)},
        lights={"key": key_light, "sky": LightSpec(type="dome", intensity=0.7)},
        relations=tuple(f"OnTop({names[k]}, {names.get(fitted.supports[k], SUPPORT_NAME)})" for k in fitted.shapes),
        origin=Origin(capture=name, fit_error=describe.meters(support.residual)),
    )


def _names(
    frame: Frame, segmentation: Segmentation, shapes: dict[int, FittedShape], given: Mapping[str, int]
) -> dict[int, str]:
    """Name every object.

    An object is named after its name in the capture or, if there is none, after its color and shape.
    """
    labels = segmentation.labels
    wanted: dict[int, str] = {}
    if frame.instances is not None:
        for name, number in given.items():
            covered = labels[(frame.instances == number) & (labels > 0)]
            if len(covered):
                wanted[int(np.bincount(covered).argmax())] = name
    wanted |= {k: name for name, k in segmentation.pieces.items()}
    for k, shape in shapes.items():
        color = describe.color_word(dominant_color(frame, labels == k))
        wanted.setdefault(k, f"{color}_{kind_of(shape).name}")
    return dict(zip(shapes, describe.unique_names(wanted[k] for k in shapes), strict=True))
