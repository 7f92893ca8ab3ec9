"""Order of the members of a merged mapping or list."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Order:
    """Merged order of ``keys``; ``clash`` is True if both sides reordered the members of the base differently."""

    keys: list[str]
    clash: bool


def merged_order(
    base: Collection[str], ours: Collection[str], theirs: Collection[str], kept: Collection[str], ours_first: bool
) -> Order:
    """Return the order of the ``kept`` keys, each of which exists on at least one side.

    If one side reorders keys that it shares with the base, its order wins. A key that only one side has follows its
    predecessor on that side. If both sides added keys at the same position, or both reordered, the keys are sorted by
    name, so that the result does not depend on which side is which. With ``ours_first``, our order wins if both
    reordered.
    """
    core = [key for key in ours if key in theirs and key in kept]
    core_theirs = [key for key in theirs if key in ours and key in kept]
    shared, shared_theirs = ([k for k in keys if k in base] for keys in (core, core_theirs))
    inside = set(shared)
    before = [key for key in base if key in inside]
    clash = shared != before and shared_theirs != before and shared != shared_theirs
    if core != core_theirs:
        if shared != before and (shared_theirs == before or (clash and ours_first)):
            chosen = core
        elif shared == before and shared_theirs != before:
            chosen = core_theirs
        else:
            chosen = min(core, core_theirs)
    else:
        chosen = core
    runs = [_runs(keys, core, kept) for keys in (ours, theirs)]
    out = list[str]()
    for anchor in (None, *chosen):
        if anchor is not None:
            out.append(anchor)
        for run in sorted(found[anchor] for found in runs if anchor in found):
            out += run
    return Order(out, clash)


def reordered(keys: Iterable[str], wanted: Sequence[str]) -> list[str]:
    """Return the keys in the order ``wanted``; a key that it does not contain stays after its predecessor."""
    keys = list(keys)
    runs = _runs(keys, [key for key in wanted if key in set(keys)], keys)
    out = runs.get(None, [])
    for key in wanted:
        if key in keys:
            out = [*out, key, *runs.get(key, [])]
    return out


def _runs(keys: Iterable[str], core: Sequence[str], kept: Collection[str]) -> dict[str | None, list[str]]:
    """Return the kept keys outside the core, grouped by the core key before them."""
    inside, runs, anchor = set(core), dict[str | None, list[str]](), None
    for key in keys:
        if key in inside:
            anchor = key
        elif key in kept:
            runs.setdefault(anchor, []).append(key)
    return runs
