"""An evaluation as one HTML page: success with intervals, steps, the grid of starts, videos. Every text is escaped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from simfoundry.evaluate.metrics import Rate
from simfoundry.evaluate.results import Cell, cell_key, cells, titles

_STYLE = """
body{font:15px/1.45 system-ui,sans-serif;margin:2rem auto;max-width:1200px;padding:0 1rem;color:#1d232b;background:#fff}
h1{font-size:1.5rem}h2{font-size:1.2rem;margin-top:2.4rem}h3{font-size:1rem;margin:1.4rem 0 .4rem}p{max-width:75ch}
table{border-collapse:collapse}th,td{padding:.35rem .8rem .35rem 0;border-bottom:1px solid #dfe3e8;text-align:left}
td{font-variant-numeric:tabular-nums;white-space:nowrap}td small,.dim{color:#5b6672;font-weight:400}
.wide{overflow-x:auto}.step{padding-left:1.2rem;font-weight:400}svg text{font:9px system-ui,sans-serif}
.grids{display:flex;flex-wrap:wrap;gap:1.2rem}figure{margin:0}figcaption{font-size:.85rem;color:#5b6672}
.videos{display:grid;grid-template-columns:repeat(auto-fill,minmax(210px,1fr));gap:.8rem}
video{width:100%;border-radius:6px;background:#000;border:3px solid #c3453a}video.ok{border-color:#2a8a55}
@media(prefers-color-scheme:dark){body{background:#14181d;color:#e4e8ec}th,td{border-color:#303841}}
"""
GOOD, BAD = "#2a8a55", "#c3453a"


def page(records: Sequence[Mapping[str, Any]], title: str = "Evaluation") -> str:
    """The whole page; videos are linked by their paths beside it."""
    found = cells(records)
    parts = [
        "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>",
        "<meta name='viewport' content='width=device-width,initial-scale=1'>",
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>",
        f"<h1>{escape(title)}</h1><p>{len(records)} rollouts. In brackets: Wilson's 95 % interval of the rate. A step "
        "counts once its goal has held, in whatever order.</p>",
        _summary(found),
    ]
    by_cell: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    for record in records:
        by_cell.setdefault(cell_key(record), []).append(record)
    for name, here in titles(found).items():
        parts.append(f"<h2>{escape(name)}</h2>")
        parts += [_details(cell, by_cell[cell.key]) for cell in here.values()]
    return "\n".join([*parts, "</body></html>\n"])


def _summary(found: Sequence[Cell]) -> str:
    policies = list(dict.fromkeys(cell.policy for cell in found))
    rows = ["<tr><th>task</th>" + "".join(f"<th>{escape(p)}</th>" for p in policies) + "</tr>"]
    for name, by_policy in titles(found).items():
        rows.append(
            _row(
                f"<th>{escape(name)}</th>", [_rate(by_policy[p].success if p in by_policy else None) for p in policies]
            )
        )
        for step in dict.fromkeys(s for cell in by_policy.values() for s in cell.subtasks):
            each = [_rate(by_policy[p].subtasks.get(step) if p in by_policy else None) for p in policies]
            rows.append(_row(f"<th class='step'>{escape(step)}</th>", each))
    return f"<div class='wide'><table>{''.join(rows)}</table></div>"


def _row(head: str, each: Sequence[str]) -> str:
    return f"<tr>{head}{''.join(f'<td>{text}</td>' for text in each)}</tr>"


def _rate(rate: Rate | None) -> str:
    if rate is None:
        return "–"
    low, high = rate.interval
    x0, x1, x = (5 + 90 * share for share in (low, high, rate.share))
    bar = (
        "<svg width='100' height='10' aria-hidden='true'>"
        "<rect x='5' y='4' width='90' height='2' fill='#9aa4af' opacity='.4'/>"
        f"<rect x='{x0:.1f}' y='3' width='{x1 - x0:.1f}' height='4' fill='#2f6fde' opacity='.35'/>"
        f"<circle cx='{x:.1f}' cy='5' r='4' fill='#2f6fde'/></svg>"
    )
    return f"{bar} {rate.done}/{rate.of} <small>{rate.share:.0%} ({low:.0%} to {high:.0%})</small>"


def _details(cell: Cell, records: Sequence[Mapping[str, Any]]) -> str:
    ends = ", ".join(f"{count} {end}" for end, count in cell.ends.items())
    names = list(dict.fromkeys(name for record in records for name in record["cells"]))
    grids = "".join(_grid(name, records) for name in names)
    videos = "".join(_video(record) for record in records if record.get("video"))
    return (
        f"<h3>{escape(cell.policy)} <span class='dim'>{escape(ends)}</span></h3>"
        + (f"<div class='grids'>{grids}</div>" if grids else "")
        + (f"<details><summary>videos</summary><div class='videos'>{videos}</div></details>" if videos else "")
    )


def _grid(name: str, records: Sequence[Mapping[str, Any]]) -> str:
    """The cells of an object's region, x up and y to the left as the arm sees them; each with its rollout."""
    here = [record for record in records if name in record["cells"]]
    rows, columns = (max(record["grid"][k] for record in here) for k in (0, 1))
    side = 20
    shapes = [
        f"<rect x='{side * k}' y='{side * i}' width='{side - 1}' height='{side - 1}' rx='3' fill='#9aa4af33'/>"
        for i in range(rows)
        for k in range(columns)
    ]
    for record in here:
        row, column = record["cells"][name]
        x, y = (columns - 1 - column) * side, (rows - 1 - row) * side
        told = f"rollout {record['index']}: {record['end']}" + (f", {record['reason']}" if record["reason"] else "")
        shapes.append(
            f"<g><title>{escape(told)}</title><rect x='{x}' y='{y}' width='{side - 1}' height='{side - 1}' rx='3' "
            f"fill='{GOOD if record['success'] else BAD}'/><text x='{x + side / 2 - 0.5}' y='{y + 13}' "
            f"text-anchor='middle' fill='#fff'>{record['index']}</text></g>"
        )
    size = f"width='{columns * side}' height='{rows * side}'"
    return f"<figure><svg {size} role='img'>{''.join(shapes)}</svg><figcaption>{escape(name)}</figcaption></figure>"


def _video(record: Mapping[str, Any]) -> str:
    mark = " class='ok'" if record["success"] else ""
    told = f"{record['index']}: {record['end']} after {record['steps']} steps"
    return (
        f"<figure><video{mark} src='{escape(record['video'], quote=True)}' controls muted preload='none'></video>"
        f"<figcaption>{escape(told)}</figcaption></figure>"
    )
