"""Text output for verification results: tables of read-backs and behaviors by engine, and details of every failure."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from simfoundry.geometry.frames import look_at
from simfoundry.scene.model import Camera, Scene
from simfoundry.scene.object_shapes import world_bounds
from simfoundry.targets.build import aligned
from simfoundry.verify.behaviors import Behavior
from simfoundry.verify.compare import Difference
from simfoundry.verify.engines import InstalledEngine, VerifyEngine
from simfoundry.verify.run import BehaviorResult, ProofStatus, ReadbackResult, RestResult

ABSENT = "not installed"
# Maximum number of differences printed per scene and engine; the JSON output contains all of them.
SHOWN = 12


def reading_cell(reading: ReadbackResult) -> str:
    """Return ``ok``, ``ok, 3 lost``, ``2 mismatches`` or ``failed``."""
    found = reading.comparison
    if found is None:
        return "failed"
    if found.mismatches:
        return f"{len(found.mismatches)} mismatch{'es' if len(found.mismatches) > 1 else ''}"
    return f"ok, {len(found.covered)} lost" if found.covered else "ok"


def readings_table(readings: Sequence[ReadbackResult], engines: Mapping[str, InstalledEngine | None]) -> str:
    """Return a table with a row per spec and a column per engine."""
    return _table("", engines, {(r.subject, r.engine): reading_cell(r) for r in readings}, ABSENT)


def _table(corner: str, engines: Iterable[str], cells: Mapping[tuple[str, str], str], absent: str = "") -> str:
    """Return a table with a row per subject and a column per engine. ``cells`` is keyed by subject and engine."""
    names, subjects = list(engines), dict.fromkeys(subject for subject, _ in cells)
    rows = ([subject, *(cells.get((subject, name), absent) for name in names)] for subject in subjects)
    return "\n".join(aligned([[corner, *names], *rows], ">"))


def measured_cell(measured: BehaviorResult) -> str:
    """Return the measured value, followed by a star for a known deviation or ``(!)`` for an incorrect value."""
    if measured.value is None:
        return "failed"
    marks = {ProofStatus.OK: "", ProofStatus.KNOWN: " *", ProofStatus.MISMATCH: " (!)"}
    return f"{measured.value:.4g}{marks[measured.verdict]}"


def behaviors_table(
    results: Sequence[BehaviorResult], behaviors: Sequence[Behavior], engines: Mapping[str, InstalledEngine | None]
) -> str:
    """Return a table with a row per behavior and a column per engine. A star marks known deviations."""
    names = [name for name, found in engines.items() if found is not None and found.engine.spec.steps]
    cells = {(m.behavior, m.engine): measured_cell(m) for m in results}
    rows = [["", "answer", *names]]
    for b in behaviors:
        answer = f"{b.expected:.4g} ± {b.tolerance:.2g} {b.unit}".rstrip()
        rows.append([b.title, answer, *(cells.get((b.name, n), "") for n in names)])
    return "\n".join(aligned(rows, ">"))


def rested_cell(rested: RestResult) -> str:
    """Return the deviation of an engine's resting state from the other engines."""
    if rested.verdict is ProofStatus.FAILED:
        return "failed"
    return f"{rested.mm:.2f} mm {rested.deg:.2f}°" + (" (!)" if rested.verdict is ProofStatus.MISMATCH else "")


def rested_table(rested: Sequence[RestResult], engines: Mapping[str, InstalledEngine | None]) -> str:
    """Return a table with a row per spec and a column per engine."""
    names = [name for name in engines if any(r.engine == name for r in rested)]
    return _table("after 2 s", names, {(r.subject, r.engine): rested_cell(r) for r in rested})


def details(
    readings: Iterable[ReadbackResult], results: Iterable[BehaviorResult], rested: Iterable[RestResult] = ()
) -> list[str]:
    """Return a line for every failure and every unexplained difference."""
    lines: list[str] = []
    for reading in readings:
        where, found = f"{reading.subject} in {reading.engine}", reading.comparison
        wrong = [reading.error] if found is None else [difference_line(d) for d in found.mismatches]
        lines += [f"{where}: {line}" for line in wrong[:SHOWN]]
        if len(wrong) > SHOWN:
            lines.append(f"{where}: and {len(wrong) - SHOWN} more")
    for m in results:
        if m.verdict in (ProofStatus.FAILED, ProofStatus.MISMATCH):
            lines.append(f"{m.behavior} in {m.engine}: {m.error or f'{m.value:.5g} is outside the tolerance'}")
    for r in rested:
        if r.verdict in (ProofStatus.FAILED, ProofStatus.MISMATCH):
            away = f"{r.mm:.2f} mm and {r.deg:.2f} deg away from its state in the other engines"
            lines.append(f"{r.subject} simulated in {r.engine}: {r.error or f'{r.worst} ends {away}'}")
    return lines


def known_lines(readings: Iterable[ReadbackResult], results: Iterable[BehaviorResult]) -> list[str]:
    """Return the known losses of the engines, listing each reason once with its number of occurrences."""
    counts = Counter(
        f"{r.engine}: {d.quantity}: {d.covered}" for r in readings if r.comparison for d in r.comparison.covered
    )
    lines = [f"{line} ({n} x)" for line, n in counts.items()]
    return lines + [f"{m.engine}: {m.behavior} {m.value:.4g}: {m.reason}" for m in results if m.reason]


def stale_lines(readings: Iterable[ReadbackResult]) -> list[str]:
    """Return the losses that are reported although the engine preserves the quantity."""
    return [
        f"{r.subject} in {r.engine}: the loss report lists {path}, but the engine preserves it exactly"
        for r in readings
        for path in (r.comparison.stale if r.comparison else ())
    ]


def difference_line(d: Difference) -> str:
    """Format a difference as text, with the object, quantity, expected value, actual value and relative error."""
    error = f" (off by {d.error:.2g})" if math.isfinite(d.error) else ""
    return f"{d.name}: {d.quantity}: expected {value_text(d.expected)}, got {value_text(d.got)}{error}"


def value_text(value: object) -> str:
    """Format a value for display with six digits, or as ``none`` for None."""
    if value is None:
        return "none"
    if isinstance(value, list | tuple):
        return "(" + " ".join(value_text(v) for v in value) + ")" if value else "none"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def absent_line(engine: VerifyEngine) -> str:
    """Return the line that explains how to install an engine that was not found."""
    return f"{engine.name}: {ABSENT}: {engine.spec.install}, or specify its interpreter: --python {engine.family}=PATH"


# Image size [px], such that two images fit side by side in a report on a laptop screen.
WIDTH, HEIGHT = 480, 300

# Vertical field of view, which is narrow enough to show objects without distortion.
_FIELD_DEG = 40.0


def picture(scene: Scene) -> bytes:
    """Return a PNG image of the scene, seen from a corner above all movable objects."""
    from simfoundry.render.gl import choose_engine
    from simfoundry.render.montage import png_bytes
    from simfoundry.worlds.render import render

    return png_bytes(render(scene, overview(scene), engine=choose_engine("auto")))


def overview(scene: Scene) -> Camera:
    """Return a camera that sees all movable objects, or all objects if none of them can move."""
    free = [o for o in scene.objects if not o.fixed] or list(scene.objects)
    corners = [np.stack(world_bounds(o, o.X_WO)) for o in free]
    low = np.min([c[0] for c in corners], axis=0) if corners else np.zeros(3)
    high = np.max([c[1] for c in corners], axis=0) if corners else np.ones(3)
    center, radius = (low + high) / 2, max(0.1, float(np.linalg.norm(high - low)) / 2)
    distance = radius / math.sin(math.radians(_FIELD_DEG) / 2)
    eye = center + distance * np.array([-0.62, -0.42, 0.66])
    f = HEIGHT / 2 / math.tan(math.radians(_FIELD_DEG) / 2)
    return Camera("overview", WIDTH, HEIGHT, f, f, WIDTH / 2 - 0.5, HEIGHT / 2 - 0.5, look_at(eye, center))
