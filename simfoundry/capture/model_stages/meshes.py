"""Meshes and poses from models, judged by the same measure as fitted solids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from simfoundry.assets.mesh import MeshPart, merged
from simfoundry.capture.candidates import ShapeChoice
from simfoundry.capture.description.describe import mesh_files, object_spec
from simfoundry.capture.frame import Frame, SupportSurface
from simfoundry.capture.model_stages.ask import Makers, ModelResult, StageModels
from simfoundry.capture.model_stages.joints import require_lowered
from simfoundry.capture.removal import ClearedImage
from simfoundry.capture.segment.masks import Labels, Mask
from simfoundry.capture.shapes.evidence import Evidence, RayAgreement, gather
from simfoundry.capture.shapes.fit import MAX_ALTERNATIVES, FittedShape
from simfoundry.capture.shapes.mesh_template import MeshTemplate, simplified_surface
from simfoundry.capture.shapes.register_mesh import pose_agreement, register_upright
from simfoundry.capture.stages.codec import digest_of
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Pose, frozen_array
from simfoundry.geometry.shapes import Mesh, tessellate
from simfoundry.models.open import open_model
from simfoundry.models.setup import ModelSetup
from simfoundry.models.tasks.depth import Pixels
from simfoundry.models.tasks.poses import Z_UP
from simfoundry.render.glb import glb_of
from simfoundry.runtime.files import write_files
from simfoundry.spec.models.scene import SceneSpec

# Number of triangles that are asked for: enough for a handle, and few enough for a simulator's convex pieces.
FACES = 8000

# Number of triangles above which a mesh is simplified, without its texture: the model did not do what it was asked.
FACES_MAX = 40_000

# Transparent margin around the object in its picture, as a share of the longer side; models were trained with some.
MARGIN = 0.15

# Least pixels of an object that a mesh model can see something in.
FEWEST_PIXELS = 200

# Decrease of the cost that a generated mesh requires: its hidden sides are a model's idea. It is that of a solid of
# revolution, see `PRIOR`.
MESH_WORTH = 0.06

# Decrease of the cost for which a model's pose replaces the fitted one, as in a registration.
POSE_WORTH = 0.005

# Confidence in a shape whose far side is a guess, relative to one whose sides were measured; see `confidence`.
GUESSED = 0.7

# Rotates our axes (z up) into those of a GLB file (y up).
X_FILE_OBJECT = Pose.from_matrix(np.linalg.inv(Z_UP))


@dataclass(frozen=True, eq=False)
class ObjectView:
    """An object in an image: its number, the objects around it (see ``nearby_labels``), and its fitted solid."""

    frame: Frame
    support: SupportSurface
    labels: Labels
    number: int
    nearby: Labels
    shape: FittedShape

    @property
    def mask(self) -> Mask:
        """The pixels of the object, shape (h, w)."""
        return np.asarray(self.labels == self.number)

    def evidence(self) -> Evidence:
        """Return the evidence for the object in the image."""
        low = float(self.shape.X_WO.apply(tessellate(self.shape.geometry).vertices)[:, 2].min())
        return gather(self.frame, self.support, self.nearby == 1, low, self.nearby)


def object_picture(view: ObjectView, cleared: Sequence[ClearedImage]) -> Pixels | None:
    """Return a square RGBA image of an object, with a transparent background, or None for too few pixels.

    What stands in front of the object has been removed: ``cleared`` are the images without the objects of each layer,
    and the one before that of the object shows what the others hid of it.
    """
    before = [image for image in cleared if view.number not in image.removed]
    color, mask = (before[-1].color, before[-1].shown == view.number) if before else (view.frame.color, view.mask)
    rows, columns = np.nonzero(mask)
    if len(rows) < FEWEST_PIXELS:
        return None
    top, left, bottom, right = rows.min(), columns.min(), rows.max() + 1, columns.max() + 1
    side = int(np.ceil((1 + 2 * MARGIN) * max(bottom - top, right - left)))
    picture = np.zeros((side, side, 4), np.uint8)
    row, column = (side - (bottom - top)) // 2, (side - (right - left)) // 2
    window = np.s_[top:bottom, left:right]
    alpha = np.where(mask[window], 255, 0).astype(np.uint8)
    own = np.where(alpha[..., None] > 0, color[window], 0).astype(np.uint8)
    picture[row : row + bottom - top, column : column + right - left] = np.dstack([own, alpha])
    return picture


def model_mesh(view: ObjectView, picture: Pixels, models: StageModels) -> ModelResult[ShapeChoice] | None:
    """Return the mesh of a model as a candidate for an object, or None without an answer.

    Scale and pose of the mesh are estimated by registration with the depth. Its texture is kept if it has a single one.
    """
    inputs = {"picture": digest_of(picture), "shape": digest_of(view.shape), "others": digest_of(view.nearby)}
    inputs |= {"depth": digest_of(view.frame.depth), "X_WC": digest_of(view.support.X_WC)}

    def make(setup: ModelSetup) -> tuple[ShapeChoice, Makers]:
        answer = open_model(setup, "mesh").make_mesh(picture, faces=FACES)
        evidence = view.evidence()
        mesh = _centered(answer.parts)
        found = register_upright(evidence, MeshTemplate.of(mesh), None)
        if not (np.isfinite(found.scale) and found.scale > 0):
            raise SimfoundryError("the mesh cannot be registered with the depth")
        scaled = Mesh(frozen_array(found.scale * mesh.vertices), mesh.faces, mesh.uv, mesh.texture)
        shape = _shaped(view.shape, scaled, found.X_WO, found.agreement, evidence)
        choice = _choice(view.shape, shape, evidence, found.agreement, MESH_WORTH)
        if choice.is_better:
            require_usable(shape)
        return choice, {"mesh": answer.made_by}

    return models.ask("mesh", inputs, make, str(view.number))


def model_pose(view: ObjectView, models: StageModels) -> ModelResult[ShapeChoice] | None:
    """Return the pose of a model as a candidate for an object, or None without an answer or without a mesh."""
    mesh = view.shape.geometry
    if not isinstance(mesh, Mesh) or not models.asks("refine"):
        return None
    frame = view.frame
    inputs = {"color": digest_of(frame.color), "depth": digest_of(frame.depth), "K": digest_of(frame.K)}
    inputs |= {"mask": digest_of(view.mask), "shape": digest_of(view.shape), "X_WC": digest_of(view.support.X_WC)}

    def estimate(setup: ModelSetup) -> tuple[ShapeChoice, Makers]:
        glb = glb_of([(mesh, X_FILE_OBJECT, (0.7, 0.7, 0.7, 1.0))])
        found = open_model(setup, "pose").estimate_pose(
            frame.color, np.asarray(frame.depth, np.float32), frame.K, view.mask, glb
        )
        factor = float(found.scale[0])
        scaled = mesh if factor == 1 else Mesh(frozen_array(factor * mesh.vertices), mesh.faces, mesh.uv, mesh.texture)
        evidence, X_WO = view.evidence(), view.support.X_WC @ Pose.from_matrix(found.object_to_camera[0])
        result = pose_agreement(evidence, (scaled.vertices, scaled.faces), X_WO)
        shape = _shaped(view.shape, scaled, X_WO, result, evidence)
        return _choice(view.shape, shape, evidence, result, POSE_WORTH), {"pose": found.made_by}

    return models.ask("refine", inputs, estimate, str(view.number))


def require_usable(shape: FittedShape) -> None:
    """Ensure that a simulator can use a mesh, which may have holes or no volume.

    Raises:
        SpecError: It cannot.
    """
    item = object_spec("mesh", "it", shape).model_copy(update={"collision": "hull", "material": None})
    scene = SceneSpec(simfoundry="scene/1", name="mesh", objects={"it": item})
    with TemporaryDirectory(prefix="simfoundry-mesh-") as folder:
        write_files(Path(folder), mesh_files("it", tessellate(shape.geometry)))
        require_lowered(scene, Path(folder))


def _centered(parts: Sequence[MeshPart]) -> Mesh:
    """Return a mesh with its origin below its center, at the height of its base."""
    if len(parts) == 1:
        vertices, faces, uv, texture = parts[0].vertices, parts[0].faces, parts[0].uv, parts[0].texture
    else:
        (vertices, faces), uv, texture = merged(parts), None, None
    if len(faces) > FACES_MAX:
        (vertices, faces), uv, texture = simplified_surface(vertices, faces, FACES), None, None
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    shifted = vertices - np.array([*(low + high)[:2] / 2, low[2]])
    bare = uv is None or texture is None
    return Mesh(frozen_array(shifted), np.ascontiguousarray(faces, np.int32), None if bare else uv, texture)


def _shaped(before: FittedShape, mesh: Mesh, X_WO: Pose, result: RayAgreement, evidence: Evidence) -> FittedShape:
    """Replace the solid of an object by a mesh. Settling falls back on the solid if the mesh does not come to rest."""
    fit = result.fit if np.isfinite(result.fit) else evidence.scale
    sure = GUESSED * result.explained * (1.0 - min(result.intrusion, 1.0))
    others = (replace(before, alternatives=()), *before.alternatives)[:MAX_ALTERNATIVES]
    return FittedShape(mesh, X_WO, float(fit), float(np.clip(sure, 0, 1)), False, None, others)


def _choice(
    before: FittedShape, after: FittedShape, evidence: Evidence, result: RayAgreement, worth: float
) -> ShapeChoice:
    solid = tessellate(before.geometry)
    cost = pose_agreement(evidence, (np.asarray(solid.vertices), np.asarray(solid.faces)), before.X_WO).cost
    return ShapeChoice(after, result.cost, cost, bool(result.cost < cost - worth))
