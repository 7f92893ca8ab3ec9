"""A scatter plot of simulated versus real success rates, with one point for each policy and task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from simfoundry.evaluate.statistics.correlation import RateAgreement, mean_agreement
from simfoundry.reports.render import render

# Side length of the plot, margin for its axes, and width of the legend [px]; readable when embedded in text.
SIDE, MARGIN, LEGEND = 440, 56, 210

COLORS = ("#2f6fde", "#e07b1a", "#2a9d63", "#b23a8f", "#6b7280")
# Markers for tasks, as SVG paths centered at the origin.
PATHS = {
    "circle": "",
    "square": "M-5-5H5V5H-5Z",
    "triangle": "M0-6.5L6 5H-6Z",
    "diamond": "M0-7L6 0L0 7L-6 0Z",
    "cross": "M-5-5L5 5M5-5L-5 5",
    "plus": "M-6 0H6M0-6V6",
    "star": "M0-7L2-2H7L3 1.5L4.5 7L0 3.5L-4.5 7L-3 1.5L-7-2H-2Z",
}


def scatter(series: Mapping[str, Sequence[RateAgreement]]) -> str:
    """Return a scatter plot of all series as SVG. Colors represent the series, and markers represent the tasks."""
    tasks = list(dict.fromkeys(a.task for found in series.values() for a in found))
    marks = {task: list(PATHS)[k % len(PATHS)] for k, task in enumerate(tasks)}
    colors = {name: COLORS[k % len(COLORS)] for k, name in enumerate(series)}
    return render(
        "correlation.svg.j2",
        side=SIDE,
        margin=MARGIN,
        legend=LEGEND,
        paths=PATHS,
        marks=marks,
        points=[
            {"task": a.task, "policy": p, "real": x, "sim": y, "mark": marks[a.task], "color": colors[name]}
            for name, found in series.items()
            for a in found
            for p, x, y in zip(a.policies, a.real, a.sim, strict=True)
        ],
        series=[{"name": n, "color": colors[n], "agreement": _agreement(found)} for n, found in series.items()],
    )


def _agreement(found: Sequence[RateAgreement]) -> str:
    r, violation = mean_agreement(found)
    return f"mean r {'undefined' if r is None else f'{r:.3f}'}, MMRV {violation:.3f}"
