"""Is every predicate that a recipe allows realized, of every object? ``python -m tests.corpora.coverage [SCENE]``.

Of scenes of specs/, each free object is placed by each side predicate around each anchor, the two alone, with gaps and
turns as recipes have them; and by ``OnTop`` and ``Inside`` on and in what can carry something. Each pair gets some
tries until a layout passes every check: ``--tries`` where it is known to be possible, ``--few`` elsewhere. The table
says why what was not realized was not: certain before any try, or what physics said.

Exit code 1 where a side predicate is never realized though nothing makes it impossible, or where one of the goals of
the paper's tasks in the cluttered scene is not: those are known to be possible.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from simfoundry.cousins.layout.acceptance import examine
from simfoundry.cousins.layout.constraints import DROPPED, SIDES
from simfoundry.cousins.layout.propose import Layout, propose
from simfoundry.cousins.layout.twin import Twin
from simfoundry.cousins.recipe.candidate import ImpossibleError
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene
from simfoundry.spec.models.cousins import SceneAxis

SPECS = Path(__file__).resolve().parents[2] / "specs" / "scenes"
ANCHORS = {
    "cluttered": ("bowl", "organizer", "plate", "blue_cup"),
    "stack_dishware": ("plate",),
    "serve_fruits": ("green_plate",),
    "cup_in_bowl": ("bowl",),
    "marker_in_cup": ("cup",),
}
"""Scenes, and the things around which others are placed; on and in each of which they are dropped as well."""

IN_BOWL = ("baseball", "tennis_ball", "burger", "black_eraser", "orange_cup", "red_bottle")
ON_ORGANIZER = ("black_eraser", "orange_cup", "orange_marker", "red_marker", "tennis_ball")
GOALS = {
    "cluttered": {
        *(f"Inside({name}, bowl)" for name in IN_BOWL),
        *(f"OnTop({name}, organizer)" for name in ON_ORGANIZER),
        "OnTop(black_marker, plate)",
        "Inside(red_marker, blue_cup)",
    },
    "cup_in_bowl": {"Inside(cup, bowl)"},
    "marker_in_cup": {"Inside(marker, cup)"},
}
"""What the paper's tasks ask for, so that it is possible."""


def realized(twin: Twin, name: str, word: str, anchor: str, tries: int) -> tuple[int, str]:
    """In how many tries a predicate was realized, or 0 and why not."""
    axis = SceneAxis(anchor=anchor, objects={name: (word,)}, gap=(0.01, 0.25))  # type: ignore[dict-item]
    reasons: Counter[str] = Counter()
    for k in range(tries):
        try:
            found = propose(twin, axis, np.random.default_rng([11, k]))
        except ImpossibleError as error:
            return 0, f"impossible: {error}"
        why = examine(twin, found).reasons if isinstance(found, Layout) else found.reasons
        if not why:
            return k + 1, ""
        reasons.update({reason.code for reason in why})
        if not isinstance(found, Layout) and word in SIDES:
            return 0, why[0].text
    return 0, ", ".join(f"{code} {count}" for code, count in reasons.most_common())


def alone(scene: Scene, name: str, anchor: str) -> Twin:
    """The twin of two things and of what is fixed."""
    kept = tuple(o for o in scene.objects if o.fixed or o.name in (name, anchor))
    there = {o.name for o in kept}
    relations = tuple(r for r in scene.relations if {a.partition(".")[0] for a in r.args} <= there)
    return Twin.of(replace(scene, objects=kept, relations=relations, no_contact=()))


def main(arguments: list[str]) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--tries", type=int, default=30)
    parser.add_argument("--few", type=int, default=2)
    parser.add_argument("scenes", nargs="*", default=list(ANCHORS))
    options = parser.parse_args(arguments)
    missed = 0
    for scene in options.scenes:
        whole = lower_file(SPECS / f"{scene}.scene.yaml")
        for anchor in ANCHORS[scene]:
            counts: Counter[str] = Counter()
            for name in (o.name for o in whole.objects if not o.fixed and o.name != anchor):
                twin = alone(whole, name, anchor)
                for word in (*SIDES, *DROPPED):
                    text = f"{word}({name}, {anchor})"
                    wanted = word in SIDES or text in GOALS.get(scene, ())
                    tries, why = realized(twin, name, word, anchor, options.tries if wanted else options.few)
                    counts["realized" if tries else "impossible" if why.startswith("impossible") else "never"] += 1
                    bad = not tries and wanted and not why.startswith("impossible")
                    missed += bad
                    if not tries:
                        print(f"  {'MISSED ' if bad else ''}{text}: {why[:150]}")
            print(f"{scene:>16} around {anchor:<10} {dict(counts)}", flush=True)
    print("every predicate realized where it is possible" if not missed else f"{missed} predicates missed")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
