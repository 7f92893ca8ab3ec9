"""The file ``simfoundry.json`` in each dataset, which describes what formats cannot express completely."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from simfoundry.data.dataset.episode import EpisodeHeader
from simfoundry.data.dataset.features import DatasetInfo
from simfoundry.data.dataset.statistics import FeatureStatistics
from simfoundry.errors import OutputError
from simfoundry.runtime.files import write_file

# The name of the file, and the kind and version in it.
MANIFEST, VERSION = "simfoundry.json", "dataset-manifest/1"

# Maximum size of a manifest to read [bytes]; an episode takes about 400 bytes.
MAX_BYTES = 2**29


@dataclass(frozen=True, eq=False)
class DatasetManifest:
    """The description of a dataset and of its episodes.

    Attributes:
        format: The name of the file format.
        plan: The digest of the plan from which the dataset was built; equal plans give equal bytes.
        info: The description of the dataset.
        headers: The descriptions of the episodes, in order.
        statistics: The statistics of each feature in the entire dataset.
        notes: Differences from the demonstrations, as whole sentences: converted actions, and losses of the format.
    """

    format: str
    plan: str
    info: DatasetInfo
    headers: Sequence[EpisodeHeader]
    statistics: Mapping[str, FeatureStatistics]
    notes: Sequence[str] = ()


def write_manifest(folder: Path, manifest: DatasetManifest) -> None:
    """Write the manifest of a dataset. Equal manifests give equal bytes."""
    data = {
        "simfoundry": VERSION,
        "format": manifest.format,
        "plan": manifest.plan,
        "notes": list(manifest.notes),
        "info": manifest.info.to_json(),
        "statistics": {name: found.to_json() for name, found in manifest.statistics.items()},
        "episodes": [asdict(header) for header in manifest.headers],
    }
    write_file(folder / MANIFEST, (json.dumps(data, indent=1, ensure_ascii=False) + "\n").encode())


def read_manifest(folder: Path) -> DatasetManifest | None:
    """Read the manifest of a dataset, or return None if the dataset has none because SimFoundry did not write it.

    Raises:
        OutputError: If the manifest is invalid.
    """
    path = folder / MANIFEST
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ValueError(f"it exceeds {MAX_BYTES // 2**20} MiB")
        data = json.loads(path.read_text(encoding="utf-8"))
        if data["simfoundry"] != VERSION:
            raise ValueError(f"its version is {str(data['simfoundry'])[:40]}, not {VERSION}")
        return _manifest(data)
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        reason = f"{error} is missing" if isinstance(error, KeyError) else str(error)[:200]
        raise OutputError(f"{path} is not a valid manifest of a dataset: {reason}") from None


def _manifest(data: Mapping[str, Any]) -> DatasetManifest:
    headers = [_header(one) for one in data["episodes"]]
    info = DatasetInfo.from_json(data["info"])
    if len(headers) != info.episodes or [header.index for header in headers] != list(range(len(headers))):
        raise ValueError("its episodes are incomplete")
    return DatasetManifest(
        format=str(data["format"]),
        plan=str(data["plan"]),
        info=info,
        headers=headers,
        statistics={str(name): FeatureStatistics.from_json(one) for name, one in data["statistics"].items()},
        notes=tuple(map(str, data["notes"])),
    )


def _header(data: Mapping[str, Any]) -> EpisodeHeader:
    subtasks = {str(name): None if frame is None else int(frame) for name, frame in data["subtasks"].items()}
    return EpisodeHeader(
        index=int(data["index"]),
        first_frame=int(data["first_frame"]),
        length=int(data["length"]),
        instruction=str(data["instruction"]),
        task_index=int(data["task_index"]),
        split=str(data["split"]),
        weight=float(data["weight"]),
        success=bool(data["success"]),
        subtasks=subtasks,
        source=dict(data["source"]),
    )
