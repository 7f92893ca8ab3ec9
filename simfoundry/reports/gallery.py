"""The page ``gallery.html``: images of the first cousins, their requested variations, and reasons for rejections."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from simfoundry.cousins.recipe.candidate import Candidate
from simfoundry.cousins.run.log import Reader
from simfoundry.cousins.run.report import draw, examples, summary
from simfoundry.cousins.run.run import MANIFEST, Ledger, RunPlan
from simfoundry.reports.render import render
from simfoundry.runtime.files import write_atomically

PAGE = "gallery.html"
PICTURES = "pictures"


def write_gallery(plan: RunPlan, ledger: Ledger, most: int, progress: Callable[[int, int], None] | None = None) -> Path:
    """Write the page, rendering missing images for at most ``most`` cousins."""
    with Reader() as reader:
        places = islice((place for place in ledger.counted() if place.accepted), most)
        shown = [reader.candidate(place) for place in places]
    pictures = {}
    for k, candidate in enumerate(shown):
        if progress is not None:
            progress(k, len(shown))
        path = _picture(plan.out, candidate)
        if path is not None:
            pictures[candidate.index] = path.relative_to(plan.out).as_posix()
    variants = [str(count) for count in plan.variants]
    write_atomically(plan.out / PAGE, page(summary(plan, ledger), shown, pictures, examples(ledger), variants).encode())
    return plan.out / PAGE


def _picture(out: Path, candidate: Candidate) -> Path | None:
    """Return the image of a cousin's scene, rendering it if necessary.

    Returns:
        The path of the image, or None if the cousin has no scene of its own or the scene has no camera.
    """
    if "scene" not in candidate.documents:
        return None
    path = out / PICTURES / f"{candidate.index:06d}.png"
    if not path.is_file() and (image := draw(out / candidate.files()["scene"])) is not None:
        write_atomically(path, image)
    return path if path.is_file() else None


def page(
    facts: Mapping[str, Any],
    shown: Sequence[Candidate],
    pictures: Mapping[int, str],
    reasons: Mapping[str, str],
    variants: Sequence[str] = (),
) -> str:
    """Render the page.

    Args:
        facts: Totals of the run.
        shown: The cousins to show.
        pictures: Image paths by cousin index.
        reasons: One example for each rejection reason.
        variants: A text that describes the variant results for each object.
    """
    return render(
        "gallery.html.j2",
        title=f"Cousins: {facts['recipe']}",
        sources="'self'",
        facts=facts,
        shown=shown,
        pictures=pictures,
        reasons=reasons,
        variants=variants,
        file=MANIFEST,
    )
