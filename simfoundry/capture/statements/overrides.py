"""Corrections by a person: masks, names, poses and meshes that a reconstruction takes as they are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, StringConstraints

from simfoundry.assets.errors import MeshError
from simfoundry.assets.mesh import merged, read_mesh
from simfoundry.capture.findings import NOT_FOLLOWED, CaptureFinding
from simfoundry.capture.outputs.mask_files import MASK_NAMES, MASKS, read_mask_names, read_masks, read_model
from simfoundry.capture.outputs.output_folder import PreviousOutput
from simfoundry.capture.segment.masks import Labels
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import frozen_array
from simfoundry.geometry.shapes import Mesh
from simfoundry.spec.models.base import Model, Name, PoseSpec

# Folder beside `capture.yaml` with the corrections of the first frame; those of another frame are in a folder below it.
OVERRIDES_FOLDER = "overrides"

OBJECTS = "objects.yaml"

JointWords = Annotated[str, StringConstraints(min_length=1, max_length=200)]

HINT = "correct the name, or remove the entry"


class ObjectOverride(Model):
    """Corrections of one object by a person."""

    name: Name | None = Field(None, description="Name of the object in the scene.")
    pose: PoseSpec | None = Field(None, description="Pose of the object in the world of the scene, before it settles.")
    mesh: str | None = Field(
        None, description="Mesh file, relative to this document, in meters and with z up; replaces the fitted solid."
    )
    moves: bool | None = Field(None, description="Whether it has parts that move, whatever a model says.")
    joints: tuple[JointWords, ...] = Field(
        (), max_length=64, description="Joints of its parts, in the words of `simfoundry articulate --joint`."
    )


class ObjectOverrides(Model):
    """The document with a person's corrections of objects."""

    objects: dict[Name, ObjectOverride] = Field({}, description="Objects by the names that the reconstruction gives.")


@dataclass(frozen=True, eq=False)
class Overrides:
    """Corrections of a reconstruction.

    Attributes:
        masks: Number of the object at each pixel, shape (h, w), which replaces the segmentation, or None.
        names: Numbers of objects in ``masks``, or in the last segmentation, by name.
        objects: What is stated about objects, by the names that the reconstruction gives.
        meshes: Meshes of these objects in their own frames, by the same names.
        edited: Which of `masks.png` and `masks.yaml` in the output the person edited.
    """

    masks: Labels | None = None
    names: Mapping[str, int] = field(default_factory=dict)
    objects: Mapping[str, ObjectOverride] = field(default_factory=dict)
    meshes: Mapping[str, Mesh] = field(default_factory=dict)
    edited: tuple[str, ...] = ()

    def of(self, names: tuple[str, ...]) -> tuple[str, ObjectOverride]:
        """Return the override of an object that goes by several names, with the name by which it is stated."""
        key = next((name for name in names if name in self.objects), names[0])
        return key, self.objects.get(key, ObjectOverride.model_construct())

    def unused(self, names: set[str]) -> tuple[CaptureFinding, ...]:
        """Return a finding for each object that is stated and was not found. ``names`` are those that were found."""
        missing = sorted(set(self.objects) - names)
        text = "the override of `{}` was not used: no such object was found"
        return tuple(CaptureFinding(NOT_FOLLOWED, text.format(name), HINT) for name in missing)


def load_overrides(document: Path, frame: str, is_first: bool, size: tuple[int, int], out: PreviousOutput) -> Overrides:
    """Load the corrections of a frame, from the folder of the capture and from edited files in the output.

    Args:
        document: The capture document.
        frame: Name of the frame.
        is_first: True if the frame is the first one of the capture.
        size: Height and width of the color image [px].
        out: The output of the last run. Edited masks in it replace those in the folder of the capture.

    Raises:
        SimfoundryError, SpecError: A correction cannot be used.
    """
    folder = document.parent / OVERRIDES_FOLDER
    folder = folder if is_first else folder / frame
    edited = out.edited_masks((MASKS, MASK_NAMES))
    at = {name: out.folder / name if name in edited else folder / name for name in (MASKS, MASK_NAMES)}
    masks = read_masks(at[MASKS], size) if at[MASKS].is_file() else None
    names = read_mask_names(at[MASK_NAMES]) if at[MASK_NAMES].is_file() else {}
    objects = folder / OBJECTS
    stated = dict(read_model(ObjectOverrides, objects).objects) if objects.is_file() else {}
    meshes = {name: _mesh(objects, item.mesh) for name, item in stated.items() if item.mesh is not None}
    return Overrides(masks, names, stated, meshes, edited)


def _mesh(document: Path, file: str) -> Mesh:
    path = document.parent / file
    try:
        parts = read_mesh(path)
    except (OSError, MeshError) as error:
        raise SimfoundryError(f"{document} names the mesh {file}, which could not be read: {error}") from None
    if len(parts) == 1:
        (part,) = parts
        return Mesh(frozen_array(part.vertices), part.faces, part.uv, part.texture)
    vertices, faces = merged(parts)
    return Mesh(frozen_array(vertices), np.ascontiguousarray(faces))
