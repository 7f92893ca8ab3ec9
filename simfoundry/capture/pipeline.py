"""Reconstruct a scene with meshes from a single image, stage by stage."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from simfoundry.capture import describe
from simfoundry.capture.describe import SUPPORT_NAME, mesh_files
from simfoundry.capture.doubts import image_doubts
from simfoundry.capture.findings import NOT_FOLLOWED, CaptureFinding
from simfoundry.capture.frame import CaptureError, Frame, Segmentation, SupportSurface
from simfoundry.capture.kinds import SUPPORT
from simfoundry.capture.naming import final_names, found_names, kept_names, matched_names
from simfoundry.capture.overrides import Overrides
from simfoundry.capture.reconstruct import Progress, Reconstruction, fit_segments, footprint, nearby_labels
from simfoundry.capture.scene_reading import MatchedReading, read_scene
from simfoundry.capture.segment.decompose import decompose
from simfoundry.capture.segment.find_support import find_support
from simfoundry.capture.segment.masks import Labels, Mask
from simfoundry.capture.shapes.fit import FittedShape, fit_shape
from simfoundry.capture.shapes.texture import textured_mesh
from simfoundry.capture.stages.codec import digest_of
from simfoundry.capture.stages.runner import StageResult, StageRunner, StaleStageError
from simfoundry.capture.stated import placed_shape, stated_segmentation
from simfoundry.capture.support_object import DEFAULT_THICKNESS, beneath, measured_thickness, support_mesh
from simfoundry.geometry.shapes import Mesh
from simfoundry.models.setup import ModelSetup
from simfoundry.scene.lower import pose
from simfoundry.spec.models.base import Material
from simfoundry.spec.models.origin import Origin
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.surroundings import LightSpec

CONSTRAINT_HINT = "compare the pixels under `decomposition` with segments.png"


@dataclass(frozen=True, eq=False)
class Statements:
    """Statements about an image: by the capture, by a person, by the last run, and by models that may be asked.

    Attributes:
        given: Numbers in the image's instance masks, by the names that the capture gives.
        overrides: Corrections by a person.
        last: Numbers of the objects in the last run, shape (h, w), or None.
        last_names: Numbers in ``last``, by the names in the last run.
        setup: The models that may be asked, or None to ask none.
    """

    given: Mapping[str, int] = field(default_factory=dict)
    overrides: Overrides = field(default_factory=Overrides)
    last: Labels | None = None
    last_names: Mapping[str, int] = field(default_factory=dict)
    setup: ModelSetup | None = None


def reconstruct(
    name: str, source: StageResult[Frame], known: Statements, progress: Progress, stages: StageRunner
) -> Reconstruction:
    """Reconstruct a scene spec called ``name`` from a single image.

    Args:
        name: Name of the scene.
        source: The image, as the stage of frames returns it.
        known: What is known about the image besides its pixels.
        progress: Called with the current stage and the fraction that is done.
        stages: Runs the stages, or reuses their earlier results.

    Raises:
        CaptureError: No support or no object is found in the image.
    """
    frame, overrides = source.value, known.overrides
    seen = {"image": digest_of([frame.color, frame.depth, frame.K])}
    progress("support", 0.0)
    chosen = "" if frame.support is None else frame.support.model_dump_json()
    support = stages.run("support", seen | {"chosen": chosen}, lambda: find_support(frame))
    progress("objects", 0.1)
    segmentation = _segmented(frame, support, seen, overrides, stages)
    view = SegmentedView(frame, support.value, segmentation.value, seen | {"support": support.digest}, stages)
    shapes, carriers, findings = _shapes(view, progress)
    read, unseen = read_scene(known.setup, frame.color, segmentation.value.labels, stages)
    words = {} if read is None else {k: word for k in shapes if (word := read.name(k)) is not None}
    inputs = seen | {"segments": segmentation.digest, "shapes": digest_of(list(shapes.values()))}
    inputs |= {"masks": digest_of(frame.instances), "given": json.dumps(dict(known.given)), "read": digest_of(words)}
    find = partial(found_names, frame, segmentation.value, shapes, known.given, words)
    found = stages.run("name", inputs, find, quick=True).value
    names = _names(found, segmentation.value, known)
    if overrides.names or any(item.name for item in overrides.objects.values()):
        stages.overridden.add(("name", ""))
    keys = {k: overrides.of((names[k], found[k]))[0] for k in shapes}
    shapes = {k: _placed(view, shape, overrides, keys[k], k) for k, shape in shapes.items()}
    given = {k: overrides.meshes[keys[k]] for k in shapes if keys[k] in overrides.meshes}
    objects = _textured(view, shapes, carriers, given, progress)
    spec = scene_spec(name, frame, support.value, objects, names, read)
    files = mesh_files(SUPPORT_NAME, objects.top)
    for k, mesh in objects.meshes.items():
        files |= mesh_files(names[k], mesh)
    doubts = image_doubts(frame, support.value, segmentation.value)
    unmet = (CaptureFinding(NOT_FOLLOWED, text, CONSTRAINT_HINT) for text in segmentation.value.unmet)
    return Reconstruction(
        spec,
        files,
        objects.support,
        segmentation.value,
        {name: k for k, name in names.items()},
        {names[k]: shape for k, shape in objects.shapes.items()},
        (
            *frame.findings,
            *_other_names(names, found, overrides),
            *unmet,
            *unseen,
            *findings,
            *overrides.unused({*found.values(), *names.values()}),
            *doubts,
        ),
    )


@dataclass(frozen=True, eq=False)
class SegmentedView:
    """An image with its support and its segmentation, of which each object is reconstructed.

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


def _segmented(
    frame: Frame,
    support: StageResult[SupportSurface],
    seen: Mapping[str, str],
    overrides: Overrides,
    stages: StageRunner,
) -> StageResult[Segmentation]:
    """Segment an image, or take the masks of a person as they are."""
    if overrides.masks is not None:
        masks = overrides.masks
        inputs = {**seen, "support": support.digest, "override": digest_of(masks)}
        stages.overridden.add(("segment", ""))
        return stages.run("segment", inputs, lambda: stated_segmentation(frame, support.value, masks), quick=True)
    stated = "" if frame.decomposition is None else frame.decomposition.model_dump_json()
    inputs = {**seen, "support": support.digest, "masks": digest_of(frame.instances), "decomposition": stated}
    is_quick = frame.instances is not None
    return stages.run("segment", inputs, lambda: decompose(frame, support.value), quick=is_quick)


def _shapes(
    view: SegmentedView, progress: Progress
) -> tuple[dict[int, FittedShape], dict[int, int], tuple[CaptureFinding, ...]]:
    """Fit a solid to each segment.

    Raises:
        CaptureError: No object could be fitted.
    """

    def fit(frame: Frame, mask: Mask, base_z: float, others: Labels, k: int) -> FittedShape:
        inputs = {**view.seen, "mask": digest_of(mask), "others": digest_of(others)}
        inputs |= {"base_z": repr(base_z), "occluded": digest_of(frame.depth)}
        compute = partial(fit_shape, frame, view.support, mask, base_z, labels=others)
        return view.stages.run("shape", inputs, compute, str(k)).value

    shapes, carriers, findings = fit_segments(
        view.frame,
        view.support,
        view.segmentation,
        lambda stage, share: progress(stage, 0.3 + 0.4 * share),
        fit,
    )
    if not shapes:
        raise CaptureError("SF504", "could not fit any object", "; ".join(f.message for f in findings))
    return shapes, carriers, findings


def _names(found: Mapping[int, str], segmentation: Segmentation, known: Statements) -> dict[int, str]:
    """Return the names of objects in the scene, by number."""
    labels, overrides = segmentation.labels, known.overrides
    reference = overrides.masks if overrides.masks is not None else known.last
    reference = labels if reference is None or reference.shape != labels.shape else reference
    stated = {k: name for k, name in matched_names(labels, reference, overrides.names).items() if k in found}
    kept = {} if known.last is None else kept_names(labels, known.last, known.last_names, found)
    by_capture = {*known.given, *segmentation.pieces}
    kept = {k: name for k, name in kept.items() if found[k] not in by_capture}
    return final_names(found, stated, kept, overrides)


def _other_names(
    names: Mapping[int, str], found: Mapping[int, str], overrides: Overrides
) -> tuple[CaptureFinding, ...]:
    """Return a finding for each object whose stated name is that of another object or of the support."""
    hint = "choose another name"
    wanted = {k: overrides.of((names[k], name))[1].name for k, name in found.items()}
    text = "the name `{}` is taken, so the object is called `{}`"
    taken = [(name, names[k]) for k, name in wanted.items() if name is not None and names[k] != name]
    return tuple(CaptureFinding(NOT_FOLLOWED, text.format(*pair), hint, (pair[1],)) for pair in taken)


def _placed(view: SegmentedView, shape: FittedShape, overrides: Overrides, key: str, k: int) -> FittedShape:
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


def _textured(
    view: SegmentedView,
    shapes: dict[int, FittedShape],
    carriers: dict[int, int],
    given: Mapping[int, Mesh],
    progress: Progress,
) -> TexturedObjects:
    """Paint the objects, and extend the support beneath them. ``given`` contains meshes that may have a texture."""
    frame, labels = view.frame, view.segmentation.labels
    meshes = {}
    for done, (k, shape) in enumerate(shapes.items()):
        progress(f"texture {k}", 0.7 + 0.3 * done / len(shapes))
        if k in given and given[k].texture is not None:
            meshes[k] = given[k]
            continue
        inputs = {**view.seen, "mask": digest_of(view.mask(k)), "shape": digest_of(replace(shape, confidence=0.0))}
        paint = partial(textured_mesh, shape, frame, view.support, view.mask(k))
        with suppress(StaleStageError):
            meshes[k] = view.stages.run("texture", inputs, paint, str(k)).value
    grounded = [footprint(shape) for k, shape in shapes.items() if not carriers[k]]
    support = replace(view.support, outline=beneath(view.support.outline, grounded))
    thickness = measured_thickness(frame, support)
    inputs = {**view.seen, "support": digest_of(support), "labels": digest_of(labels), "thickness": repr(thickness)}
    slab = partial(support_mesh, frame, support, labels, thickness or DEFAULT_THICKNESS)
    top = view.stages.run("texture", inputs, slab, SUPPORT_NAME).value
    return TexturedObjects(shapes, carriers, meshes, support, thickness, top)


def scene_spec(
    name: str,
    frame: Frame,
    support: SupportSurface,
    fitted: TexturedObjects,
    names: Mapping[int, str],
    read: MatchedReading | None,
) -> SceneSpec:
    """Return the scene of the fitted objects by their names; ``read`` is what a model states about them."""
    objects = {SUPPORT_NAME: describe.support_spec(name, fitted.support, fitted.thickness)}
    for k, shape in fitted.shapes.items():
        objects[names[k]] = describe.object_spec(name, names[k], shape, k, read)
    priors = [SUPPORT, *(describe.material_prior(shape, k, read) for k, shape in fitted.shapes.items())]
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
