"""Reconstruct a scene with meshes from a single image, stage by stage."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import partial

from simfoundry.capture.cad.library import CadLibrary
from simfoundry.capture.description import describe
from simfoundry.capture.description.describe import SUPPORT_NAME, mesh_files
from simfoundry.capture.description.kinds import SUPPORT
from simfoundry.capture.description.naming import final_names, found_names, kept_names, matched_names
from simfoundry.capture.doubts.depth_faults import depth_faults
from simfoundry.capture.doubts.image_doubts import segmentation_doubts
from simfoundry.capture.findings import NOT_FOLLOWED, CaptureFinding
from simfoundry.capture.frame import Frame, Segmentation, SupportSurface
from simfoundry.capture.model_objects import JointedObjects, jointed_objects, jointed_spec, model_shapes, weighed
from simfoundry.capture.model_stages.ask import MODEL_STAGES, StageModels
from simfoundry.capture.model_stages.background import BACKGROUND, Views, model_background
from simfoundry.capture.model_stages.depth import completed_frame
from simfoundry.capture.object_stages import (
    SegmentedView,
    TexturedObjects,
    cleared_images_of,
    fitted_shapes,
    placed_by_person,
    segmented_frame,
    textured_objects,
)
from simfoundry.capture.reconstruct import Progress, Reconstruction
from simfoundry.capture.removal import removal_layers
from simfoundry.capture.scene_reading import MatchedReading, match_objects, read_scene, unmatched_findings
from simfoundry.capture.segment.any_size import support_of
from simfoundry.capture.segment.masks import Labels
from simfoundry.capture.shapes.fit import FittedShape
from simfoundry.capture.stages.codec import digest_of
from simfoundry.capture.stages.runner import StageResult, StageRunner
from simfoundry.capture.statements.overrides import Overrides
from simfoundry.models.setup import ModelSetup
from simfoundry.spec.models.origin import ModelUse, Origin
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.surroundings import BackgroundSpec, LightSpec

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
        cad: Models that objects may be, or None.
        views: Loads the other frames of the capture, each with the pose of its camera in that of this one.
    """

    given: Mapping[str, int] = field(default_factory=dict)
    overrides: Overrides = field(default_factory=Overrides)
    last: Labels | None = None
    last_names: Mapping[str, int] = field(default_factory=dict)
    setup: ModelSetup | None = None
    cad: CadLibrary | None = None
    views: Callable[[], Views] = tuple


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
    overrides, models, measured = known.overrides, StageModels(known.setup, stages), source.value
    frame, completed = completed_frame(measured, models)
    seen = {"image": digest_of([measured.color, measured.depth, measured.K])}
    progress("support", 0.0)
    support = _found_support(measured, seen, stages)
    progress("objects", 0.1)
    reading = read_scene(models, frame.color)
    found = segmented_frame(measured, frame, support, seen, overrides, models, reading, known.cad)
    seen |= {} if completed is None else {"completed": completed.digest}
    view = SegmentedView(frame, support.value, found.value, seen | {"support": support.digest}, stages)
    image_findings = stages.begin(partial(_image_doubts, view, measured))
    shapes, carriers, findings = fitted_shapes(view, progress, known.cad, found.matches)
    clearing = stages.begin(partial(cleared_images_of, view, shapes, models))
    is_asked = any(map(models.asks, MODEL_STAGES))  # models are asked one after the other
    cleared, painters = clearing() if is_asked else ((), ())
    modelled = model_shapes(view, shapes, cleared, models)
    read = None if reading is None else match_objects(reading, found.value.labels)
    first_names, names = _named(view, modelled.shapes, known, read)
    keys = {k: overrides.of((names[k], first_names[k]))[0] for k in shapes}
    objects = _placed_objects(view, modelled.shapes, carriers, keys, overrides, progress)
    moving = () if read is None else [k for k, each in read.objects.items() if each.is_articulated]
    jointed = jointed_objects(view, objects, names, moving, keys, overrides, models)
    splat = model_background(frame, objects.support, shapes, cleared[-1], known.views, models) if cleared else None
    sensed = tuple(ModelUse.model_validate(dict(use)) for use in measured.models)
    everywhere = (*sensed, *(completed.models if completed else ()), *found.models)
    uses = {k: (*everywhere, *(() if keys[k] in overrides.meshes else modelled.uses.get(k, ()))) for k in shapes}
    spec = scene_spec(name, frame, support.value, objects, names, read, uses, set(found.value.surfaces))
    jointed = weighed(jointed, {k: spec.objects[names[k]].mass for k in jointed.objects})
    spec = _with_joints(spec, jointed, objects, names)
    files = _object_files(objects, jointed, names) | ({} if splat is None else {BACKGROUND: splat.value})
    spec = _with_origin(spec, (*everywhere, *(() if splat is None else (*painters, *splat.models))), splat is not None)
    findings = (
        *frame.findings,
        *_other_names(names, first_names, overrides),
        *(CaptureFinding(NOT_FOLLOWED, text, CONSTRAINT_HINT) for text in found.value.unmet),
        *unmatched_findings(read),
        *models.findings({str(k): name for k, name in names.items()}),
        *jointed.findings,
        *findings,
        *(() if known.cad is None else known.cad.findings()),
        *overrides.unused({*first_names.values(), *names.values()}),
        *image_findings(),
    )
    return Reconstruction(
        spec,
        files,
        objects.support,
        found.value,
        {name: k for k, name in names.items()},
        {names[k]: shape for k, shape in objects.shapes.items()},
        findings,
        lambda: removal_layers(clearing()[0], names),
        modelled.files(names),
        modelled.report(names),
    )


def _found_support(measured: Frame, seen: Mapping[str, str], stages: StageRunner) -> StageResult[SupportSurface]:
    """Find the support of an image as it was measured. ``seen`` is the digest of the image."""
    chosen = "" if measured.support is None else measured.support.model_dump_json()
    return stages.run("support", {**seen, "chosen": chosen}, partial(support_of, measured))


def _placed_objects(
    view: SegmentedView,
    shapes: Mapping[int, FittedShape],
    carriers: dict[int, int],
    keys: Mapping[int, str],
    overrides: Overrides,
    progress: Progress,
) -> TexturedObjects:
    """Return the textured objects, as a person states them. ``keys`` are the names by which they are stated."""
    placed = {k: placed_by_person(view, shape, overrides, keys[k], k) for k, shape in shapes.items()}
    given = {k: overrides.meshes[keys[k]] for k in shapes if keys[k] in overrides.meshes}
    return textured_objects(view, placed, carriers, given, progress)


def _image_doubts(view: SegmentedView, measured: Frame) -> tuple[CaptureFinding, ...]:
    """Return what is doubtful about an image as it was measured."""
    faults = partial(depth_faults, measured, view.support)
    found = view.stages.run("faults", view.seen, faults, quick=True, shared=True, beside=True).value
    inputs = {**view.seen, "segments": digest_of(view.segmentation)}
    look = partial(segmentation_doubts, measured, view.support, view.segmentation)
    return found + view.stages.run("doubts", inputs, look, quick=True, shared=True, beside=True).value


def _with_joints(
    spec: SceneSpec, jointed: JointedObjects, objects: TexturedObjects, names: Mapping[int, str]
) -> SceneSpec:
    """Return the scene in which the objects with parts that move are assets with joints."""
    changed = {
        names[k]: jointed_spec(spec.objects[names[k]], each, objects.shapes[k], jointed.uses.get(k, ()))
        for k, each in jointed.objects.items()
    }
    return spec.model_copy(update={"objects": {**spec.objects, **changed}})


def _with_origin(spec: SceneSpec, models: tuple[ModelUse, ...], has_background: bool) -> SceneSpec:
    """Return the scene with the models that contributed to all of it, and with its background."""
    assert spec.origin is not None
    background = BackgroundSpec(splat=BACKGROUND) if has_background else None
    origin = spec.origin.model_copy(update={"models": tuple(dict.fromkeys(models))})
    return spec.model_copy(update={"background": background, "origin": origin})


def _named(
    view: SegmentedView, shapes: Mapping[int, FittedShape], known: Statements, read: MatchedReading | None
) -> tuple[dict[int, str], dict[int, str]]:
    """Return the names that objects have by the capture, by a model or by color and shape, and those in the scene."""
    stages, segmentation = view.stages, view.segmentation
    words = {} if read is None else {k: word for k in shapes if (word := read.name(k)) is not None}
    inputs = {**view.seen, "segments": digest_of(segmentation), "shapes": digest_of(list(shapes.values()))}
    inputs |= {"masks": digest_of(view.frame.instances), "given": json.dumps(dict(known.given))}
    find = partial(found_names, view.frame, segmentation, shapes, known.given, words)
    found = stages.run("name", {**inputs, "read": digest_of(words)}, find, quick=True).value
    if known.overrides.names or any(item.name for item in known.overrides.objects.values()):
        stages.overridden.add(("name", ""))
    return found, _names(found, segmentation, known)


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


def _object_files(objects: TexturedObjects, jointed: JointedObjects, names: Mapping[int, str]) -> dict[str, bytes]:
    """Return the files with the meshes of the support and of all objects, by path."""
    files = mesh_files(SUPPORT_NAME, objects.top)
    for k, mesh in objects.meshes.items():
        files |= jointed.objects[k].files if k in jointed.objects else mesh_files(names[k], mesh)
    return files


def _other_names(
    names: Mapping[int, str], found: Mapping[int, str], overrides: Overrides
) -> tuple[CaptureFinding, ...]:
    """Return a finding for each object whose stated name is that of another object or of the support."""
    hint = "choose another name"
    wanted = {k: overrides.of((names[k], name))[1].name for k, name in found.items()}
    text = "the name `{}` is taken, so the object is called `{}`"
    taken = [(name, names[k]) for k, name in wanted.items() if name is not None and names[k] != name]
    return tuple(CaptureFinding(NOT_FOLLOWED, text.format(*pair), hint, (pair[1],)) for pair in taken)


def scene_spec(
    name: str,
    frame: Frame,
    support: SupportSurface,
    fitted: TexturedObjects,
    names: Mapping[int, str],
    read: MatchedReading | None,
    uses: Mapping[int, tuple[ModelUse, ...]],
    surfaces: Collection[int],
) -> SceneSpec:
    """Return the scene of the fitted objects by their names.

    ``read`` is what a model states about them, and ``uses`` are other models that contributed to each of them. Objects
    whose number is in ``surfaces`` are levels beside the support.
    """
    objects = {SUPPORT_NAME: describe.support_spec(name, fitted.support, fitted.thickness)}
    free = {k: shape for k, shape in fitted.shapes.items() if k not in surfaces}
    for k, shape in fitted.shapes.items():
        if k in free:
            objects[names[k]] = describe.object_spec(name, names[k], shape, k, read, uses[k])
        else:
            objects[names[k]] = describe.level_spec(name, names[k], shape, support.residual, k)
    priors = [SUPPORT, *(describe.material_prior(shape, k, read) for k, shape in free.items())]
    key_light = LightSpec(type="distant", intensity=0.45, direction=(0.4, -0.3, -1.0))
    return SceneSpec(
        simfoundry="scene/1",
        name=name,
        viewpoint="view",
        materials={prior.name: prior.material for prior in priors},
        objects=objects,
        cameras={"view": describe.camera_spec(frame, fitted.support)},
        lights={"key": key_light, "sky": LightSpec(type="dome", intensity=0.7)},
        relations=tuple(f"OnTop({names[k]}, {names.get(fitted.supports[k], SUPPORT_NAME)})" for k in free),
        origin=Origin(capture=name, fit_error=describe.meters(support.residual)),
    )
