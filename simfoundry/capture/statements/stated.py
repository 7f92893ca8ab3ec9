"""Take the masks, meshes and poses of a person as they are."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from simfoundry.capture.frame import CaptureError, Frame, Segmentation, SupportSurface
from simfoundry.capture.segment.levels import segmentation_on_levels
from simfoundry.capture.segment.masks import Labels
from simfoundry.capture.segment.merge_regions import compact
from simfoundry.capture.shapes.evidence import gather
from simfoundry.capture.shapes.fit import FittedShape
from simfoundry.capture.shapes.mesh_template import MeshTemplate
from simfoundry.capture.shapes.register_mesh import pose_agreement, register_upright
from simfoundry.geometry.frames import Pose
from simfoundry.geometry.shapes import Mesh, tessellate


def stated_segmentation(frame: Frame, support: SupportSurface, masks: Labels) -> Segmentation:
    """Return the segmentation that consists of the masks of a person, which are not changed.

    Raises:
        CaptureError: The masks contain no object.
    """
    if not masks.any():
        hint = "give each object a number of its own; 0 is the background"
        raise CaptureError("SF504", "the masks of the person contain no object", hint)
    frame = frame.cleaned()
    labels = compact(masks)
    return segmentation_on_levels(labels, frame, support, {}, ())


def placed_shape(
    frame: Frame, support: SupportSurface, shape: FittedShape, mesh: Mesh | None, stated: Pose | None, labels: Labels
) -> FittedShape:
    """Return the solid of an object with a mesh or a pose that a person states.

    A mesh without a pose is placed where it agrees best with the image, upright unless another side is clearly better.

    Args:
        frame: The image.
        support: The surface that supports the objects.
        shape: The fitted solid.
        mesh: The mesh that replaces it, in its own frame, or None.
        stated: The pose in the world, or None if there is a mesh.
        labels: 1 at the pixels of the object, 2 at those of others, shape (h, w).
    """
    geometry = shape.geometry if mesh is None else Mesh(mesh.vertices, mesh.faces)
    corners = shape.X_WO.apply(tessellate(shape.geometry).vertices)
    evidence = gather(frame, support, labels == 1, float(corners[:, 2].min()), labels)
    if stated is None:
        found = register_upright(evidence, MeshTemplate.of(tessellate(geometry)))
        X_WO, result = found.X_WO, found.agreement
    else:
        surface = (np.asarray(tessellate(geometry).vertices), np.asarray(tessellate(geometry).faces))
        X_WO, result = stated, pose_agreement(evidence, surface, stated)
    fit = result.fit if math.isfinite(result.fit) else evidence.scale
    sure = float(np.clip(result.explained * (1.0 - result.intrusion), 0.0, 1.0))
    profile = shape.profile if mesh is None else None
    hollow, wall = (shape.hollow, shape.wall) if mesh is None else (False, 0.0)
    placed = replace(shape, geometry=geometry, X_WO=X_WO, fit_m=fit, confidence=sure, alternatives=())
    handle = shape.handle if mesh is None else None
    return replace(placed, hollow=hollow, profile=profile, wall=wall, handle=handle)
