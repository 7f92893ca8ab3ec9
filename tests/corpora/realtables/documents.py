"""Pictures of real tables, which are not part of the project, as ``capture/1`` documents in a temporary folder."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from simfoundry.geometry.frames import Pose

SETS = {"posecnn_demo": 5, "mosd_dev": 12, "graspnet6dof": 6, "m3t_desk": 1}
"""The sets of captures and how many of each are used; of m3t_desk only frame 200, whose truth is known."""


@dataclass(frozen=True)
class RealCapture:
    """One picture: its own ``name``, the set it is from, the folder of that set, and its entry in ``capture.json``."""

    name: str
    collection: str
    folder: Path
    entry: dict[str, Any]


def real_captures(data: Path) -> list[RealCapture]:
    """Every capture below ``data``, set by set; a FileNotFoundError where a set is absent."""
    out = []
    for collection, count in SETS.items():
        folder = data / collection
        entries = json.loads((folder / "capture.json").read_text(encoding="utf-8"))["frames"][:count]
        for entry in entries:
            stem = Path(entry["rgb"]).stem.removesuffix("-color").removeprefix("color_")
            out.append(RealCapture(f"{collection}_{stem}", collection, folder, entry))
    return out


def write_document(capture: RealCapture, folder: Path) -> Path:
    """Copy the two pictures of a capture into ``folder`` and write its ``capture.yaml``; returns the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    entry = capture.entry
    for picture in (entry["rgb"], entry["depth"]):
        shutil.copyfile(capture.folder / picture, folder / picture)
    depth: dict[str, Any] = {
        "image": entry["depth"],
        "scale": float(entry["depth_scale_to_m"]),
        "invalid": [int(v) for v in entry["depth_invalid"]],
    }
    if "depth_K" in entry:
        X_color_depth = Pose.from_matrix(np.array(entry["T_color_depth"], dtype=np.float64))
        depth["camera"] = _intrinsics(entry["depth_K"])
        depth["pose"] = {"xyz": _floats(X_color_depth.p), "quat_wxyz": _floats(X_color_depth.q)}
    frame = {"color": entry["rgb"], "depth": depth, "camera": _intrinsics(entry["K"])}
    document = {"simfoundry": "capture/1", "name": capture.name, "frames": {"view": frame}}
    (folder / "capture.yaml").write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    return folder


def _intrinsics(K: list[list[float]]) -> dict[str, float]:
    return {"fx": float(K[0][0]), "fy": float(K[1][1]), "cx": float(K[0][2]), "cy": float(K[1][2])}


def _floats(values: Any) -> list[float]:
    return [float(v) for v in values]
