"""An evaluation as one HTML page: what was run, success with intervals, grids of starts, failures, videos.

Every text is escaped. Videos are linked by their paths beside the page.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

from simfoundry.evaluate.engines import compare_engines
from simfoundry.evaluate.metrics import Rate
from simfoundry.evaluate.records import is_result
from simfoundry.evaluate.results import MANY, Cell, cell_key, cells, titles
from simfoundry.evaluate.strata import Pool, comparisons, pool_rows, pools

Record = Mapping[str, Any]

_STYLE = """
body{font:15px/1.45 system-ui,sans-serif;margin:1.6rem clamp(1rem,2.5vw,3rem);color:#1d232b;background:#fff}
h1{font-size:1.5rem;margin:0 0 .6rem}h2{font-size:1.2rem;margin-top:2.4rem}h3{font-size:1rem;margin:1.2rem 0 .4rem}
p{max-width:95ch}.top{display:flex;flex-wrap:wrap;gap:0 4rem}.top>section{min-width:0;max-width:100%}
.top p{max-width:60ch}dl{display:flex;flex-wrap:wrap;gap:.5rem 2.2rem;margin:0 0 1.2rem}dd{margin:0}
dt,td small,.dim{color:#5b6672;font-weight:400}dt{font-size:.8rem}.bad{color:#c3453a}
table{border-collapse:collapse}th,td{padding:.35rem .9rem .35rem 0;border-bottom:1px solid #dfe3e8;text-align:left}
td{font-variant-numeric:tabular-nums;white-space:nowrap;vertical-align:top}td.text{white-space:normal;min-width:24ch}
.wide{overflow-x:auto}.step{padding-left:1.2rem;font-weight:400}svg text{font:9px system-ui,sans-serif}
svg .axis{fill:#5b6672}.both{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,560px),1fr));gap:0 3rem}
.both>section{min-width:0}.grids{display:flex;flex-wrap:wrap;gap:1.2rem}figure{margin:0}
figcaption{font-size:.85rem;color:#5b6672}summary{cursor:pointer;margin:.6rem 0}
.videos{display:grid;grid-template-columns:repeat(auto-fill,minmax(260px,1fr));gap:.8rem}
video{width:100%;border-radius:6px;background:#000;border:3px solid #c3453a;box-sizing:border-box}
video.ok{border-color:#2a8a55}
@media(prefers-color-scheme:dark){body{background:#14181d;color:#e4e8ec}th,td{border-color:#303841}
.dim,dt,td small,figcaption{color:#9aa4af}svg .axis{fill:#9aa4af}}
"""
GOOD, BAD, UNKNOWN = "#2a8a55", "#c3453a", "#9aa4af"

SIDE = 24
"""Pixels of a cell of a grid along each side: room for a number of three digits."""


def page(records: Sequence[Record], title: str = "Evaluation") -> str:
    """The whole page."""
    found = cells(records)
    by_cell: dict[tuple[str, ...], list[Record]] = {}
    for record in records:
        by_cell.setdefault(cell_key(record), []).append(record)
    named = titles(found)
    parts = [
        "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>",
        "<meta name='viewport' content='width=device-width,initial-scale=1'>",
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>",
        f"<h1>{escape(title)}</h1>{_facts(records)}",
        "<p>In brackets: Wilson's 95 % interval of the rate. A step counts once its goal has held, in whatever order. "
        "A rollout whose policy gave an invalid answer has failed; a missing one has no result and is in no rate.</p>",
        f"<div class='top'>{_pooled(records)}<section><h2>Each task</h2>{_summary(named)}</section>",
        f"{_engines(records)}</div>",
    ]
    for name, here in named.items():
        each = "".join(_details(cell, by_cell[cell.key]) for cell in here.values())
        about = _task(next(iter(by_cell[next(iter(here.values())).key])))
        body = f"{about}<div class='both'>{each}</div>"
        if len(named) > MANY:
            parts.append(f"<details><summary><b>{escape(name)}</b> {_line(here)}</summary>{body}</details>")
        else:
            parts.append(f"<h2>{escape(name)}</h2>{body}")
    return "\n".join([*filter(None, parts), "</body></html>\n"])


def _facts(records: Sequence[Record]) -> str:
    """Versions, engines, robots, seeds and counts: under which conditions all this was found."""
    results = [r for r in records if is_result(r)]
    robots = sorted({f"{name}: {kind}" for r in records for name, kind in r["robots"].items()})
    recipes = sorted({r["cousin"]["recipe"] for r in records if r.get("cousin")})
    facts = {
        "SimFoundry": _listed(r["version"] for r in records),
        "engine": _listed(f"{r['engine']} {r['engine_version']}" for r in records),
        "robot": ", ".join(robots),
        "seed": _listed(str(r["seed"]) for r in records),
        "tasks": str(len({(r["task"], r["part"], r["step"]) for r in records})),
        "policies": _listed(r["policy"] for r in records),
        "rollouts": f"{len(results)}",
        "control": _listed(f"{r['control_hz']:g} Hz" for r in records),
        "cousins of": ", ".join(recipes),
    }
    rows = (f"<div><dt>{escape(k)}</dt><dd>{escape(v)}</dd></div>" for k, v in facts.items() if v)
    return f"<dl>{''.join(rows)}</dl>"


def _listed(words: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(words))


def _summary(named: Mapping[str, Mapping[str, Cell]]) -> str:
    policies = list(dict.fromkeys(policy for here in named.values() for policy in here))
    rows = ["<tr><th>task</th>" + "".join(f"<th>{escape(p)}</th>" for p in policies) + "</tr>"]
    for name, here in named.items():
        rows.append(_row(f"<th>{escape(name)}</th>", [_cell_rate(here.get(p)) for p in policies]))
        for step in () if len(named) > MANY else dict.fromkeys(s for cell in here.values() for s in cell.subtasks):
            each = [_rate(here[p].subtasks.get(step) if p in here else None) for p in policies]
            rows.append(_row(f"<th class='step'>{escape(step)}</th>", each))
    return f"<div class='wide'><table>{''.join(rows)}</table></div>"


def _pooled(records: Sequence[Record]) -> str:
    """All tasks together, and pairs of policies from the same starts; empty where there is neither."""
    found, pairs = pools(records), comparisons(records)
    parts = []
    if found:
        parts.append(f"<section><h2>All tasks together</h2>{_pools(found)}</section>")
    if pairs:
        rows = [_heads("policies", "engine", "same starts", "only the first", "only the second", "p", "sub-tasks", "p")]
        for one in pairs:
            counts = [one.engine, str(one.pairs), str(one.first_only), str(one.second_only), f"{one.p_holm:.3g}"]
            more = "" if one.progress is None else f"{one.progress:+.0%}"
            p = "" if one.p_progress is None else f"{one.p_progress:.3g}"
            rows.append(_row(f"<th>{escape(one.first)} and {escape(one.second)}</th>", map(escape, [*counts, more, p])))
        parts.append(
            f"<section><h2>Policies from the same starts</h2><div class='wide'><table>{''.join(rows)}</table></div>"
            "<p class='dim'>First p: exact McNemar test of success, corrected for the number of comparisons (Holm). "
            "Second p: paired permutation test of the share of sub-tasks done, first minus second.</p></section>"
        )
    return "".join(parts)


def _engines(records: Sequence[Record]) -> str:
    """The same policy from the same starts in two engines, those that disagree first; empty where there is one."""
    found = sorted(compare_engines(records), key=lambda one: not one.disagrees)
    if not found:
        return ""
    rows = [_heads("task", "policy", "engines", "succeed", "of", "rollouts that differ", "p", "")]
    for one in found:
        told = [one.policy, f"{one.first}, {one.second}", f"{one.first_done}, {one.second_done}", str(one.pairs)]
        told += [", ".join(map(str, one.differing)) or "none", f"{one.p:.3g}"]
        mark = "<span class='bad'>the engines disagree</span>" if one.disagrees else ""
        rows.append(_row(f"<th>{escape(one.title)}</th>", [*map(escape, told), mark]))
    return (
        f"<section><h2>The same starts in two engines</h2><div class='wide'><table>{''.join(rows)}</table></div>"
        "<p class='dim'>Where engines disagree, a rate says more of the engine than of the policy. They do where the "
        "successes differ by more than 2 of 25. p: exact McNemar test.</p></section>"
    )


def _pools(found: Sequence[Pool]) -> str:
    policies = list(dict.fromkeys(pool.policy for pool in found))
    rows = [_heads("tasks", *policies)]
    for name, here in pool_rows(found).items():
        tasks = max(len(pool.counts) for pool in here.values())
        each = [_rate(here[p].rate if p in here else None) for p in policies]
        rows.append(_row(f"<th>{escape(name)} <span class='dim'>{tasks}</span></th>", each))
        if not all(pool.is_balanced for pool in here.values()):
            alike = [escape(here[p].stratified_text) if p in here else "–" for p in policies]
            rows.append(_row("<th class='step'>each task weighs the same</th>", alike))
        for step in dict.fromkeys(s for pool in here.values() for s in pool.subtasks):
            each = [_rate(here[p].subtasks.get(step) if p in here else None) for p in policies]
            rows.append(_row(f"<th class='step'>{escape(step)}</th>", each))
    return f"<div class='wide'><table>{''.join(rows)}</table></div>"


def _heads(*words: str) -> str:
    return f"<tr>{''.join(f'<th>{escape(word)}</th>' for word in words)}</tr>"


def _row(head: str, each: Iterable[str]) -> str:
    return f"<tr>{head}{''.join(f'<td>{text}</td>' for text in each)}</tr>"


def _cell_rate(cell: Cell | None) -> str:
    if cell is None:
        return "–"
    rate = _rate(cell.success) if cell.success.of else "no result"
    return rate + (f"<br><small class='bad'>{escape(cell.exceptions)}</small>" if cell.exceptions else "")


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


def _line(here: Mapping[str, Cell]) -> str:
    return escape("; ".join(f"{policy} {cell.success.done}/{cell.success.of}" for policy, cell in here.items()))


def _task(record: Record) -> str:
    """What the task asks for, and how long it may take."""
    seconds = record["horizon"] / record["control_hz"]
    return (
        f"<p>“{escape(record['instruction'])}” <span class='dim'>within {record['horizon']} control steps "
        f"({seconds:.0f} s)</span></p>"
    )


def _details(cell: Cell, records: Sequence[Record]) -> str:
    ends = ", ".join(f"{count} {end}" for end, count in cell.ends.items())
    missing = f", {cell.missing} missing" if cell.missing else ""
    names = list(dict.fromkeys(name for record in records for name in record["cells"]))
    grids = "".join(_grid(name, records) for name in names)
    videos = "".join(_video(record) for record in records if record.get("video"))
    return (
        f"<section><h3>{escape(cell.policy)} <span class='dim'>{escape(ends + missing)}</span></h3>"
        + (f"<div class='grids'>{grids}</div>" if grids else "")
        + _failures([record for record in records if not record["success"]])
        + (f"<details open><summary>videos</summary><div class='videos'>{videos}</div></details>" if videos else "")
        + "</section>"
    )


def _grid(name: str, records: Sequence[Record]) -> str:
    """The cells of an object's region, x up and y to the left as the arm sees them; each with its rollout."""
    here = [record for record in records if name in record["cells"]]
    rows, columns = (max(record["grid"][k] for record in here) for k in (0, 1))
    region = here[0]["regions"][name]
    left, top, wide, high = 46, 14, columns * SIDE, rows * SIDE
    shapes = [
        f"<rect x='{left + SIDE * k}' y='{top + SIDE * i}' width='{SIDE - 1}' height='{SIDE - 1}' rx='3' "
        "fill='#9aa4af33'/>"
        for i in range(rows)
        for k in range(columns)
    ]
    for record in here:
        row, column = record["cells"][name]
        x, y = left + (columns - 1 - column) * SIDE, top + (rows - 1 - row) * SIDE
        color = (GOOD if record["success"] else BAD) if is_result(record) else UNKNOWN
        told = f"rollout {record['index']}: {_why(record)}"
        shapes.append(
            f"<g><title>{escape(told)}</title><rect x='{x}' y='{y}' "
            f"width='{SIDE - 1}' height='{SIDE - 1}' rx='3' fill='{color}'/>"
            f"<text x='{x + SIDE / 2 - 0.5}' y='{y + 15}' text-anchor='middle' fill='#fff'>{record['index']}</text></g>"
        )
    (x_low, x_high), (y_low, y_high) = region["x"], region["y"]
    axes = [
        (left - 4, top + 8, "end", f"{x_high:.2f}"),
        (left - 4, top + high - 2, "end", f"{x_low:.2f}"),
        (left - 4, top + high / 2 + 3, "end", "x [m]"),
        (left, top + high + 11, "start", f"{y_high:.2f}"),
        (left + wide, top + high + 11, "end", f"{y_low:.2f}"),
        (left + wide / 2, top + high + 11, "middle", "y [m]"),
    ]
    shapes += [f"<text class='axis' x='{x}' y='{y}' text-anchor='{a}'>{escape(t)}</text>" for x, y, a, t in axes]
    size = f"width='{left + wide + 4}' height='{top + high + 16}'"
    shown = f"where {name} starts, by rollout"
    return f"<figure><figcaption>{escape(shown)}</figcaption><svg {size} role='img'>{''.join(shapes)}</svg></figure>"


def _failures(records: Sequence[Record]) -> str:
    """Each rollout that did not succeed: how it ended, how far it came, and what its goal lacked at the end."""
    if not records:
        return ""
    rows = [_heads("rollout", "end", "steps", "done before", "why")]
    for record in records:
        done = [f"{name} ({step})" for name, step in record["subtasks"].items() if step is not None]
        words = [record["end"], str(record["steps"]), ", ".join(done) or "nothing"]
        cells_ = [*(f"<td>{escape(word)}</td>" for word in words), f"<td class='text'>{escape(_why(record))}</td>"]
        rows.append(f"<tr><td>{record['index']}</td>{''.join(cells_)}</tr>")
    return (
        f"<details open><summary>{len(records)} not successful</summary><div class='wide'><table>{''.join(rows)}"
        "</table></div></details>"
    )


def _why(record: Record) -> str:
    """Why a rollout ended as it did, with what its goal lacked in the last state."""
    if record["success"]:
        return f"success after {record['steps']} steps"
    said = [record["reason"] or record["end"]]
    if record.get("unmet") and is_result(record):
        said.append(f"at the end: {record['unmet']}")
    return "; ".join(said)


def _video(record: Record) -> str:
    mark = " class='ok'" if record["success"] else ""
    told = f"{record['index']}: {record['end']} after {record['steps']} steps"
    return (
        f"<figure><video{mark} src='{escape(record['video'], quote=True)}' controls muted preload='metadata'></video>"
        f"<figcaption>{escape(told)}</figcaption></figure>"
    )
