"""Contracts of model tasks: the members of a request and of its answer, with types, shapes, units and frames.

A shape contains sizes (numbers) and letters. A letter stands for the same size in the request and in the answer, so an
answer for an image of another size is found without any code. Each task adds checks of its own, which find plausible
arrays that follow another convention: millimeters, OpenGL cameras, inverted transforms.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ValidationError

from simfoundry.errors import SimfoundryError
from simfoundry.models.wire import Bundle, BundleFile, BundleImage, Content

# Camera frame of all tasks, as in OpenCV: x right, y down, z forward, in meters, with the origin in the optical center.
CAMERA = "camera_opencv"

# Frame of meshes: y up, as in glTF; the z axis points at the viewer of the first image.
MESH = "gltf_y_up"


class ModelError(SimfoundryError):
    """Raised if a model returns no usable response. The message states the model, the reason, and the remedy."""


def plain(text: object, limit: int = 300) -> str:
    """Return text from elsewhere as one printable line of limited length, safe to show in a terminal."""
    line = "".join(c if c.isprintable() else " " for c in str(text)[: 20 * limit])
    return " ".join(line.split())[:limit]


class ConventionError(ValueError):
    """Raised for an answer that breaks the contract of its task. The message continues a sentence about the answer."""


@dataclass(frozen=True)
class Member:
    """A member of a request or an answer.

    Attributes:
        name: Name of the member.
        kind: ``array``, ``image`` (RGB), ``rgba``, ``images`` (several RGB images of one size), ``glb``, ``ply``.
        meaning: Meaning for people who write servers.
        shape: Shape of an array; for images, height and width, after the number of images. Letters stand for sizes.
        dtype: Type of an array.
        unit: Unit, which a sender may state and which must then be this one.
        frame: Frame, as the unit.
        low: Minimum of the values.
        high: Maximum of the values.
        is_optional: True if the member may be missing.
    """

    name: str
    kind: Literal["array", "image", "rgba", "images", "glb", "ply"]
    meaning: str
    shape: tuple[str | int, ...] = ()
    dtype: str = "float32"
    unit: str = ""
    frame: str = ""
    low: float | None = None
    high: float | None = None
    is_optional: bool = False


# Compares a request with its answer, and raises :class:`ConventionError`.
Check = Callable[[Bundle, Bundle], None]


@dataclass(frozen=True)
class ModelTask:
    """A task that models solve.

    Attributes:
        name: Name of the task, as in ``POST /v1/{name}``.
        role: Name of the model in the paper.
        summary: One line about the task.
        inputs: Members of the request.
        outputs: Members of the answer.
        parameters: Type of the request's ``parameters``, or None if there are none.
        values: Type of the answer's ``values``, or None if there are none.
        checks: Checks of the answer beyond types, shapes and ranges.
    """

    name: str
    role: str
    summary: str
    inputs: tuple[Member, ...]
    outputs: tuple[Member, ...]
    parameters: type[BaseModel] | None = None
    values: type[BaseModel] | None = None
    checks: tuple[Check, ...] = field(default=())


def check_request(task: ModelTask, request: Bundle) -> dict[str, int]:
    """Check the members and parameters of a request, and return the size that each letter of a shape stands for.

    Raises:
        ConventionError: If the request breaks the contract.
    """
    sizes: dict[str, int] = {}
    _check_members(task.inputs, request, sizes)
    _typed(task.parameters, request.head.get("parameters", {}), "parameters")
    return sizes


def check_answer(task: ModelTask, request: Bundle, answer: Bundle) -> None:
    """Check an answer against the contract of its task and against its request.

    Raises:
        ConventionError: If the answer breaks the contract.
    """
    sizes = check_request(task, request)
    named = answer.head.get("task")
    if named != task.name:
        raise ConventionError(f"is for the task {str(named)[:40]!r}, not `{task.name}`")
    echoed = answer.head.get("request")
    if echoed is not None and echoed != request.digest:
        raise ConventionError("belongs to another request")
    _check_members(task.outputs, answer, sizes)
    _typed(task.values, answer.head.get("values", {}), "values")
    for check in task.checks:
        check(request, answer)


def _check_members(members: Sequence[Member], bundle: Bundle, sizes: dict[str, int]) -> None:
    known = {member.name for member in members}
    foreign = sorted(bundle.members.keys() - known)
    if foreign:
        raise ConventionError(f"contains `{foreign[0]}`; known members: {', '.join(sorted(known))}")
    for member in members:
        content = bundle.members.get(member.name)
        if content is not None:
            _check_member(member, content, bundle.notes.get(member.name, {}), sizes)
        elif not member.is_optional:
            raise ConventionError(f"contains no `{member.name}` ({member.meaning})")


def _check_member(member: Member, content: Content, notes: Mapping[str, str], sizes: dict[str, int]) -> None:
    for note, wanted in (("unit", member.unit), ("frame", member.frame)):
        if wanted and notes.get(note, wanted) != wanted:
            raise ConventionError(f"states `{member.name}` in {notes[note]!r} ({note}); it must be {wanted!r}")
    shape, dtype = _shape(member, content)
    _match(member, shape, sizes)
    if member.kind == "array":
        assert isinstance(content, np.ndarray)
        if dtype != member.dtype:
            raise ConventionError(f"has `{member.name}` as {dtype}; it must be {member.dtype}")
        _check_range(member, content)


def _shape(member: Member, content: Content) -> tuple[tuple[int, ...], str]:
    """Return the shape that is compared with the contract, and the type of an array."""
    if member.kind == "array" and isinstance(content, np.ndarray):
        return content.shape, content.dtype.name
    if member.kind in ("image", "rgba") and isinstance(content, BundleImage):
        channels = 3 if member.kind == "image" else 4
        if content.pixels.ndim == 3 and content.pixels.shape[2] == channels:
            return content.pixels.shape[:2], "uint8"
    if member.kind == "images" and isinstance(content, tuple) and content:
        shapes = {one.pixels.shape for one in content}
        if len(shapes) == 1 and len(first := content[0].pixels.shape) == 3 and first[2] == 3:
            return (len(content), *first[:2]), "uint8"
    if isinstance(content, BundleFile) and content.kind == member.kind:
        return (), ""
    names = {"image": "an RGB image", "rgba": "an RGBA image", "images": "RGB images of one size", "array": "an array"}
    raise ConventionError(f"has a `{member.name}` that is not {names.get(member.kind, f'a {member.kind} file')}")


def _match(member: Member, shape: tuple[int, ...], sizes: dict[str, int]) -> None:
    """Compare a shape with the contract, and remember the sizes that new letters stand for."""
    wanted = member.shape
    fits = len(shape) == len(wanted)
    if fits:
        for size, expected in zip(shape, wanted, strict=True):
            if isinstance(expected, str):
                known = packed(sizes[expected[:-2]]) if expected.endswith("/8") else sizes.setdefault(expected, size)
                fits = fits and known == size
            else:
                fits = fits and expected == size
    if not fits:
        letters = {s: sizes[s] for s in wanted if isinstance(s, str) and s in sizes}
        given = "".join(f", {letter} = {size}" for letter, size in letters.items())
        text = ", ".join(map(str, wanted))
        raise ConventionError(f"has `{member.name}` of the shape {shape}; it must be ({text}){given}")


def packed(width: int) -> int:
    """Return the number of bytes in a row of packed bits."""
    return (width + 7) // 8


def _check_range(member: Member, array: Any) -> None:
    if not array.size:
        return
    low, high = float(array.min()), float(array.max())
    unit = f" {member.unit}" if member.unit else ""
    if member.low is not None and low < member.low:
        raise ConventionError(f"has `{member.name}` down to {low:.4g}{unit}; the minimum is {member.low:g}{unit}")
    if member.high is not None and high > member.high:
        raise ConventionError(f"has `{member.name}` up to {high:.4g}{unit}; the maximum is {member.high:g}{unit}")


def _typed(kind: type[BaseModel] | None, data: Any, name: str) -> None:
    if kind is None:
        if data:
            raise ConventionError(f"has `{name}`, but this task has none")
        return
    try:
        kind.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise ConventionError(f"has unusable `{name}`: {place or 'all'}: {first['msg']}") from None
