"""Objects with parts that move: their joints from models, or as a person states them."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from simfoundry.assets.mesh import read_mesh
from simfoundry.capture.articulation.from_mesh import articulate_mesh
from simfoundry.capture.articulation.segments import Front, object_frame
from simfoundry.capture.candidates import JointedObject
from simfoundry.capture.model_stages.ask import Makers, ModelResult, StageModels
from simfoundry.capture.stages.codec import digest_of
from simfoundry.geometry.frames import Array, Pose, frozen_array
from simfoundry.geometry.shapes import Mesh
from simfoundry.models.provenance import ModelIdentity
from simfoundry.models.setup import ModelSetup
from simfoundry.runtime.files import file_digests, write_files
from simfoundry.scene.lower import PASSES, Lowering
from simfoundry.scene.meshfile import obj_with_material
from simfoundry.spec.load import load, load_scene
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.origin import ModelUse
from simfoundry.spec.models.scene import ObjectSpec, SceneSpec
from simfoundry.spec.yaml.write import to_yaml

# Folder beside the scene with the assets of objects that have joints, each in a folder of its own.
ARTICULATED = "articulated"

# Least number of triangles of a mesh that is divided into parts: a box then has cells of an eighth of its sides.
LEAST_FACES = 700

# Directions in which the front of an object may face, in the frame of its mesh.
FRONTS: Mapping[Front, tuple[float, float]] = {"+x": (1, 0), "-x": (-1, 0), "+y": (0, 1), "-y": (0, -1)}


def jointed_object(
    name: str, label: str, mesh: Mesh, X_WM: Pose, eye: Array, stated: Sequence[str], models: StageModels
) -> ModelResult[JointedObject] | None:
    """Return an object with joints, or None without a model for `articulate` or an answer.

    Args:
        name: Name of the object.
        label: Its number, as text.
        mesh: Its surface in the frame M [m], z up.
        X_WM: Pose of this frame in the world.
        eye: Position of the camera in the world [m]; the side of the object that faces it is the front.
        stated: Joints that a person states, in the words of `simfoundry articulate --joint`.
        models: The models.
    """
    compute = partial(written_joints, name, mesh, X_WM, eye, stated)
    return models.ask("parts", joint_inputs(name, mesh, X_WM, eye, stated), compute, label)


def stated_joints(
    name: str, mesh: Mesh, X_WM: Pose, eye: Array, stated: Sequence[str], setup: ModelSetup
) -> JointedObject:
    """Return an object with joints that a person states; see :func:`written_joints`."""
    return written_joints(name, mesh, X_WM, eye, stated, setup)[0]


def joint_inputs(name: str, mesh: Mesh, X_WM: Pose, eye: Array, stated: Sequence[str]) -> dict[str, str]:
    """Return digests of what the joints of an object depend on, besides models; see :func:`jointed_object`."""
    return {"name": name, "mesh": digest_of(mesh), "front": _front(X_WM, eye), "joints": "\n".join(stated)}


def written_joints(
    name: str, mesh: Mesh, X_WM: Pose, eye: Array, stated: Sequence[str], setup: ModelSetup
) -> tuple[JointedObject, Makers]:
    """Find the joints of a mesh, and return it as an asset with the models that answered; see :func:`jointed_object`.

    Raises:
        SimfoundryError: If a model fails, or the joints do not fit the mesh.
    """
    front = _front(X_WM, eye)
    with TemporaryDirectory(prefix="simfoundry-joints-") as scratch:
        folder = Path(scratch)
        write_files(folder, obj_with_material(subdivided(mesh), name))
        source, out = folder / f"{name}.obj", folder / "asset" / f"{name}.asset.yaml"
        made = articulate_mesh(source, out, setup, stated, front, collision="auto")
        X_MA = object_frame(read_mesh(source), front)
        spec = load(out).spec
        require_lowered(
            SceneSpec(simfoundry="scene/1", name="joints", objects={"it": ObjectSpec(asset=out.name)}), out.parent
        )
        written = {path: (out.parent / path).read_bytes() for path in file_digests(out.parent)}
    assert isinstance(spec, AssetSpec) and spec.origin is not None
    makers = {use.task: _identity(use) for use in spec.origin.models}
    files = {f"{ARTICULATED}/{name}/{path}": data for path, data in written.items()}
    names = tuple(joint.name for joint in made.joints)
    return JointedObject(files, f"{ARTICULATED}/{name}/{out.name}", X_MA, names), makers


def subdivided(mesh: Mesh) -> Mesh:
    """Return the same surface with at least :data:`LEAST_FACES` triangles, each divided into four as often as needed.

    Parts consist of whole triangles, and a fitted box has only twelve.
    """
    columns = mesh.vertices if mesh.uv is None else np.hstack([mesh.vertices, mesh.uv])
    faces = mesh.faces
    while len(faces) < LEAST_FACES:
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        unique, index = np.unique(edges, axis=0, return_inverse=True)
        ab, bc, ca = (index.reshape(-1, 3) + len(columns)).T
        a, b, c = faces.T
        columns = np.vstack([columns, columns[unique].mean(axis=1)])
        corners = (a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca)
        faces = np.ascontiguousarray(np.column_stack(corners).reshape(-1, 3), np.int32)
    uv = None if mesh.uv is None else frozen_array(columns[:, 3:])
    return Mesh(frozen_array(columns[:, :3]), faces, uv, mesh.texture)


def require_lowered(scene: SceneSpec, folder: Path) -> None:
    """Check that an asset with files in ``folder`` can be lowered, before the scene of the capture uses it.

    Raises:
        SpecError: It cannot.
    """
    with TemporaryDirectory(prefix="simfoundry-check-") as scratch:
        copy = Path(scratch) / "scene"
        shutil.copytree(folder, copy)
        path = copy / "check.scene.yaml"
        path.write_text(to_yaml(scene), encoding="utf-8")
        Lowering(load_scene(path), None, None, True, draft=True).run(PASSES)


def _identity(use: ModelUse) -> ModelIdentity:
    commercial = {"allowed": True, "forbidden": False}.get(use.commercial)
    return ModelIdentity(
        name=use.name,
        version=use.version,
        licence=use.licence,
        commercial=commercial,
        weights_sha256=use.weights_sha256,
    )


def _front(X_WM: Pose, eye: Array) -> Front:
    """Return the direction in the frame M that faces the camera most."""
    toward = X_WM.inverse().apply(eye)
    scores = {front: float(np.dot(toward[:2], axis)) for front, axis in FRONTS.items()}
    return max(scores, key=lambda front: scores[front])
