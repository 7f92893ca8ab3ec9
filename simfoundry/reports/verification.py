"""The page with the results of ``simfoundry verify``: tables, bars and images in a single file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TypeVar

from simfoundry.reports.render import render
from simfoundry.verify import tables
from simfoundry.verify.behaviors import Behavior
from simfoundry.verify.engines import InstalledEngine
from simfoundry.verify.run import BehaviorResult, ProofStatus, ReadbackResult, RestResult

_LEGEND = {
    ProofStatus.OK: "ok",
    ProofStatus.KNOWN: "lost as reported",
    ProofStatus.MISMATCH: "differs",
    ProofStatus.FAILED: "failed",
}


C = TypeVar("C", BehaviorResult, ReadbackResult, RestResult)


def page(
    readings: Sequence[ReadbackResult],
    results: Sequence[BehaviorResult],
    behaviors: Sequence[Behavior],
    engines: Mapping[str, InstalledEngine | None],
    pictures: Mapping[str, bytes],
    rested: Sequence[RestResult] = (),
) -> str:
    """Render the complete page. ``pictures`` contains a PNG image for each scene, by name."""
    stepping = {name: found for name, found in engines.items() if found is None or found.engine.spec.steps}
    rest_engines = {name: found for name, found in engines.items() if any(r.engine == name for r in rested)}
    measured = _rows(((m.behavior, m) for m in results), stepping)
    return render(
        "verification.html.j2",
        title="simfoundry verify",
        sources="",
        summary=summary(readings, results, rested),
        engines=engines,
        stepping=stepping,
        rest_engines=rest_engines,
        readings=_rows(((r.subject, r) for r in readings), engines),
        differing=[r for r in readings if r.comparison is None or r.comparison.mismatches],
        behaviors=[(b, measured.get(b.name, dict.fromkeys(stepping))) for b in behaviors] if results else [],
        rested=_rows(((r.subject, r) for r in rested), rest_engines),
        known=tables.known_lines(readings, results),
        stale=tables.stale_lines(readings),
        pictures=pictures,
        legend=_LEGEND,
        tables=tables,
    )


def _rows(cells: Iterable[tuple[str, C]], engines: Iterable[str]) -> dict[str, dict[str, C | None]]:
    """Group the cells into rows by name. A row contains None for each engine without a cell."""
    rows: dict[str, dict[str, C | None]] = {}
    for name, cell in cells:
        rows.setdefault(name, dict.fromkeys(engines))[cell.engine] = cell
    return rows


def summary(
    readings: Sequence[ReadbackResult], results: Sequence[BehaviorResult], rested: Sequence[RestResult] = ()
) -> str:
    """Return a one-sentence summary with the number of comparisons and errors."""
    compared = sum(r.comparison.compared for r in readings if r.comparison)
    wrong = sum(len(r.comparison.mismatches) for r in readings if r.comparison)
    lost = sum(len(r.comparison.covered) for r in readings if r.comparison)
    outcomes: list[ReadbackResult | BehaviorResult | RestResult] = [*readings, *results, *rested]
    failed = sum(o.verdict is ProofStatus.FAILED for o in outcomes)
    off = sum(m.verdict is ProofStatus.MISMATCH for m in results)
    text = f"{compared} quantities compared, {wrong} differ, {lost} are lost as reported"
    if results:
        text += f"; {len(results)} behaviors measured, {off} are off without a known reason"
    if rested:
        apart = sum(r.verdict is ProofStatus.MISMATCH for r in rested)
        text += f"; {len(rested)} scenes simulated for 2 s, {apart} end in a different state than in other engines"
    return text + (f"; {failed} failed" if failed else "") + "."
