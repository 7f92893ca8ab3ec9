"""Find the selected variant of an object with variants, and the edits to each variant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from simfoundry.frontends.usd.compiled.stage import UNKNOWN, Edited, StageMember, StageNote, links_of, transform
from simfoundry.spec.models.scene import DEFAULT_VARIANT, GEOMETRY, OF_GEOMETRY, ObjectSpec, variant_of
from simfoundry.spec.yaml.write import to_data

Data = dict[str, Any]
Edit = Callable[[StageMember], Edited]

# Keys of an object that do not belong to its variants.
OF_OBJECT = ("pose", "place", "fixed", "joints")

# Tolerance for equal positions [m] and quaternion components; stages store nine digits.
_STILL = 1e-9


def variant_data(data: Data, variant: str) -> Data:
    """Return the data of an object with the given variant applied, omitting the ``variants`` key.

    If the variant does not exist, the data is returned unchanged.
    """
    is_known = variant not in ("", UNKNOWN)
    return to_data(variant_of(ObjectSpec.model_validate(data), variant)) if is_known else data


def edited_variants(part: StageMember, edit: Edit) -> Edited:
    """Return the edited data of an object with variants, and notes on unsupported edits.

    ``edit`` converts a single variant. Opinions on the object itself, which override all variants, count as edits to
    the selected variant.
    """
    spec = part.spec
    names = [DEFAULT_VARIANT, *spec["variants"]]
    if part.variant not in names:
        known = ", ".join(f"`{name}`" for name in names)
        message = f"the selected variant is not in the document; available variants: {known}"
        return Edited(spec, (StageNote(part.path, message, "add it to `variants` in the document and compile again"),))
    data = {key: value for key, value in spec.items() if key != "variant"}
    if part.variant != DEFAULT_VARIANT or spec.get("variant") == DEFAULT_VARIANT:
        data["variant"] = part.variant
    notes: list[StageNote] = []
    by_name = {one.variant: one for one in (part, *part.others)}
    for name in (name for name in names if name in by_name):
        one, before = by_name[name], variant_data(spec, name)
        after, found = edit(replace(one, spec=before))
        if one is not part:
            after, moved = _without_pose(one, before, after)
            found = tuple(replace(note, message=f"in variant `{name}`: {note.message}") for note in found)
            notes += moved
        data = _merged(data, name, before, after)
        notes += found
    return Edited(data, tuple(notes))


def _without_pose(one: StageMember, before: Data, after: Data) -> tuple[Data, list[StageNote]]:
    """Return an edited variant with the original pose, because all variants of an object share its pose."""
    data = {key: value for key, value in after.items() if key not in OF_OBJECT}
    data |= {key: value for key, value in before.items() if key in OF_OBJECT}
    paths = ["", *links_of(one.built)[:1]]
    if any(np.abs(transform(one.built, path) - transform(one.now, path)).max() > _STILL for path in paths):
        message = f"the variant `{one.variant}` was moved, but all variants of an object share the same pose"
        return data, [StageNote(one.path, message, "move the object instead")]
    return data, []


def _merged(data: Data, name: str, before: Data, after: Data) -> Data:
    """Return ``data`` with the variant ``name`` changed from ``before`` to ``after``.

    The default variant's data is the data of the object itself.
    """
    changed = [key for key in dict.fromkeys((*before, *after)) if before.get(key) != after.get(key)]
    own = [key for key in changed if name != DEFAULT_VARIANT and key not in OF_OBJECT]
    out = {key: value for key, value in data.items() if key not in changed or key in own}
    out |= {key: after[key] for key in changed if key not in own and key in after}
    if not own:
        return out
    inherited = variant_data(out, name)
    variant = {key: value for key, value in out["variants"][name].items() if key not in own}
    # A variant with its own geometry does not inherit the object's geometry fields, so they must be written as well.
    for key in [*own, *(OF_GEOMETRY if any(key in own for key in GEOMETRY) else ())]:
        if key in after and (key in OF_GEOMETRY or after[key] != inherited.get(key)):
            variant[key] = after[key]
    members = {**out["variants"], name: variant}
    return {**out, "variants": {key: value for key, value in members.items() if value}}
