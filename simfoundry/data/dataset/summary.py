"""A summary of a dataset as plain data."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

from simfoundry.data.dataset.formats import StoredDataset
from simfoundry.data.dataset.manifest import read_manifest
from simfoundry.data.dataset.reading import open_dataset, recognized_format


def summary(folder: Path) -> dict[str, Any]:
    """Return the counts, features, splits, sources, notes and statistics of a dataset.

    Raises:
        SimfoundryError: If the folder does not contain a dataset.
    """
    _, stored = open_dataset(folder)
    info, manifest = stored.info, read_manifest(folder)
    headers = [stored.header(k) for k in range(len(stored))]
    frames = sum(header.length for header in headers)
    return {
        "folder": str(folder),
        "format": recognized_format(folder),
        "name": info.name,
        "profile": info.profile,
        "license": info.license,
        "robot": info.robot_type,
        "action_space": info.action_space,
        "fps": info.fps,
        "episodes": len(headers),
        "frames": frames,
        "seconds": round(frames / info.fps, 3),
        "successes": sum(header.success for header in headers),
        "splits": {name: end - first for name, (first, end) in info.splits.items()},
        "instructions": dict(Counter(header.instruction for header in headers).most_common()),
        "sources": _sources(stored),
        "features": {
            feature.name: {
                "role": str(feature.role),
                "kind": str(feature.kind),
                "dtype": feature.dtype,
                "shape": list(feature.shape),
                "names": list(feature.names) if not feature.is_image else [],
                "unit": feature.unit,
                "camera": feature.camera,
            }
            for feature in info.features
        },
        "statistics": {name: found.to_json() for name, found in stored.statistics.items()},
        "notes": list(manifest.notes) if manifest is not None else [],
    }


def _sources(stored: StoredDataset) -> dict[str, dict[str, Any]]:
    """Return the episodes and frames of each source, and the share of all frames drawn that it has."""
    found: dict[str, dict[str, Any]] = {}
    for k in range(len(stored)):
        header = stored.header(k)
        name = str(header.source.get("source", "unknown"))
        entry = found.setdefault(name, {"episodes": 0, "frames": 0, "share": 0.0})
        entry["episodes"] += 1
        entry["frames"] += header.length
        entry["share"] += header.weight * header.length
    total = sum(entry["share"] for entry in found.values())
    for entry in found.values():
        entry["share"] = round(entry["share"] / total, 6) if total else 0.0
    return found
