"""The loss report: the fidelity of each feature in each target, as JSON and as a short table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from simfoundry.backends.artifact import Artifact
from simfoundry.backends.features import Loss, count_fates
from simfoundry.scene.model import Scene

Fates = Mapping[str, Mapping[str, int]]


def report(scene: Scene, artifacts: Iterable[Artifact]) -> dict[str, Any]:
    """Return the content of ``loss.json``, by target.

    ``features`` counts, for each feature that the scene uses, the elements that keep it, have it approximated or lose
    it. ``losses`` lists every :class:`~simfoundry.backends.features.Loss` with its fields.
    """
    return {
        artifact.target: {
            "features": count_fates(scene, artifact.losses),
            "losses": [_loss(loss) for loss in artifact.losses],
        }
        for artifact in artifacts
    }


def _loss(loss: Loss) -> dict[str, Any]:
    size = None if loss.size is None else {"value": loss.size.value, "unit": loss.size.unit}
    return {
        "path": loss.path,
        "feature": loss.feature,
        "element": loss.element,
        "fidelity": loss.fidelity.value,
        "size": size,
        "reason": loss.reason,
    }


def table(data: Mapping[str, Any]) -> list[str]:
    """Return one line per feature that some target does not keep, with the number of elements affected.

    ``~`` means approximated and ``-`` dropped. The last line counts the features that every target keeps.
    """
    fields: dict[str, Fates] = {target: entry["features"] for target, entry in data.items()}
    names = list(dict.fromkeys(name for found in fields.values() for name in found))
    lossy = [name for name in names if any(set(found.get(name, ())) - {"kept"} for found in fields.values())]
    kept = len(names) - len(lossy)
    last = f"preserved by all targets: {kept} of the {len(names)} features in use"
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
