"""The report of a training: success rates, loss curves, videos, and what was run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from simfoundry.evaluate.statistics.metrics import Rate
from simfoundry.evaluate.statistics.records import is_result
from simfoundry.reports.correlation import COLORS
from simfoundry.reports.render import render

# Size of the loss plot, and margin for its axes [px].
WIDTH, HEIGHT, MARGIN = 560, 240, 40

# Maximum number of videos of each policy on the page; the evaluation's own page shows all of them.
MOST_VIDEOS = 12


def training_page(report: Mapping[str, Any], records: Sequence[Mapping[str, Any]]) -> str:
    """Render the page.

    Args:
        report: The content of ``report.json``.
        records: The records of the evaluation.
    """
    policies = [_policy(label, facts, records) for label, facts in report["policies"].items()]
    first = next(iter(report["policies"].values()))
    versions = ", ".join(f"{name} {number}" for name, number in first["versions"].items())
    facts = {
        "tasks": ", ".join(first["tasks"][:5]) + ("…" if len(first["tasks"]) > 5 else ""),
        "learned from": ", ".join(report["sources"]),
        "demonstrations": str(first["demonstrations"]),
        "augmentation": _augmentation(report.get("augmentation")),
        "evaluated tasks": str(len({record["task"] for record in records})),
        "seen initial states": f"{report['seen_starts']} of {len(records)}",
        "versions": versions,
    }
    return render(
        "training.html.j2",
        title="Training",
        sources="'self'",
        facts=facts,
        policies=policies,
        curves=loss_curves({label: one["losses"] for label, one in report["policies"].items()}),
        evaluation=report["evaluation"],
    )


def _augmentation(made: Mapping[str, Any] | None) -> str:
    """Return how many demonstrations were generated, and from how many, or an empty string."""
    if made is None:
        return ""
    rate = Rate(made["success"]["successes"], made["success"]["attempts"])
    return f"generated from {len(made['sources'])} demonstrations, success {rate}"


def _policy(label: str, facts: Mapping[str, Any], records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    own = [record for record in records if record["policy"] == label]
    done = [record["success"] for record in own if is_result(record)]
    steps = dict.fromkeys(name for record in own for name in record["subtasks"])
    reached = {
        name: Rate(sum(r["subtasks"].get(name) is not None for r in own if is_result(r)), len(done)) for name in steps
    }
    videos = [record for record in own if record.get("video")][:MOST_VIDEOS]
    return {"label": label, "facts": facts, "rate": Rate(sum(done), len(done)), "steps": reached, "videos": videos}


def loss_curves(losses: Mapping[str, Sequence[Mapping[str, Any]]]) -> dict[str, Any]:
    """Return the loss curves as points of an SVG.

    The vertical axis is logarithmic, because losses fall by an order of magnitude.
    """
    known = [
        value
        for points in losses.values()
        for point in points
        for value in (point["train"], point["validation"])
        if value is not None and value > 0 and math.isfinite(value)
    ]
    low, high = (min(known), max(known)) if known else (0.1, 1.0)
    low, high = math.log10(low), max(math.log10(high), math.log10(low) + 0.1)
    most = max((point["step"] for points in losses.values() for point in points), default=1)

    def at(step: int, value: float) -> str:
        x = MARGIN + (WIDTH - 2 * MARGIN) * step / most
        y = HEIGHT - MARGIN - (HEIGHT - 2 * MARGIN) * (math.log10(value) - low) / (high - low)
        return f"{x:.1f},{y:.1f}"

    lines = []
    for k, (label, points) in enumerate(losses.items()):
        for kind in ("train", "validation"):
            there = [(p["step"], p[kind]) for p in points if p[kind] is not None and p[kind] > 0]
            if there:
                line = {"label": f"{label}, {kind}", "color": COLORS[k % len(COLORS)], "dashed": kind == "validation"}
                lines.append({**line, "points": " ".join(at(*point) for point in there)})
    axis = {"low": f"{10**low:.3g}", "high": f"{10**high:.3g}", "steps": str(most)}
    return {"width": WIDTH, "height": HEIGHT, "margin": MARGIN, "lines": lines, **axis}
