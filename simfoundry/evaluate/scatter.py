"""Real against simulated success rates as a picture: one point for each policy and task, as the paper's figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

from simfoundry.evaluate.correlate import Agreement, mean_agreement
from simfoundry.runtime.outputs import MARK

SIDE, MARGIN, LEGEND = 440, 56, 210
COLORS = ("#2f6fde", "#e07b1a", "#2a9d63", "#b23a8f", "#6b7280")
MARKS = ("circle", "square", "triangle", "diamond", "cross", "plus", "star")


def scatter(series: Mapping[str, Sequence[Agreement]]) -> str:
    """An SVG of every series of agreements by its name; the colour tells the series, the mark the task."""
    tasks = list(dict.fromkeys(a.task for found in series.values() for a in found))
    marks = {task: MARKS[k % len(MARKS)] for k, task in enumerate(tasks)}
    colors = {name: COLORS[k % len(COLORS)] for k, name in enumerate(series)}
    width = SIDE + 2 * MARGIN + LEGEND
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {SIDE + 2 * MARGIN}" '
            f'width="{width}" font-family="system-ui,sans-serif" font-size="13">',
            f"<!-- {MARK} -->",
            '<rect width="100%" height="100%" fill="#ffffff"/>',
            *_axes(),
            *(
                _mark(marks[a.task], colors[name], x, y, f"{a.task}, {policy}: real {x:.0%}, simulated {y:.0%}")
                for name, found in series.items()
                for a in found
                for policy, x, y in zip(a.policies, a.real, a.sim, strict=True)
            ),
            *_legend(series, colors, marks),
            "</svg>\n",
        ]
    )


def _at(x: float, y: float) -> tuple[float, float]:
    return MARGIN + x * SIDE, MARGIN + (1 - y) * SIDE


def _axes() -> list[str]:
    parts = []
    for k in range(0, 101, 20):
        x, y = _at(k / 100, k / 100)
        parts += [
            f'<path d="M{x:.1f} {MARGIN}V{MARGIN + SIDE}M{MARGIN} {y:.1f}H{MARGIN + SIDE}" stroke="#e5e7eb"/>',
            f'<text x="{x:.1f}" y="{MARGIN + SIDE + 20}" text-anchor="middle" fill="#374151">{k}</text>',
            f'<text x="{MARGIN - 10}" y="{y + 4:.1f}" text-anchor="end" fill="#374151">{k}</text>',
        ]
    (x0, y0), (x1, y1), middle = _at(0, 0), _at(1, 1), MARGIN + SIDE / 2
    return [
        *parts,
        f'<path d="M{x0} {y0}L{x1} {y1}" stroke="#9ca3af" stroke-dasharray="6 5"/>',
        f'<rect x="{MARGIN}" y="{MARGIN}" width="{SIDE}" height="{SIDE}" fill="none" stroke="#374151"/>',
        f'<text x="{middle}" y="{MARGIN + SIDE + 44}" text-anchor="middle">Success on the real robot [%]</text>',
        f'<text transform="translate(16 {middle}) rotate(-90)" text-anchor="middle">Success in simulation [%]</text>',
    ]


def _legend(series: Mapping[str, Sequence[Agreement]], colors: dict[str, str], marks: dict[str, str]) -> list[str]:
    x, y, parts = MARGIN + SIDE + 22, MARGIN + 10, []
    for name, found in series.items():
        r, violation = mean_agreement(found)
        text = f"mean r {_figure(r)}, MMRV {violation:.3f}"
        parts += [
            f'<circle cx="{x}" cy="{y}" r="5" fill="{colors[name]}"/>',
            f'<text x="{x + 14}" y="{y + 4}" font-weight="600">{escape(name[:26])}</text>',
            f'<text x="{x + 14}" y="{y + 21}" fill="#374151">{text}</text>',
        ]
        y += 46
    for task, mark in marks.items():
        parts += [_shape(mark, "#374151", x, y), f'<text x="{x + 14}" y="{y + 4}">{escape(task[:28])}</text>']
        y += 22
    return parts


def _mark(mark: str, color: str, real: float, sim: float, title: str) -> str:
    x, y = _at(real, sim)
    return f"<g>{_shape(mark, color, x, y)}<title>{escape(title)}</title></g>"


def _shape(mark: str, color: str, x: float, y: float) -> str:
    paths = {
        "square": "M-5-5H5V5H-5Z",
        "triangle": "M0-6.5L6 5H-6Z",
        "diamond": "M0-7L6 0L0 7L-6 0Z",
        "cross": "M-5-5L5 5M5-5L-5 5",
        "plus": "M-6 0H6M0-6V6",
        "star": "M0-7L2-2H7L3 1.5L4.5 7L0 3.5L-4.5 7L-3 1.5L-7-2H-2Z",
    }
    if mark == "circle":
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5.5" fill="{color}" fill-opacity="0.75"/>'
    line = f'stroke="{color}" stroke-width="2.2"' if mark in ("cross", "plus") else ""
    return f'<path transform="translate({x:.1f} {y:.1f})" d="{paths[mark]}" fill="{color}" fill-opacity="0.75" {line}/>'


def _figure(value: float | None) -> str:
    return "undefined" if value is None else f"{value:.3f}"
