"""Conversion of numbers, poses and colors to the data of documents."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.backends.artifact import exact
from simfoundry.geometry.frames import Pose, rpy_from_quat
from simfoundry.spec.models.base import Model
from simfoundry.spec.yaml.tree import plain_tree
from simfoundry.spec.yaml.write import to_data, write_tree

Data = dict[str, Any]

# Number of significant digits in imported numbers: more than any simulator keeps, but without rounding noise.
DIGITS = 9

# Positions [m] and quaternion components below these values are rounding noise in double precision.
NO_LENGTH_M, NO_TURN = 1e-12, 1e-10


def rounded(value: Any, digits: int = DIGITS) -> Any:
    """Return plain data in which all numbers are rounded to ``digits`` significant digits."""
    if isinstance(value, float):
        return float(f"{value:.{digits}g}") + 0.0
    if isinstance(value, dict):
        return {key: rounded(item, digits) for key, item in value.items()}
    return tuple(rounded(item, digits) for item in value) if isinstance(value, list | tuple) else value


def exactly(value: Any) -> Any:
    """Return plain data in which all numbers are exact, up to the noise of conversions; native data has no noise."""
    if isinstance(value, float):
        return float(exact(value))
    if isinstance(value, dict):
        return {key: item if key == "native" else exactly(item) for key, item in value.items()}
    return tuple(exactly(item) for item in value) if isinstance(value, list | tuple) else value


def document_text(spec: Model, tidy: Callable[[Any], Any] = rounded) -> str:
    """Return the canonical text of a document, in which numbers are rounded by ``tidy``."""
    return write_tree(plain_tree(tidy(to_data(spec))), type(spec))


def pose_data(X_AB: Pose) -> dict[str, Any]:
    """Return a pose as document data, with its rotation in the simplest possible representation."""
    out: dict[str, Any] = {}
    if np.abs(X_AB.p).max() > NO_LENGTH_M:
        out["xyz"] = tuple(X_AB.p.tolist())
    if abs(abs(X_AB.q[0]) - 1) < 1e-15 or np.abs(X_AB.q[1:]).max() < NO_TURN:
        return out
    rpy = tuple(math.degrees(v) for v in rpy_from_quat(X_AB.q))
    if np.abs(X_AB.q[1:3]).max() < NO_TURN:
        out["yaw_deg"] = rpy[2]
    elif all(abs(v - round(v, 3)) < 1e-7 for v in rpy):
        out["rpy_deg"] = rpy
    else:
        out["quat_wxyz"] = tuple(X_AB.q.tolist())
    return out


def color_data(color: tuple[float, ...]) -> tuple[float, ...]:
    """Return an RGBA color as document data, omitting an alpha of 1.

    Values are rounded to four decimals to remove single-precision noise.
    """
    values = tuple(round(v, 4) for v in color)
    return values if values[3] < 1 else values[:3]


def relative_path(file: Path, document: Path) -> str:
    """Return the path of a file relative to the folder of a document."""
    return Path(os.path.relpath(file.resolve(), document.resolve().parent)).as_posix()


def without_empty(data: Data) -> Data:
    """Return data without keys whose values are empty."""
    return {key: value for key, value in data.items() if value not in ({}, ())}


def native_data(data: Data) -> Data:
    """Return MJCF attributes as the field of a document."""
    return {"native": {"mjcf": data}} if data else {}
