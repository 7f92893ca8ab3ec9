"""P3-SAM, PartField and Segment Any Mesh as servers of `parts`; the first argument chooses the model.

Each runs in a checkout of its own: https://github.com/Tencent-Hunyuan/Hunyuan3D-Part (P3-SAM/demo),
https://github.com/nv-tlabs/PartField (research only) and https://github.com/gtangg12/samesh.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from scaffold import Model, Result, run

CLUSTERS = 10  # parts that PartField's features are divided into, as in the release of SimFoundry


def given_mesh(request: Any) -> Any:
    """Return the mesh of a request with its own order of triangles."""
    import trimesh

    return trimesh.Trimesh(request.members["vertices"], request.members["faces"], process=False)


def transferred(mesh: Any, other: Any, labels: Any) -> Any:
    """Return labels of the triangles of ``mesh`` from the nearest triangles of ``other``."""
    from scipy.spatial import cKDTree

    if len(other.faces) == len(mesh.faces) and np.allclose(other.triangles_center, mesh.triangles_center):
        return np.asarray(labels)
    return np.asarray(labels)[cKDTree(other.triangles_center).query(mesh.triangles_center)[1]]


def answer(labels: Any) -> Result:
    """Return labels that count the parts from 0, with -1 for unknown."""
    labels = np.asarray(labels)
    numbers = {value: k for k, value in enumerate(sorted(set(labels[labels >= 0].tolist())))}
    return Result({"labels": np.array([numbers.get(value, -1) for value in labels.tolist()], np.int32)})


@lru_cache(maxsize=1)
def load_p3sam() -> Any:
    """Return P3-SAM."""
    from auto_mask import AutoMask

    return AutoMask(os.environ.get("P3SAM_CHECKPOINT", "weights/p3sam.ckpt"))


def p3sam(request: Any) -> Result:
    """Run P3-SAM. Its labels belong to the mesh that it returns, which it has cleaned."""
    mesh = given_mesh(request)
    _, face_ids, cleaned = load_p3sam().predict_aabb(
        mesh, point_num=100_000, prompt_num=400, threshold=0.95, post_process=True, clean_mesh_flag=True,
        seed=request.head["seed"], is_parallel=True, prompt_bs=32,
    )  # fmt: skip
    return answer(transferred(mesh, cleaned, face_ids))


def samesh(request: Any) -> Result:
    """Run Segment Any Mesh, which writes the labels of its triangles beside its output."""
    from omegaconf import OmegaConf
    from samesh.models.sam_mesh import segment_mesh

    mesh = given_mesh(request)
    with tempfile.TemporaryDirectory() as folder:
        config = OmegaConf.load("configs/mesh_segmentation.yaml")
        config.cache, config.output = f"{folder}/cache", f"{folder}/output"
        mesh.export(f"{folder}/mesh.glb")
        colored = segment_mesh(f"{folder}/mesh.glb", config, visualize=False, extension="glb", texture=False)
        read = json.loads(Path(f"{folder}/output/mesh/mesh_face2label.json").read_text())
    labels = np.array([read.get(str(face), -1) for face in range(len(colored.faces))])
    if len(labels) != len(mesh.faces):
        raise RuntimeError(f"Segment Any Mesh labeled {len(labels)} triangles of {len(mesh.faces)}")
    return answer(labels)


def partfield(request: Any) -> Result:
    """Run PartField's script, and divide the features of the triangles into clusters of connected ones."""
    from sklearn.cluster import AgglomerativeClustering

    mesh = given_mesh(request)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "in").mkdir()
        mesh.export(f"{folder}/in/mesh.glb")
        command = [
            sys.executable, "partfield_inference.py", "-c", "configs/final/demo.yaml", "--opts", "continue_ckpt",
            "model/model_objaverse.ckpt", "result_name", folder, "dataset.data_path", f"{folder}/in",
        ]  # fmt: skip
        subprocess.run(command, check=True, stdout=sys.stderr)
        features = np.load(next(Path(folder).rglob("part_feat_mesh_0*.npy")))
    features /= np.linalg.norm(features, axis=1, keepdims=True)
    if len(features) != len(mesh.faces):
        raise RuntimeError(f"PartField described {len(features)} triangles of {len(mesh.faces)}")
    return answer(AgglomerativeClustering(n_clusters=min(CLUSTERS, len(features))).fit(features).labels_)


TENCENT = "Tencent Hunyuan 3D-Part community licence"
NVIDIA = "NVIDIA source code licence"
MODELS = {
    "p3sam": Model(
        {"name": "p3-sam", "version": "p3sam.ckpt", "licence": TENCENT, "commercial": None}, {"parts": p3sam}
    ),
    "samesh": Model({"name": "samesh", "version": "1", "licence": "unknown", "commercial": None}, {"parts": samesh}),
    "partfield": Model(
        {"name": "partfield", "version": "model_objaverse", "licence": NVIDIA, "commercial": False},
        {"parts": partfield},
    ),
}

if __name__ == "__main__":
    sys.exit(run(MODELS[sys.argv[1]], sys.argv[2:]))
