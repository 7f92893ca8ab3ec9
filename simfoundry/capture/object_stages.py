"""Stages that reconstruct the objects of an image, each from its own pixels and from what is around it."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from simfoundry.capture.cad.explain import explained_segmentation
from simfoundry.capture.cad.library import CadLibrary
from simfoundry.capture.cad.match import CadLookup, ModelMatch
from simfoundry.capture.description.describe import SUPPORT_NAME
from simfoundry.capture.description.level_object import level_outline, level_thickness
from simfoundry.capture.description.support_object import beneath, painted_support, support_mesh
from simfoundry.capture.findings import CaptureFinding
from simfoundry.capture.frame import CaptureError, Frame, Segmentation, SupportSurface
from simfoundry.capture.model_stages.ask import StageModels
from simfoundry.capture.model_stages.inpaint import inpainted_images
from simfoundry.capture.model_stages.masks import model_segmentation
from simfoundry.capture.reconstruct import Progress, fit_segments, footprint, nearby_labels
from simfoundry.capture.removal import ClearedImage, cleared_images
from simfoundry.capture.segment.any_size import segmentation_of
from simfoundry.capture.segment.masks import Labels, Mask
from simfoundry.capture.shapes.fit import FittedShape, fit_shape
from simfoundry.capture.shapes.texture import textured_mesh
from simfoundry.capture.stages.codec import digest_of
from simfoundry.capture.stages.runner import StageResult, StageRunner, StaleStageError
from simfoundry.capture.statements.overrides import Overrides
from simfoundry.capture.statements.stated import placed_shape, stated_segmentation
from simfoundry.geometry.frames import frozen_array
from simfoundry.geometry.shapes import Mesh
from simfoundry.models.tasks.scenes import SceneEstimate
from simfoundry.scene.lower import pose
from simfoundry.spec.models.origin import ModelUse


@dataclass(frozen=True, eq=False)
class SegmentedView:
    """An image with its support and its segmentation, from which each object is reconstructed.

    ``seen`` contains the digests of the image and of the support.
    """

    frame: Frame
    support: SupportSurface
    segmentation: Segmentation
    seen: Mapping[str, str]
    stages: StageRunner

    def mask(self, k: int) -> Mask:
        """Return the pixels of object ``k``."""
        return np.asarray(self.segmentation.labels == k)


@dataclass(frozen=True, eq=False)
class TexturedObjects:
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


@dataclass(frozen=True, eq=False)
class FoundSegments:
    """The segmentation of an image.

    Attributes:
        value: The objects.
        models: The models that found their masks, if any did.
        matches: The models of a CAD library that were registered with them, by number.
    """

    value: Segmentation
    models: tuple[ModelUse, ...] = ()
    matches: Mapping[int, ModelMatch] = field(default_factory=dict)


def segmented_frame(
    measured: Frame,
    completed: Frame,
    support: StageResult[SupportSurface],
    seen: Mapping[str, str],
    overrides: Overrides,
    models: StageModels,
    reading: SceneEstimate | None,
    cad: CadLibrary | None,
) -> FoundSegments:
    """Segment an image by geometry or by a model, or take the masks of a person or of the capture.

    Geometry looks at the depth that was measured, because filled holes have surfaces that belong to no object. Masks of
    a model may show objects in the holes, such as glass, whose depth is in ``completed``. What geometry found without a
    person is corrected by the models of a CAD library.
    """
    stages, inputs = models.stages, {**seen, "support": support.digest}
    if overrides.masks is not None:
        masks = overrides.masks
        inputs["override"] = digest_of(masks)
        stages.overridden.add(("segment", ""))
        take = partial(stated_segmentation, measured, support.value, masks)
        return FoundSegments(stages.run("segment", inputs, take, quick=True).value)
    is_given, stated = measured.instances is not None, measured.decomposition
    inputs["masks"] = digest_of(measured.instances)
    inputs["decomposition"] = "" if stated is None else stated.model_dump_json()
    found = stages.run("segment", inputs, partial(segmentation_of, measured, support.value), quick=is_given)
    if is_given or stated is not None or found.value.surfaces:  # neither models nor CAD models find levels
        return FoundSegments(found.value)
    phrases = () if reading is None else tuple(each.phrase for each in reading.reading.objects)
    masked = model_segmentation(completed, support.value, found.value, phrases, models)
    if masked is not None:
        return FoundSegments(masked.value, masked.models)
    if cad is None:
        return FoundSegments(found.value)
    inputs = {**seen, "support": support.digest, "segments": found.digest, "cad": cad.digest}
    explained = stages.run(
        "register", inputs, partial(explained_segmentation, measured, support.value, found.value, cad)
    ).value
    return FoundSegments(explained.segmentation, matches=explained.matches)


def cleared_images_of(
    view: SegmentedView, shapes: Mapping[int, FittedShape], models: StageModels
) -> tuple[tuple[ClearedImage, ...], tuple[ModelUse, ...]]:
    """Return the images without objects, and the models that filled them in."""
    inputs = {**view.seen, "labels": digest_of(view.segmentation.labels), "shapes": digest_of(list(shapes.values()))}
    inputs |= {"supports": digest_of(view.segmentation.supports)}
    compute = partial(cleared_images, view.frame, view.support, view.segmentation, shapes)
    with suppress(StaleStageError):
        cleared = view.stages.run("remove", inputs, compute, shared=True, beside=not models.asks("inpaint")).value
        painted = inpainted_images(view.frame, cleared, models)
        return (cleared, ()) if painted is None else (painted.value, painted.models)
    return (), ()


def fitted_shapes(
    view: SegmentedView,
    progress: Progress,
    cad: CadLibrary | None = None,
    matches: Mapping[int, ModelMatch] | None = None,
) -> tuple[dict[int, FittedShape], dict[int, int], tuple[CaptureFinding, ...]]:
    """Fit a solid to each segment, or take a model of the CAD library that explains it better.

    ``matches`` are models that were registered before, by the number of the segment.

    Raises:
        CaptureError: No object could be fitted.
    """

    def fit(frame: Frame, mask: Mask, base_z: float, others: Labels, k: int) -> FittedShape:
        if cad is None:  # then other objects matter only where there is no depth, which tells more if there is some
            others = np.where((others == 2) & np.isfinite(frame.depth), 0, others)
        inputs = {**view.seen, "mask": digest_of(mask), "others": digest_of(others)}
        suggest = None
        if cad is not None:
            lookup = CadLookup(cad, None if matches is None else matches.get(k))
            suggest, base_z = lookup.candidates, lookup.base_z(base_z)
            inputs |= {"cad": cad.digest, "known": digest_of(lookup.known)}
        is_same = frame.depth is view.frame.depth
        inputs |= {"base_z": repr(base_z), "occluded": "" if is_same else digest_of(frame.depth)}
        compute = partial(fit_shape, frame, view.support, mask, base_z, labels=others, suggest=suggest)
        return view.stages.run("shape", inputs, compute, str(k), shared=cad is None).value

    with ThreadPoolExecutor(view.stages.size) as threads:
        shapes, carriers, findings = fit_segments(
            view.frame,
            view.support,
            view.segmentation,
            lambda stage, share: progress(stage, 0.3 + 0.4 * share),
            fit,
            threads.map,
        )
    if not shapes:
        raise CaptureError("SF504", "could not fit any object", "; ".join(f.message for f in findings))
    return shapes, carriers, findings


def placed_by_person(view: SegmentedView, shape: FittedShape, overrides: Overrides, key: str, k: int) -> FittedShape:
    """Return the solid of an object with the mesh and the pose that a person states, if any."""
    override, mesh = overrides.objects.get(key), overrides.meshes.get(key)
    if override is None or (override.pose is None and mesh is None):
        return shape
    others = nearby_labels(view.segmentation.labels, k)
    inputs = {**view.seen, "shape": digest_of(shape), "mesh": digest_of(mesh), "others": digest_of(others)}
    inputs["pose"] = "" if override.pose is None else override.pose.model_dump_json()
    stated = None if override.pose is None else pose(override.pose)
    compute = partial(placed_shape, view.frame, view.support, shape, mesh, stated, others)
    view.stages.overridden.add(("pose", str(k)))
    with suppress(StaleStageError):
        return view.stages.run("pose", inputs, compute, str(k)).value
    return shape


def textured_objects(
    view: SegmentedView,
    shapes: dict[int, FittedShape],
    carriers: dict[int, int],
    given: Mapping[int, Mesh],
    progress: Progress,
) -> TexturedObjects:
    """Paint the objects, and extend the support beneath them. ``given`` contains meshes that may have a texture."""
    frame, labels = view.frame, view.segmentation.labels
    grounded = [
        footprint(shape) for k, shape in shapes.items() if not carriers[k] and k not in view.segmentation.surfaces
    ]
    support = replace(view.support, outline=beneath(view.support.outline, grounded))

    inputs = {**view.seen, "support": digest_of(support), "labels": digest_of(labels)}
    paint = partial(painted_support, frame, support, labels)
    painted = view.stages.begin(partial(view.stages.run, "texture", inputs, paint, SUPPORT_NAME, shared=True))
    meshes = painted_meshes(view, shapes, given, progress)
    thickness, top = painted().value
    return TexturedObjects(shapes, carriers, meshes, support, thickness, top)


def painted_meshes(
    view: SegmentedView, shapes: dict[int, FittedShape], given: Mapping[int, Mesh], progress: Progress
) -> dict[int, Mesh]:
    """Return the objects as textured meshes. ``given`` contains meshes that may have a texture."""

    def painted(k: int) -> Mesh | None:
        own = given.get(k, shapes[k].geometry)
        if k in view.segmentation.surfaces:
            return _level_mesh(view, k, shapes[k])
        if isinstance(own, Mesh) and own.texture is not None:
            return own
        sure = replace(shapes[k], confidence=0.0)
        inputs = {**view.seen, "mask": digest_of(view.mask(k)), "shape": digest_of(sure)}
        paint = partial(textured_mesh, shapes[k], view.frame, view.support, view.mask(k))
        with suppress(StaleStageError):
            return view.stages.run("texture", inputs, paint, str(k), shared=True).value
        return None

    meshes: dict[int, Mesh] = {}
    with ThreadPoolExecutor(view.stages.size) as threads:
        for done, (k, mesh) in enumerate(zip(shapes, threads.map(painted, shapes), strict=True)):
            progress(f"texture {k}", 0.7 + 0.3 * done / len(shapes))
            meshes |= {} if mesh is None else {k: mesh}
    return meshes


def _level_mesh(view: SegmentedView, k: int, shape: FittedShape) -> Mesh:
    """Return the textured mesh of a level of the support, in its own frame."""
    level = view.support.levels[view.segmentation.surfaces[k]]
    outline, thickness = level_outline(shape) + shape.X_WO.p[:2], level_thickness(shape)
    raised = replace(view.support.at(level), outline=outline)
    objects = np.where(view.mask(k), 0, view.segmentation.labels).astype(np.int32)
    top = support_mesh(view.frame, raised, objects, thickness)
    shift = np.array([*shape.X_WO.p[:2], -thickness / 2])
    return replace(top, vertices=frozen_array(top.vertices - shift))
