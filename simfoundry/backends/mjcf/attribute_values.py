"""Texts of attributes, among them of values to the last bit, which documents imported from MJCF keep as native data.

Contacts amplify rounding errors: a scene that is to move like the original needs its numbers exactly, but documents
state rotations in degrees and inertias as tensors. An exact value counts only where the document's own value agrees
with it, so that edits of the document always take effect.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from simfoundry.backends.artifact import exact, exacts
from simfoundry.geometry.frames import Array, Pose, matrix_from_quat
from simfoundry.scene.model import Link

# Relative difference of values that agree: above the errors of all conversions, and below any edit.
AGREEMENT = 1e-9

# Values of attributes that are omitted.
_OMITTED = {"pos": (0.0, 0.0, 0.0), "quat": (1.0, 0.0, 0.0, 0.0)}


def exact_pose(pose: Pose) -> dict[str, str]:
    """Return a pose as exact ``pos`` and ``quat`` (wxyz) attributes, omitting identity values."""
    p, q = exacts(pose.p), exacts(pose.q)
    return ({} if p == "0 0 0" else {"pos": p}) | ({} if q == "1 0 0 0" else {"quat": q})


def attribute_text(value: Any) -> str:
    """Format a native value as the text of an attribute."""
    if isinstance(value, list | tuple):
        return " ".join(map(attribute_text, value))
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, float) else str(value)


def attribute_texts(values: Mapping[str, Any], *omitted: str) -> dict[str, str]:
    """Format native attributes, except for the ``omitted`` ones."""
    return {key: attribute_text(value) for key, value in values.items() if key not in omitted}


def with_exact_values(attributes: dict[str, str], native: Mapping[str, Any]) -> dict[str, str]:
    """Return attributes in which values are replaced by the exact ones of the native data that agree with them."""
    return attributes | {
        key: attribute_text(value)
        for key, value in native.get("exact", {}).items()
        if key != "inertial" and _agree(key, attributes.get(key), value)
    }


def _agree(key: str, own: str | None, value: Any) -> bool:
    """Return True if an attribute and an exact value are the same, except for rounding."""
    if own is None and key not in _OMITTED:
        return False
    a = np.array(_OMITTED[key] if own is None else own.split(), dtype=np.float64)
    try:
        b = np.atleast_1d(np.array(value, dtype=np.float64))
    except ValueError:  # a text
        return False
    if a.shape != b.shape:
        return False
    if key == "quat" and float(a @ b) < 0:
        a = -a
    scale = max(float(np.abs(a).max(initial=0.0)), 1.0 if key in ("pos", "quat", "axis") else 0.0)
    return bool(np.abs(a - b).max(initial=0.0) <= AGREEMENT * scale)


def inertial_attributes(link: Link, X_BL: Pose, native: Mapping[str, Any]) -> dict[str, str]:
    """Return the attributes of the inertia of a link whose frame has the pose ``X_BL`` in its body."""
    if "inertial" in native:
        return attribute_texts(native["inertial"])
    kept = native.get("exact", {}).get("inertial")
    if kept is not None and _is_inertia_of(kept, link, X_BL):
        return attribute_texts(kept)
    moments, q = link.principal
    pose = {"pos": "0 0 0"} | exact_pose(X_BL @ Pose.of(link.com, q))
    return pose | {"mass": exact(link.mass), "diaginertia": exacts(moments)}


def _is_inertia_of(kept: Mapping[str, Any], link: Link, X_BL: Pose) -> bool:
    """Return True if native attributes are the mass, the center of mass and the inertia of a link."""
    try:
        mass = float(kept["mass"])
        com, q, moments = (np.array(kept[key], dtype=np.float64) for key in ("pos", "quat", "diaginertia"))
    except (KeyError, TypeError, ValueError):
        return False
    if (com.shape, q.shape, moments.shape) != ((3,), (4,), (3,)) or abs(float(q @ q) - 1) > AGREEMENT:
        return False
    axes, turn = matrix_from_quat(q), X_BL.rotation
    tensor: Array = axes @ np.diag(moments) @ axes.T
    own = turn @ link.inertia @ turn.T
    return (
        abs(mass - link.mass) <= AGREEMENT * link.mass
        and bool(np.abs(com - X_BL.apply(link.com)).max() <= AGREEMENT)
        and bool(np.abs(tensor - own).max() <= AGREEMENT * float(np.trace(own)))
    )
