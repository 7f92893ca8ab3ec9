"""Particulate with the names and parameters of its source, which answers in its own conventions."""

from __future__ import annotations

from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from tests.models.stub_packages import _Loadable, _module


class Particulate(_Loadable):
    """PAT_B of particulate/models.py."""

    def __init__(self, **config: Any) -> None:
        assert config == {"input_dim": 448}

    def load_state_dict(self, weights: Any) -> None:
        assert weights == {"model": "weights"}


def infer_single_asset(
    mesh: Any, up_dir: str, model: Particulate, num_points: int, min_part_confidence: float = 0.0
) -> tuple[Any, Any, Any]:
    """Return what infer.py returns for the mesh of the tests: a door with a handle on it, a drawer, and the body."""
    assert up_dir == "Z" and num_points > len(mesh.faces) and isinstance(model, Particulate)
    unit, size = mesh.copy(), np.ptp(mesh.vertices, axis=0).max()
    center = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    unit.vertices = (mesh.vertices - center) / size
    axis, point = np.array([0, 0, 1.0]), (np.array([0.1, 0, 0]) - center) / size
    faces = np.arange(len(mesh.faces))
    outcome = {
        "part_ids": np.array([3, 9, 5, 7, 8])[faces], "motion_hierarchy": [(3, 9), (9, 5), (3, 7), (3, 8)],
        "is_part_revolute": np.isin(np.arange(10), (3, 8, 9)), "is_part_prismatic": np.isin(np.arange(10), (7,)),
        "revolute_plucker": np.tile([*axis, *np.cross(axis, point)], (10, 1)),
        "revolute_range": np.where(np.arange(10)[:, None] == 8, 0.0, [0.0, 1.5]),
        "prismatic_axis": np.tile([1.0, 0, 0], (10, 1)), "prismatic_range": np.tile([0.0, 0.2], (10, 1)),
    }  # fmt: skip
    return [outcome], faces, unit


def find_part_ids_for_faces(mesh: Any, part_ids: Any, face_indices: Any, strict: bool = False) -> Any:
    labels = np.full(len(mesh.faces), -1, np.int32)
    labels[face_indices] = part_ids
    return labels


def plucker_to_axis_point(plucker: Any) -> tuple[Any, Any]:
    axis = plucker[..., :3] / np.linalg.norm(plucker[..., :3])
    return axis, np.cross(plucker[..., 3:], axis)


def hf_hub_download(repo_id: str, filename: str, *, local_dir: str | None = None) -> str:
    assert (repo_id, filename, local_dir) in {
        ("rayli/Particulate", "model.pt", None),
        ("mikaelaangel/partfield-ckpt", "model_objaverse.ckpt", "PartField/model"),
    }
    return filename


def particulate() -> list[tuple[str, ModuleType]]:
    config = SimpleNamespace(
        load=lambda path: {"configs/particulate-B.yaml": {"model_size": "B", "input_dim": 448}}[path]
    )
    utilities = {"find_part_ids_for_faces": find_part_ids_for_faces, "plucker_to_axis_point": plucker_to_axis_point}
    return [
        _module("particulate", models=SimpleNamespace(PAT_B=Particulate)),
        _module("particulate.postprocessing_utils", **utilities), _module("omegaconf", OmegaConf=config),
        _module("particulate.articulation_utils", **utilities),
        _module("infer", infer_single_asset=infer_single_asset),
        _module("huggingface_hub", hf_hub_download=hf_hub_download),
    ]  # fmt: skip
