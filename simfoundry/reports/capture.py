"""The page with the results of ``simfoundry capture``: pictures, findings, objects and accuracy in a single file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from simfoundry.reports.render import render

# Names and units of the measures of images, in the order of the paper's table, with arrows towards better values.
IMAGE_MEASURES = {
    "psnr": "PSNR [dB] ↑",
    "ssim": "SSIM ↑",
    "mae": "MAE ↓",
    "rmse": "RMSE ↓",
    "ncc": "NCC ↑",
    "delta_e": "ΔE ↓",
    "edge_mae": "EdgeMAE ↓",
}

# Names of the measures of objects, the factor to the unit shown, and its decimals.
OBJECT_MEASURES = {
    "chamfer": ("Chamfer distance [mm] ↓", 1000.0, 1),
    "f1": ("F1 at 1 cm ↑", 1.0, 2),
    "position": ("position of the bounding box [mm] ↓", 1000.0, 1),
}


def capture_page(report: Mapping[str, Any], pictures: Mapping[str, bytes]) -> str:
    """Render the page of a report. ``pictures`` contains PNG images by file name."""
    shown = {name: pictures[name] for name in ("compare.png", "accuracy.png") if name in pictures}
    accuracy = report.get("accuracy")
    return render(
        "capture.html.j2",
        title=f"simfoundry capture {report['source']}",
        sources="",
        report=report,
        summary=summary_line(report),
        pictures=shown,
        accuracy=None if accuracy is None else accuracy_rows(accuracy),
        images=None if accuracy is None else image_rows(accuracy),
        object_columns=[name for name, _, _ in OBJECT_MEASURES.values()],
        image_columns=list(IMAGE_MEASURES.values()),
    )


def summary_line(report: Mapping[str, Any]) -> str:
    """Return one line that tells if the scene passed, and how many findings there are."""
    count, findings = len(report["objects"]), report["findings"]
    open_findings = sum(not finding["accepted"] for finding in findings)
    verdict = "passed" if report["passed"] else "not passed"
    accepted = len(findings) - open_findings
    tail = f", {accepted} accepted" if accepted else ""
    return f"{verdict}: {count} objects, {open_findings} open findings{tail}"


def accuracy_rows(accuracy: Mapping[str, Any]) -> list[tuple[str, list[str]]]:
    """Return the rows of the table of geometry, as in the paper: mean and standard deviation, and one row per object.

    The columns are those of :data:`OBJECT_MEASURES`.
    """
    summary = accuracy["summary"]
    label = f"{summary['found']} of {summary['true']} objects"
    cells = []
    for key, (_, factor, digits) in OBJECT_MEASURES.items():
        value = summary[key]
        spread = "—" if value is None else f"{value['mean'] * factor:.{digits}f} ± {value['std'] * factor:.{digits}f}"
        cells.append(spread)
    rows = [(label, cells)]
    for item in accuracy["objects"]:
        if not item["recovered"]:
            rows.append((f"{item['name']}: not found", ["—"] * len(OBJECT_MEASURES)))
            continue
        own = [f"{item[key] * factor:.{digits}f}" for key, (_, factor, digits) in OBJECT_MEASURES.items()]
        rows.append((f"{item['name']} as {item['recovered']}", own))
    return rows + [(f"{name}: not in the ground truth", ["—"] * len(OBJECT_MEASURES)) for name in summary["extra"]]


def image_rows(accuracy: Mapping[str, Any]) -> list[tuple[str, list[str]]]:
    """Return the rows of the table of images: over all pixels, and over those that show the reconstructed scene."""
    rows = []
    for label, key in (("all pixels", "image"), ("pixels of the scene", "scene_image")):
        values = accuracy[key]
        if values is not None:
            cells = [_number(values[name]) for name in IMAGE_MEASURES]
            rows.append((label, cells))
    return rows


def accuracy_text(accuracy: Mapping[str, Any]) -> str:
    """Return the tables of the paper as text."""
    columns = [name for name, _, _ in OBJECT_MEASURES.values()]
    return (
        f"{_table(columns, accuracy_rows(accuracy))}\n\n{_table(list(IMAGE_MEASURES.values()), image_rows(accuracy))}"
    )


def _table(columns: list[str], rows: list[tuple[str, list[str]]]) -> str:
    first = max(len(label) for label, _ in rows)
    lines = ["  ".join([" " * first, *columns])]
    for label, cells in rows:
        shown = [cell.rjust(len(column)) for cell, column in zip(cells, columns, strict=True)]
        lines.append("  ".join([label.ljust(first), *shown]))
    return "\n".join(lines)


def _number(value: float | None) -> str:
    return "—" if value is None else f"{value:.2f}" if abs(value) >= 10 else f"{value:.3f}"
