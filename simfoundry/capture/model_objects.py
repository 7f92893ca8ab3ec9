"""Objects as models see them: a mesh and a pose in place of a fitted solid, and joints between their parts."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from simfoundry.capture.candidates import JointedObject, ShapeChoice
from simfoundry.capture.description.describe import mesh_files
from simfoundry.capture.description.mass_estimates import share_mass
from simfoundry.capture.findings import NOT_FOLLOWED, CaptureFinding
from simfoundry.capture.model_stages.ask import StageModels
from simfoundry.capture.model_stages.joints import joint_inputs, jointed_object, stated_joints
from simfoundry.capture.model_stages.meshes import ObjectView, model_mesh, model_pose, object_picture
from simfoundry.capture.object_stages import SegmentedView, TexturedObjects
from simfoundry.capture.reconstruct import nearby_labels
from simfoundry.capture.removal import ClearedImage
from simfoundry.capture.shapes.fit import FittedShape
from simfoundry.capture.stages.runner import StaleStageError
from simfoundry.capture.statements.overrides import Overrides
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.shapes import tessellate
from simfoundry.runtime.files import MARK
from simfoundry.scene.state import pose_spec
from simfoundry.spec.load import load
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.base import Estimate, Quantity
from simfoundry.spec.models.origin import ModelUse
from simfoundry.spec.models.scene import ObjectSpec
from simfoundry.spec.yaml.write import to_yaml

# Folder of the output with the shapes that were compared, which a person may state in `overrides/objects.yaml`.
CANDIDATES = "candidates"


@dataclass(frozen=True, eq=False)
class ModelObjects:
    """The contributions of models to the objects of an image, by the numbers of the objects.

    Attributes:
        shapes: The shapes that are used.
        uses: The models that made them.
        choices: The meshes that models made, used or not, beside the solids that were fitted.
        fitted: The fitted solids.
    """

    shapes: dict[int, FittedShape]
    uses: dict[int, tuple[ModelUse, ...]] = field(default_factory=dict)
    choices: dict[int, ShapeChoice] = field(default_factory=dict)
    fitted: Mapping[int, FittedShape] = field(default_factory=dict)

    def files(self, names: Mapping[int, str]) -> dict[str, bytes]:
        """Return both shapes of each object for which a model made one, by path relative to the scene."""
        out: dict[str, bytes] = {}
        for k, choice in self.choices.items():
            for source, shape in (("model", choice.shape), ("fitted", self.fitted[k])):
                for path, data in mesh_files(f"{names[k]}_{source}", tessellate(shape.geometry)).items():
                    out[path.replace("meshes/", f"{CANDIDATES}/", 1)] = data
        return out

    def report(self, names: Mapping[int, str]) -> dict[str, dict[str, Any]]:
        """Return the costs by which shapes were compared, by name of the object, as plain data for JSON."""
        return {
            names[k]: {"cost": {"model": round(choice.cost, 4), "fitted": round(choice.fitted_cost, 4)}}
            for k, choice in self.choices.items()
        }


def model_shapes(
    view: SegmentedView, shapes: Mapping[int, FittedShape], cleared: Sequence[ClearedImage], models: StageModels
) -> ModelObjects:
    """Return the objects with the meshes and the poses of models where they explain the image better."""
    found = ModelObjects(dict(shapes), fitted=dict(shapes))
    if not (models.asks("mesh") or models.asks("refine")):
        return found
    labels = view.segmentation.labels
    for k, shape in shapes.items():
        if k in view.segmentation.surfaces:
            continue
        one = ObjectView(view.frame, view.support, labels, k, nearby_labels(labels, k), shape)
        picture = object_picture(one, cleared) if models.asks("mesh") else None
        made = None if picture is None else model_mesh(one, picture, models)
        if made is not None:
            found.choices[k] = made.value
        for result in (made, model_pose(_with_shape(one, made.value if made else None), models)):
            if result is not None and result.value.is_better:
                found.shapes[k] = result.value.shape
                found.uses[k] = (*found.uses.get(k, ()), *result.models)
    return found


def _with_shape(view: ObjectView, choice: ShapeChoice | None) -> ObjectView:
    if choice is None or not choice.is_better:
        return view
    return ObjectView(view.frame, view.support, view.labels, view.number, view.nearby, choice.shape)


@dataclass(frozen=True, eq=False)
class JointedObjects:
    """Objects with joints by their numbers, the models that found the joints, and what could not be followed."""

    objects: dict[int, JointedObject] = field(default_factory=dict)
    uses: dict[int, tuple[ModelUse, ...]] = field(default_factory=dict)
    findings: list[CaptureFinding] = field(default_factory=list)


def jointed_objects(
    view: SegmentedView,
    textured: TexturedObjects,
    names: Mapping[int, str],
    moving: Collection[int],
    overrides: Mapping[int, str],
    stated: Overrides,
    models: StageModels,
) -> JointedObjects:
    """Return the objects with parts that move.

    Args:
        view: The image.
        textured: The objects.
        names: Names of objects by number.
        moving: Objects that move as a model reads the image.
        overrides: The names by which a person states something about objects, by number.
        stated: What a person states. Objects whose joints are stated need no model.
        models: The models.
    """
    out, eye = JointedObjects(), view.support.X_WC.p
    for k, mesh in textured.meshes.items():
        override = stated.objects.get(overrides[k])
        joints = () if override is None else override.joints
        is_moving = k in moving if override is None or override.moves is None else override.moves
        X_WO = textured.shapes[k].X_WO
        if joints and models.setup is not None and not models.asks("parts"):
            inputs = joint_inputs(names[k], mesh, X_WO, eye, joints)
            compute = partial(stated_joints, names[k], mesh, X_WO, eye, joints, models.setup)
            try:
                out.objects[k] = view.stages.run("parts", inputs, compute, str(k)).value
            except StaleStageError:
                continue
            except SimfoundryError as error:
                hint = "compare the joints with those that `simfoundry articulate` accepts for the mesh"
                out.findings.append(CaptureFinding(NOT_FOLLOWED, str(error), hint, (names[k],)))
        elif joints or is_moving:
            result = jointed_object(names[k], str(k), mesh, X_WO, eye, joints, models)
            if result is not None:
                out.objects[k], out.uses[k] = result.value, result.models
    return out


def weighed(jointed: JointedObjects, masses: Mapping[int, Quantity | None]) -> JointedObjects:
    """Return objects with joints whose links have the masses together that the scene would state for them [kg].

    What is known of an object decides on its mass, with its range and its source; the articulation only divides it.
    """
    objects = dict(jointed.objects)
    for k, each in jointed.objects.items():
        mass = masses[k]
        asset = load(Path(each.asset), text=each.files[each.asset].decode()).spec
        if isinstance(mass, Estimate) and isinstance(asset, AssetSpec):
            text = to_yaml(share_mass(asset, mass), comment=MARK)
            objects[k] = replace(each, files={**each.files, each.asset: text.encode()})
    return replace(jointed, objects=objects)


def jointed_spec(
    item: ObjectSpec, jointed: JointedObject, shape: FittedShape, uses: tuple[ModelUse, ...]
) -> ObjectSpec:
    """Return an object of a scene that is an asset with joints, at the place of the solid that it replaces."""
    origin = item.origin
    if origin is not None:
        origin = origin.model_copy(update={"models": (*origin.models, *uses)})
    return ObjectSpec(
        category=item.category,
        asset=jointed.asset,
        pose=pose_spec(shape.X_WO @ jointed.X_MA),
        origin=origin,
    )
