"""Objects with variants: which of them the stage has selected, and what was edited in each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from simfoundry.frontends.usd.compiled.stage import UNKNOWN, StageMember, links_of
from simfoundry.frontends.usd.compiled.values import StageNote
from simfoundry.spec.models.scene import DEFAULT_VARIANT, ObjectSpec
from simfoundry.spec.models.variants import GEOMETRY, OF_GEOMETRY, variant_of
from simfoundry.spec.yaml.write import to_data

Data = dict[str, Any]
Edit = Callable[[StageMember], tuple[Data, tuple[StageNote, ...]]]

OF_OBJECT = ("pose", "place", "fixed", "joints")
"""Keys that an object has and its variants have not."""

_STILL = 1e-9
"""Positions [m] and parts of quaternions that differ by less were written by nobody: a stage has nine digits."""


def variant_data(data: Data, variant: str) -> Data:
    """The data of an object as its ``variant`` has it, without variants; the data itself where there is no such."""
    if not variant or variant == UNKNOWN:
        return data
    return to_data(variant_of(ObjectSpec.model_validate(data), variant))


def edited_variants(part: StageMember, edit: Edit) -> tuple[Data, tuple[StageNote, ...]]:
    """The data of an object with variants, and what of the stage they cannot say; ``edit`` reads one of them.

    What was written on the object itself, over all its variants, counts for the one that is selected.
    """
    spec = part.spec
    names = [DEFAULT_VARIANT, *spec["variants"]]
    if part.variant not in names:
        known = ", ".join(f"`{name}`" for name in names)
        message = f"the variant that is selected is none of the document's, which are {known}"
        return spec, (StageNote(part.path, message, "write it into `variants` of the document, and compile again"),)
    data = {key: value for key, value in spec.items() if key != "variant"}
    if part.variant != DEFAULT_VARIANT or spec.get("variant") == DEFAULT_VARIANT:
        data["variant"] = part.variant
    notes: list[StageNote] = []
    by_name = {one.variant: one for one in (part, *part.others)}
    for name in names:
        if name in by_name:
            one = by_name[name]
            before = variant_data(spec, name)
            after, found = edit(replace(one, spec=before))
            if one is not part:
                after, moved = _without_pose(one, before, after)
                found = tuple(replace(note, message=f"in the variant `{name}`: {note.message}") for note in found)
                notes += moved
            data = _merged(data, name, before, after)
            notes += found
    return data, tuple(notes)


def _without_pose(one: StageMember, before: Data, after: Data) -> tuple[Data, list[StageNote]]:
    """An edited variant as it was written where only its object has a word: all of them stand in one place."""
    data = {key: value for key, value in after.items() if key not in OF_OBJECT}
    data |= {key: value for key, value in before.items() if key in OF_OBJECT}
    paths = ["", *links_of(one.built)[:1]]
    if any(_apart(one.built.get(path, {}), one.now.get(path, {})) for path in paths):
        message = f"the variant `{one.variant}` was moved, and all variants of an object stand in one place"
        return data, [StageNote(one.path, message, "move the object itself")]
    return data, []


def _apart(built: Data, now: Data) -> bool:
    unmoved = (0, 0, 0, 1, 0, 0, 0, 1, 1, 1)
    old, new = (np.array(values.get("at", unmoved), dtype=np.float64) for values in (built, now))
    return bool(np.abs(old - new).max() > _STILL)


def _merged(data: Data, name: str, before: Data, after: Data) -> Data:
    """``data`` in which the variant ``name`` became ``after``: on the object itself where that is what it is."""
    changed = [key for key in dict.fromkeys((*before, *after)) if before.get(key) != after.get(key)]
    own = [key for key in changed if name != DEFAULT_VARIANT and key not in OF_OBJECT]
    out = {key: value for key, value in data.items() if key not in changed or key in own}
    out |= {key: after[key] for key in changed if key not in own and key in after}
    if not own:
        return out
    inherited = variant_data(out, name)
    variant = {key: value for key, value in out["variants"][name].items() if key not in own}
    # A variant that states a geometry comes without what belongs to the object's: that has to be stated, too.
    stated = [*own, *(OF_GEOMETRY if any(key in own for key in GEOMETRY) else ())]
    for key in stated:
        if key in after and (key in OF_GEOMETRY or after[key] != inherited.get(key)):
            variant[key] = after[key]
    members = {**out["variants"], name: variant}
    return {**out, "variants": {key: value for key, value in members.items() if value}}
