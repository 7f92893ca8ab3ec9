"""Warn about values that are valid but almost certainly not intended: other units, other frames, slips of the finger.

Everything here is decided from the text of a document, without geometry and without numpy.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from simfoundry.spec.check.checker import Checker, Path_
from simfoundry.spec.diagnostics import Fix
from simfoundry.spec.models.base import BodySpec, Material, Model
from simfoundry.spec.models.shapes import BoxShape
from simfoundry.spec.yaml.nodes import Node
from simfoundry.spec.yaml.text import Mark

if TYPE_CHECKING:
    from simfoundry.spec.models.surroundings import CameraSpec

# Gravity [m/s^2] above which a value is in another unit. It is 24.8 on Jupiter and 274 on the Sun; 981 would be in cm.
STRONGEST_GRAVITY = 100.0


def check_gravity(c: Checker, gravity: tuple[float, float, float]) -> None:
    """Check that gravity points down and is given in m/s^2. Weightlessness is plausible."""
    x, y, z = gravity
    size = math.hypot(x, y, z)
    message = hint = ""
    if size > STRONGEST_GRAVITY:
        message = f"gravity is {size:.4g} m/s^2, which is {size / 9.81:,.0f} times that of the Earth"
        unit = "mm/s^2: " if 0.9 < size / 9810 < 1.1 else "cm/s^2: " if 0.9 < size / 981 < 1.1 else ""
        hint = f"this looks like {unit}" if unit else ""
        hint += "gravity is in m/s^2; the Earth's is [0, 0, -9.81]"
    elif z > 0 and z >= max(abs(x), abs(y)):
        message, hint = "gravity points up, so objects rise from their supports", "the z axis points up; negate gravity"
    elif abs(y) > abs(z) or abs(x) > abs(z):
        axis = "y" if abs(y) >= abs(x) else "x"
        message = f"gravity acts along the {axis} axis, so objects slide off horizontal supports"
        hint = "the z axis points up here; in a file with y up, rotate the scene instead: [0, 0, -9.81]"
    if message:
        c.warn("SF431", ("gravity",), message, hint)


# Friction coefficient above which a value is probably a typing error. Rubber on rubber reaches 1.2, and tires 1.7;
# values of 2 to 5 are used to make a gripper never slip.
MAX_FRICTION = 5.0


def check_friction(c: Checker, body: BodySpec | Material, path: Path_) -> None:
    """Check that a friction coefficient is plausible."""
    if body.friction is not None and body.friction > MAX_FRICTION:
        message = f"`{path[-1]}` has a friction coefficient of {body.friction:g}, so that nothing slides on it"
        c.warn("SF438", (*path, "friction"), message, "most pairs of materials have 0.1 to 1.2; rubber reaches 2")


# Range of plausible dimensions of a primitive [m]: from a sheet of paper to a hall. Below LEAST_SIZE, a body has no
# meaning in physics, and simulators reject sizes whose half is rounded to 0.
THINNEST, LARGEST, LEAST_SIZE = 1e-4, 100.0, 1e-9

# Thickness [m] up to which a fixed primitive larger than LARGEST is a ground plane, and not a table in millimeters.
GROUND = 10.0


def check_size(c: Checker, shape: Model, path: Path_, fixed: bool = False) -> None:
    """Check that the dimensions of a primitive are plausible. A large, flat and ``fixed`` primitive is the ground."""
    if isinstance(shape, BoxShape) and THINNEST <= min(shape.box) <= max(shape.box) <= LARGEST:
        return  # most shapes, for which no path is needed
    found = list(dimensions(shape, path))
    if not found:
        return
    (least_at, least), (most_at, most) = (pick(found, key=lambda each: each[1]) for pick in (min, max))
    name = next(str(part) for part in reversed(path) if part != "shape")
    if least < LEAST_SIZE:
        c.add("SF104", least_at, f"`{name}` is {least:.3g} m thick, which is too small for a simulator", _METERS)
    elif least < THINNEST:
        c.warn("SF439", least_at, f"`{name}` has a dimension of {least * 1000:.3g} mm", _METERS)
    elif most > LARGEST and not (fixed and least <= GROUND):
        c.warn("SF439", most_at, f"`{name}` has a dimension of {most:.4g} m", _METERS)


_METERS = "lengths are in m; for 40 mm, write 0.04"


def dimensions(value: Any, path: Path_) -> Iterator[tuple[Path_, float]]:
    """Yield the lengths in a shape with their paths; an outline or profile has the extents of its points."""
    if isinstance(value, Model):
        for key in type(value).model_fields.keys() - {"pose", "color"}:
            yield from dimensions(getattr(value, key), (*path, key))
    elif isinstance(value, Mapping):
        for key, member in value.items():
            yield from dimensions(member, (*path, key))
    elif isinstance(value, tuple) and value and isinstance(value[0], tuple):
        for numbers in zip(*value, strict=True):
            yield path, max(numbers) - min(numbers)
    elif isinstance(value, tuple):
        for k, member in enumerate(value):
            yield from dimensions(member, (*path, k))
    elif isinstance(value, float | int) and not isinstance(value, bool):
        yield path, value


# Focal length [px] below which a value is in other units: an image of 8 px across would span 45 degrees.
SHORTEST_FOCAL = 10.0


def check_intrinsics(c: Checker, camera: Any, path: Path_, size: tuple[int, int] | None = None) -> None:
    """Check that the focal lengths are in pixels and, if the image ``size`` is known, where the principal point is."""
    for key in ("fx", "fy"):
        focal = getattr(camera, key)
        if focal is not None and focal < SHORTEST_FOCAL:
            hint = "focal lengths are in pixels: the width of the image / (2 tan(half the horizontal field of view))"
            c.warn("SF436", (*path, key), f"`{key}` is {focal:g} px", hint)
    for key, side in zip(("cx", "cy"), size or (), strict=False):
        point = getattr(camera, key)
        if point is not None and not -0.5 <= point <= side - 0.5:
            message = f"the principal point is outside the image: `{key}` is {point:g} px, but the image has {side}"
            c.warn("SF436", (*path, key), message, f"at the center, it is {(side - 1) / 2:g}; leave it out for that")


def check_camera(c: Checker, camera: CameraSpec, path: Path_) -> None:
    """Check the intrinsics of a scene's camera."""
    check_intrinsics(c, camera, path, camera.size)


# Travel of a prismatic joint [m] above which its limits are probably in millimeters.
LONGEST_TRAVEL = 10.0

# Travel [m] from which a joint is meant to have no limits; importers write -1000 to 1000 for such joints.
UNLIMITED_TRAVEL = 2000.0


def check_travel(c: Checker, limits: tuple[float, float] | None, path: Path_) -> None:
    """Check that the limits of a prismatic joint are plausible in meters."""
    if limits is not None and LONGEST_TRAVEL < (travel := limits[1] - limits[0]) < UNLIMITED_TRAVEL:
        message = f"`{path[-1]}` travels {travel:.4g} m, from {limits[0]:g} to {limits[1]:g}"
        hint = f"limits are in m: [{limits[0] / 1000:g}, {limits[1] / 1000:g}], if these are in mm"
        c.warn("SF435", (*path, "limits"), message, hint)


# -- the text, value by value ---------------------------------------------------------------------------------------


def check_values(c: Checker) -> None:
    """Check every value of the text: angles that look like radians, and scalars that YAML 1.1 reads differently.

    Documents with values of a wrong type are skipped, because those values are reported already.
    """
    if not c.whole:
        return
    seen: set[int] = set()
    todo: list[tuple[_Trail, Node]] = [(None, c.document.root)]
    while todo:
        trail, node = todo.pop()
        children = node.children
        if children is None or id(node) in seen:  # an alias
            continue
        seen.add(id(node))
        for key, child in children.items() if isinstance(children, dict) else enumerate(children):
            if child.children is not None and key != "conflicts":
                todo.append(((trail, key), child))
            elif child.plain and _ORDINARY(child.plain) is None and len(child.plain) <= LONGEST:
                _check_scalar(c, (*_path(trail), key), child)
            if type(key) is str and key.endswith("deg"):
                _check_angle(c, (*_path(trail), key), child)


# The keys that lead to a value, innermost first, as nested pairs. Most values are fine, and their path is not needed.
_Trail = tuple["_Trail", str | int] | None


def _path(trail: _Trail) -> Path_:
    keys: list[str | int] = []
    while trail is not None:
        trail, key = trail
        keys.append(key)
    return tuple(reversed(keys))


# Length of a scalar up to which YAML 1.1 readers are asked; what they read differently is a number, word or date.
LONGEST = 40

# Scalars that all YAML readers agree on: decimal numbers, and words or calls that are not a YAML 1.1 boolean.
_ORDINARY = re.compile(
    r"-?(?:0|[1-9][0-9]*)(?:\.[0-9]*)?\Z"
    r"|(?!(?:yes|no|on|off|y|n)\Z)[A-Za-z_/][^\n]*\Z",
    re.IGNORECASE,
).match


def _check_scalar(c: Checker, path: Path_, node: Node) -> None:
    """Warn if a YAML 1.1 reader, such as PyYAML, gives an unquoted scalar another value."""
    other = _yaml_1_1(node.plain)
    ours = node.value
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in (ours, other))
    if ours is None or (other == ours if numbers else (type(other), other) == (type(ours), ours)):
        return
    if isinstance(ours, str) and ours != node.plain:  # a path in a base document, which is relative to this document
        return
    from simfoundry.spec.yaml.spelling import exact, quoted

    kinds = {bool: "the truth value", str: "the string", int: "the number", float: "the number"}
    read = f"{kinds.get(type(other), 'the date')} `{str(other).lower() if isinstance(other, bool) else other}`"
    hint = f"write `{quoted(ours) if isinstance(ours, str) else exact(ours)}`, which all readers agree on"
    fix = Fix(quoted(ours) if isinstance(ours, str) else exact(ours), certain=True)
    c.warn("SF441", path, f"`{node.plain}` is read as {read} by YAML 1.1 tools", hint, Mark(fixes=(fix,)))


def _yaml_1_1(text: str) -> Any:
    """Return the value that a YAML 1.1 reader gives to an unquoted scalar; an invalid value is its text as a string."""
    import yaml

    loader = yaml.SafeLoader("")
    try:
        tag = loader.resolve(yaml.ScalarNode, text, (True, False))  # type: ignore[no-untyped-call]
        return loader.construct_object(yaml.ScalarNode(tag, text))
    except (ValueError, yaml.YAMLError):
        return f"{text} "


def _check_angle(c: Checker, path: Path_, node: Node) -> None:
    """Warn about each angle of a value whose key ends in `deg`, if it looks like radians."""
    if path[-1] == "limits_deg":
        _check_limits(c, path, node)
        return
    for k, each in enumerate(node.members or (node,)):
        if isinstance(each.value, float) and in_radians(each.plain):
            at = (*path, k) if node.children is not None else path
            degrees = f"{round(math.degrees(float(each.plain))):g}"
            hint = f"if it is in radians, write {degrees}; it is in degrees here"
            message = f"`{path[-1]}` is {each.plain} deg, which looks like an angle in radians"
            c.warn("SF434", at, message, hint, Mark(fixes=(Fix(degrees),)))


def _check_limits(c: Checker, path: Path_, node: Node) -> None:
    """Warn if limits in degrees look like radians: an end is a fraction of pi, or they are typical of an arm."""
    ends = [each.plain for each in node.members]
    numbers = [each.value for each in node.members if isinstance(each.value, int | float)]
    if len(ends) != 2 or len(numbers) != 2 or max(map(abs, numbers)) > _TURN:
        return
    precise = any(3 <= len(text.partition(".")[2]) <= 4 for text in ends) and numbers[1] - numbers[0] >= 1.0
    if precise or any(in_radians(text) for text in ends):
        low, high = (math.degrees(value) for value in numbers)
        hint = f"`limits_deg` is in degrees; if these are in radians, write [{low:.1f}, {high:.1f}]"
        message = f"`{path[-2]}` turns only {numbers[1] - numbers[0]:.3g} deg, and its limits look like radians"
        c.warn("SF435", path, message, hint, Mark(fixes=(Fix(f"[{low:.1f}, {high:.1f}]"),)))


# A full turn [rad], and a bit more for rounding.
_TURN = 2 * math.pi + 0.01

# Fraction of pi that an angle in radians is a multiple of, by the number of decimals from which it is recognized. Fewer
# decimals would also find angles in degrees, such as 0.52. With four decimals, whole degrees are recognized: only 1 of
# 170 angles that are really in degrees, and as precise, is a multiple by chance.
_FRACTIONS = {2: 2, 3: 4, 4: 180}


# A number below 10 that is written with at least two decimals.
_DECIMALS = re.compile(r"[-+]?[0-9]?\.[0-9]{2,20}\Z")


def in_radians(text: str) -> bool:
    """Return True if a number, as it is written, is a fraction of pi between 0 and a full turn, such as 1.5708."""
    if _DECIMALS.match(text) is None:
        return False
    digits = text.partition(".")[2]
    value = abs(float(text))
    part = math.pi / _FRACTIONS[min(len(digits), max(_FRACTIONS))]
    multiple = part * round(value / part)
    unit = max(10.0 ** -len(digits), 1e-12)
    rounded_or_cut = -unit < value - multiple <= unit / 2
    return 0 < multiple <= _TURN and rounded_or_cut
