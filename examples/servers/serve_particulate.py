"""Particulate as a server of `articulate`: joints of a mesh in one state, in one pass.

Run it in a checkout of https://github.com/RuiningLi/particulate; 16 GiB of GPU memory are enough. Its own code and
weights may be used commercially, but it computes features with PartField, whose licence permits research only.
"""

from __future__ import annotations

import sys
from functools import lru_cache
from typing import Any

import numpy as np
from scaffold import Model, Result, run

POINTS = 102_400  # number of points on the mesh, as in infer.py

FULL_TURN = 2 * np.pi - 1e-3  # range [rad] of a joint that turns without end


@lru_cache(maxsize=1)
def load() -> Any:
    """Return the model; PartField's weights go where infer.py expects them."""
    import torch
    from huggingface_hub import hf_hub_download
    from omegaconf import OmegaConf
    from particulate import models

    config = OmegaConf.load("configs/particulate-B.yaml")
    size = config.pop("model_size", "B")
    model = getattr(models, f"PAT_{size}")(**config)
    weights = hf_hub_download(repo_id="rayli/Particulate", filename="model.pt")
    model.load_state_dict(torch.load(weights, map_location="cpu"))
    hf_hub_download("mikaelaangel/partfield-ckpt", "model_objaverse.ckpt", local_dir="PartField/model")
    return model.eval().to("cuda")


def articulate(request: Any) -> Result:
    """Find the joints of a mesh, for the parts that the request names."""
    import infer
    import trimesh
    from particulate.postprocessing_utils import find_part_ids_for_faces

    vertices, faces, labels = (request.members[name] for name in ("vertices", "faces", "labels"))
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    outputs, face_indices, unit = infer.infer_single_asset(
        mesh=mesh, up_dir="Z", model=load(), num_points=POINTS, min_part_confidence=0.0
    )
    found = outputs[0]
    by_face = find_part_ids_for_faces(unit, found["part_ids"], face_indices, strict=True)
    groups = labels_of_parts(by_face, labels, mesh.area_faces)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    joints, warnings = joints_of(found, groups, float((high - low).max()), (low + high) / 2)
    return Result(values={"joints": joints}, warnings=tuple(warnings))


def labels_of_parts(by_face: Any, labels: Any, areas: Any) -> dict[int, list[int]]:
    """Return the labels of the request that make up each part of Particulate, the largest first.

    A label belongs to the part that covers most of its area.
    """
    groups: dict[int, list[tuple[float, int]]] = {}
    for label in np.unique(labels[labels >= 0]).tolist():
        mine = (labels == label) & (by_face >= 0)
        if mine.any():
            shares = np.bincount(by_face[mine], weights=areas[mine])
            groups.setdefault(int(shares.argmax()), []).append((float(areas[labels == label].sum()), label))
    return {part: [label for _, label in sorted(own, reverse=True)] for part, own in groups.items()}


def joints_of(
    found: dict[str, Any], groups: dict[int, list[int]], scale: float, center: Any
) -> tuple[list[dict[str, Any]], list[str]]:
    """Return joints in the frame of the request, from a model that saw the mesh in a box of size 1 around the origin.

    Parts without a joint move with their parents, and the root does not move at all, as in Particulate's own exports.
    """
    parents = {child: parent for parent, child in found["motion_hierarchy"]}
    moves = found["is_part_revolute"] | found["is_part_prismatic"]
    labels: dict[int, list[int]] = {}
    for part in sorted(groups, key=lambda part: carrier(part, parents, moves) != part):  # a part's own labels first
        labels.setdefault(carrier(part, parents, moves), []).extend(groups[part])
    joints, warnings = [], []
    for part, own in labels.items():
        if part not in parents or not moves[part]:
            continue  # the body
        joint = turn_of(found, part, scale, center) if found["is_part_revolute"][part] else slide_of(found, part, scale)
        if joint["lower"] >= joint["upper"]:
            warnings.append(f"part {own[0]} has a joint without motion, which is left out")
            continue
        if found["is_part_revolute"][part] and found["is_part_prismatic"][part]:
            warnings.append(f"part {own[0]} turns and slides; only the turn is kept")
        above = carrier(parents[part], parents, moves)
        parent = labels[above][0] if above in parents and above in labels else -1
        joints.append({"part": own[0], "others": own[1:], "parent": parent, **joint})
    return joints, warnings


def carrier(part: int, parents: dict[int, int], moves: Any) -> int:
    """Return the part itself, or the next of its ancestors, that has a joint or is the root."""
    while part in parents and not moves[part]:
        part = parents[part]
    return part


def turn_of(found: dict[str, Any], part: int, scale: float, center: Any) -> dict[str, Any]:
    """Return a revolute joint. Its axis is in Pluecker coordinates, and its range [rad] starts from the given state."""
    from particulate.articulation_utils import plucker_to_axis_point

    axis, point = plucker_to_axis_point(found["revolute_plucker"][part])
    low, high = sorted(map(float, found["revolute_range"][part]))
    kind = "continuous" if high - low > FULL_TURN else "revolute"
    return {"type": kind, "axis": unit_vector(axis), "origin": (point * scale + center).tolist(), "lower": low,
            "upper": high}  # fmt: skip


def slide_of(found: dict[str, Any], part: int, scale: float) -> dict[str, Any]:
    """Return a prismatic joint. Its range is in sizes of the mesh."""
    low, high = sorted(float(value) * scale for value in found["prismatic_range"][part])
    return {"type": "prismatic", "axis": unit_vector(found["prismatic_axis"][part]), "lower": low, "upper": high}


def unit_vector(axis: Any) -> list[float]:
    """Return an axis with the length 1."""
    axis = np.asarray(axis, np.float64)
    return [float(value) for value in axis / np.linalg.norm(axis)]


MODEL = Model(
    {"name": "particulate", "version": "rayli/Particulate", "licence": "CC-BY-4.0", "commercial": False},
    {"articulate": articulate},
)

if __name__ == "__main__":
    sys.exit(run(MODEL))
