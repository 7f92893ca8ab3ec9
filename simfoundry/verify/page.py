"""The results as one HTML page that needs nothing else: tables, bars, pictures. Every text is escaped."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape

from simfoundry.runtime.outputs import MARK
from simfoundry.verify.behaviours import Behaviour
from simfoundry.verify.engines import InstalledEngine
from simfoundry.verify.rest import RestResult
from simfoundry.verify.run import BehaviourResult, ProofStatus, ReadbackResult
from simfoundry.verify.tables import (
    ABSENT,
    difference_line,
    known_lines,
    measured_cell,
    reading_cell,
    rested_cell,
    stale_lines,
)

_STYLE = """
body{font:15px/1.45 system-ui,sans-serif;margin:2rem auto;max-width:1200px;padding:0 1rem;color:#1d232b;background:#fff}
h1{font-size:1.5rem}h2{font-size:1.15rem;margin-top:2rem}p{max-width:70ch}
table{border-collapse:collapse;width:100%}th,td{padding:.35rem .6rem;border-bottom:1px solid #dfe3e8;text-align:left}
td{font-variant-numeric:tabular-nums}th small,td small{color:#5b6672;font-weight:400;display:block}
.wide{overflow-x:auto}.ok{color:#176b3a}.known{color:#7a5a00}.mismatch,.failed{color:#b3261e;font-weight:600}
.absent{color:#7b8591}details{margin:.4rem 0}summary{cursor:pointer}li{margin:.15rem 0;overflow-wrap:anywhere}
.pictures{display:grid;grid-template-columns:repeat(auto-fill,minmax(240px,1fr));gap:1rem}
figure{margin:0}img{width:100%;border-radius:6px;background:#eef1f4}figcaption{font-size:.9rem;color:#5b6672}
svg{display:block;width:150px;height:14px;margin-top:2px}
@media(prefers-color-scheme:dark){body{background:#14181d;color:#e4e8ec}th,td{border-color:#303841}
.ok{color:#6fd497}.known{color:#e3bd5b}.mismatch,.failed{color:#ff8a80}img{background:#20262d}}
"""

_LEGEND = {
    ProofStatus.OK: "ok",
    ProofStatus.KNOWN: "not kept, and said so",
    ProofStatus.MISMATCH: "differs",
    ProofStatus.FAILED: "failed",
}


def page(
    readings: Sequence[ReadbackResult],
    results: Sequence[BehaviourResult],
    behaviours: Sequence[Behaviour],
    engines: Mapping[str, InstalledEngine | None],
    pictures: Mapping[str, bytes],
    rested: Sequence[RestResult] = (),
) -> str:
    """The whole page; ``pictures`` are PNGs by the name of the subject."""
    parts = [
        "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>",
        f"<meta name='generator' content='{MARK}'>",
        "<meta name='viewport' content='width=device-width,initial-scale=1'>",
        f"<title>simfoundry verify</title><style>{_STYLE}</style></head><body>",
        "<h1>What each simulator holds, and how it behaves</h1>",
        f"<p>{escape(summary(readings, results, rested))}</p>",
        _readings(readings, engines) if readings else "",
        _differences(readings),
        _behaviours(results, behaviours, engines) if results else "",
        _rested(rested, engines) if rested else "",
        _list("What an engine does not keep", known_lines(readings, results)),
        _list("Losses that are reported but not seen", stale_lines(readings)),
        _pictures(pictures),
        "</body></html>\n",
    ]
    return "\n".join(part for part in parts if part)


def summary(
    readings: Sequence[ReadbackResult], results: Sequence[BehaviourResult], rested: Sequence[RestResult] = ()
) -> str:
    """One sentence: how much was compared, how much is wrong."""
    compared = sum(r.comparison.compared for r in readings if r.comparison)
    wrong = sum(len(r.comparison.mismatches) for r in readings if r.comparison)
    lost = sum(len(r.comparison.covered) for r in readings if r.comparison)
    outcomes: list[ReadbackResult | BehaviourResult | RestResult] = [*readings, *results, *rested]
    failed = sum(o.verdict is ProofStatus.FAILED for o in outcomes)
    off = sum(m.verdict is ProofStatus.MISMATCH for m in results)
    text = f"{compared} quantities compared, {wrong} differ, {lost} are lost as reported"
    if results:
        text += f"; {len(results)} behaviours measured, {off} are off without a reason"
    if rested:
        apart = sum(r.verdict is ProofStatus.MISMATCH for r in rested)
        text += f"; {len(rested)} scenes left alone, {apart} end elsewhere than in other engines"
    return text + (f"; {failed} failed" if failed else "") + "."


def _readings(readings: Sequence[ReadbackResult], engines: Mapping[str, InstalledEngine | None]) -> str:
    by_cell = {(r.subject, r.engine): r for r in readings}
    rows = []
    for subject in dict.fromkeys(r.subject for r in readings):
        cells = "".join(_reading_cell(by_cell.get((subject, engine))) for engine in engines)
        rows.append(f"<tr><th>{escape(subject)}</th>{cells}</tr>")
    return f"<h2>Read back</h2><div class='wide'><table>{_head('', engines)}{''.join(rows)}</table></div>"


def _head(first: str, engines: Mapping[str, InstalledEngine | None]) -> str:
    cells = "".join(f"<th>{escape(name)}<small>{_about(found)}</small></th>" for name, found in engines.items())
    return f"<tr><th>{escape(first)}</th>{cells}</tr>"


def _about(found: InstalledEngine | None) -> str:
    return ABSENT if found is None else f"{escape(found.version)}, {escape(found.engine.spec.note)}"


def _reading_cell(reading: ReadbackResult | None) -> str:
    if reading is None:
        return f"<td class='absent'>{ABSENT}</td>"
    compared = f"<small>{reading.comparison.compared} compared</small>" if reading.comparison else ""
    title = escape(_LEGEND[reading.verdict])
    return f"<td class='{reading.verdict}' title='{title}'>{escape(reading_cell(reading))}{compared}</td>"


def _differences(readings: Sequence[ReadbackResult]) -> str:
    parts = []
    for reading in readings:
        where = escape(f"{reading.subject} in {reading.engine}")
        if reading.comparison is None:
            parts.append(f"<p class='failed'>{where}: {escape(reading.error)}</p>")
        elif reading.comparison.mismatches:
            items = "".join(f"<li>{escape(difference_line(d))}</li>" for d in reading.comparison.mismatches)
            parts.append(f"<details open><summary class='mismatch'>{where}</summary><ul>{items}</ul></details>")
    return "\n".join(parts)


def _behaviours(
    results: Sequence[BehaviourResult], behaviours: Sequence[Behaviour], engines: Mapping[str, InstalledEngine | None]
) -> str:
    stepping = {name: found for name, found in engines.items() if found is None or found.engine.spec.steps}
    by_cell = {(m.behaviour, m.engine): m for m in results}
    rows = []
    for b in behaviours:
        answer = escape(f"{b.expected:.4g} ± {b.tolerance:.2g} {b.unit}".rstrip())
        cells = "".join(_measured_cell(b, by_cell.get((b.name, engine))) for engine in stepping)
        rows.append(f"<tr><th>{escape(b.title)}<small>{answer}: {escape(b.reason)}</small></th>{cells}</tr>")
    return (
        "<h2>Behaviours</h2><p>The band is the tolerance about the known answer, the mark what was measured; a mark "
        "at an end lies further out.</p>"
        f"<div class='wide'><table>{_head('', stepping)}{''.join(rows)}</table></div>"
    )


def _rested(rested: Sequence[RestResult], engines: Mapping[str, InstalledEngine | None]) -> str:
    by_cell = {(r.subject, r.engine): r for r in rested}
    stepping = {name: found for name, found in engines.items() if any(r.engine == name for r in rested)}
    rows = []
    for subject in dict.fromkeys(r.subject for r in rested):
        cells = "".join(_rested_cell(by_cell.get((subject, engine))) for engine in stepping)
        rows.append(f"<tr><th>{escape(subject)}</th>{cells}</tr>")
    table = f"<div class='wide'><table>{_head('', stepping)}{''.join(rows)}</table></div>"
    return f"<h2>Left alone for 2 s</h2><p>How far the worst thing ends from where other engines leave it.</p>{table}"


def _rested_cell(rested: RestResult | None) -> str:
    if rested is None:
        return "<td></td>"
    note = escape(rested.error or rested.worst)
    return f"<td class='{rested.verdict}'>{escape(rested_cell(rested))}<small>{note}</small></td>"


def _measured_cell(behaviour: Behaviour, measured: BehaviourResult | None) -> str:
    if measured is None:
        return f"<td class='absent'>{ABSENT}</td>"
    reason = f"<small>{escape(measured.reason or measured.error)}</small>" if measured.reason or measured.error else ""
    bar = "" if measured.value is None else _bar(behaviour, measured.value)
    return f"<td class='{measured.verdict}'>{escape(measured_cell(measured))}{bar}{reason}</td>"


def _bar(behaviour: Behaviour, value: float) -> str:
    """The tolerance fills the middle half; the mark is clamped to the ends."""
    off = (value - behaviour.expected) / behaviour.tolerance
    x = 75 + 37.5 * max(-2.0, min(2.0, off))
    return (
        "<svg viewBox='0 0 150 14' role='img' aria-hidden='true'>"
        "<rect y='6' width='150' height='2' fill='currentColor' opacity='.25'/>"
        "<rect x='37.5' y='3' width='75' height='8' fill='#2e9e5b' opacity='.3'/>"
        f"<rect x='{min(147.0, max(0.0, x - 1.5)):.1f}' width='3' height='14' fill='currentColor'/></svg>"
    )


def _list(title: str, lines: Sequence[str]) -> str:
    if not lines:
        return ""
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f"<h2>{escape(title)}</h2><details><summary>{len(lines)}</summary><ul>{items}</ul></details>"


def _pictures(pictures: Mapping[str, bytes]) -> str:
    if not pictures:
        return ""
    figures = "".join(
        f"<figure><img alt='{escape(name, quote=True)}' src='data:image/png;base64,{base64.b64encode(png).decode()}'>"
        f"<figcaption>{escape(name)}</figcaption></figure>"
        for name, png in pictures.items()
    )
    return f"<h2>Scenes</h2><div class='pictures'>{figures}</div>"
