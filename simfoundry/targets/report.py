"""The loss report: what became of each feature in each target, as JSON and as a short table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from simfoundry.backends.artifact import Artifact
from simfoundry.backends.features import fates, feature_of
from simfoundry.scene.model import Scene

Fates = Mapping[str, Mapping[str, int]]


def report(scene: Scene, artifacts: Iterable[Artifact]) -> dict[str, Any]:
    """What ``loss.json`` holds, by target.

    ``fields``: of each feature that the scene uses, how many things keep it, have it approximated, lost it. ``losses``:
    the path, the feature, what became of it, and why, for each that is not kept.
    """
    return {
        artifact.target: {"fields": fates(scene, artifact.losses), "losses": _losses(scene, artifact)}
        for artifact in artifacts
    }


def _losses(scene: Scene, artifact: Artifact) -> list[dict[str, str]]:
    return [
        {
            "path": loss.path,
            "field": feature_of(loss, scene),
            "fidelity": loss.fidelity.value,
            "reason": loss.reason,
        }
        for loss in artifact.losses
    ]


def table(data: Mapping[str, Any]) -> list[str]:
    """The features that some target does not keep, a line each: ``~`` approximated, ``-`` dropped, for how many things.

    What every target keeps is counted in the last line.
    """
    fields: dict[str, Fates] = {target: entry["fields"] for target, entry in data.items()}
    names = list(dict.fromkeys(name for found in fields.values() for name in found))
    lossy = [name for name in names if any(set(found.get(name, ())) - {"kept"} for found in fields.values())]
    kept = len(names) - len(lossy)
    last = f"kept by all: {kept} of the {len(names)} fields in use"
    if not lossy:
        return [last]
    rows = [["not kept", *fields], *([name, *(_mark(f.get(name, {})) for f in fields.values())] for name in lossy)]
    return [*_aligned(rows), last]


def _mark(found: Mapping[str, int]) -> str:
    parts = [f"{sign}{found[fate]}" for sign, fate in (("~", "approximated"), ("-", "dropped")) if found.get(fate)]
    return " ".join(parts)


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return ["  ".join(f"{cell:<{w}}" for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]
