"""A page that shows how success rates depend on the values that a recipe varies."""

from __future__ import annotations

from collections.abc import Sequence

from simfoundry.evaluate.statistics.sensitivity import SensitivityTable
from simfoundry.reports.render import render


def sensitivity_page(recipe: str, tables: Sequence[SensitivityTable]) -> str:
    """Return the page as HTML, with one table of numbers and one of choices for each policy and engine."""
    return render("sensitivity.html.j2", title=f"Sensitivity: {recipe}", sources="'self'", tables=tables)
