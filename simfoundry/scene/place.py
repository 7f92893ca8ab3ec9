"""Compute the poses of objects placed on, inside or beside other objects.

An object keeps its specified rotation, is moved to its horizontal position, and is lowered along z until it nearly
touches its support, leaving a gap of :data:`CLEARANCE`. Only the support stops the object; collisions with other
objects do not move it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from graphlib import CycleError, TopologicalSorter

import numpy as np

from simfoundry.geometry.frames import IDENTITY, Array, Pose, quat_from_rpy
from simfoundry.geometry.hulls import Hulls
from simfoundry.geometry.vertical_contact import heights
from simfoundry.geometry.walls import hollow, surrounded
from simfoundry.scene.carriers import Carrier, PlaceError, flipped
from simfoundry.scene.frames import FrameTree
from simfoundry.scene.model import SceneObject
from simfoundry.scene.object_shapes import hulls
from simfoundry.scene.state import pose
from simfoundry.spec.models.reuse import FramedPose
from simfoundry.spec.models.scene import Place

# A placement relative to other objects, or a pose in a frame that may move with an object.
Placement = Place | FramedPose

# Function that returns an object that has been placed before, given the objects placed so far, or None.
KnownPlacement = Callable[[SceneObject, Placement, Mapping[str, SceneObject]], SceneObject | None]

# The frames of a scene without named frames.
WORLD_FRAME = FrameTree()

# Maximum deviation of a level frame's vertical axis, as 1 - cos(angle); 1e-9 corresponds to 0.003 degrees.
LEVEL = 1e-9

# Height of a placed object above its support [m], which prevents interpenetration.
CLEARANCE = 1e-4

# Number of decimals of a solved position [m], chosen to hide platform-dependent rounding errors.
DIGITS = 6

LEFT_RIGHT, FRONT_BEHIND = 1, 0
# The axis of the viewer's frame (0 away, 1 left) that each keyword constrains, and the side of the anchor along it.
RELATIONS = {
    "left_of": (LEFT_RIGHT, 1),
    "right_of": (LEFT_RIGHT, -1),
    "behind": (FRONT_BEHIND, 1),
    "in_front_of": (FRONT_BEHIND, -1),
}


def order(places: Mapping[str, Placement], frames: FrameTree = WORLD_FRAME) -> list[str]:
    """Return the names in ``places``, ordered so that each object comes after its support and anchors.

    Objects in a dependency cycle come last, in document order.
    """
    sorter = TopologicalSorter[str](dict.fromkeys(places, ()))
    for name, place in places.items():
        sorter.add(name, *(other for other in needs(place, frames) if other in places))
    with suppress(CycleError):
        sorter.prepare()
    out: list[str] = []
    while ready := sorter.get_ready():
        out += ready
        sorter.done(*ready)
    known = set(out)
    return out + [name for name in places if name not in known]


def needs(place: Placement, frames: FrameTree = WORLD_FRAME) -> list[str]:
    """Return the objects that must be placed first: the support, the anchors, and the object of the frame."""
    moving = frames.carrier(place.frame)
    carriers = [moving] if moving is not None else []
    if isinstance(place, FramedPose):
        return carriers
    carriers += frames.viewer_needs(place.seen_from)
    named = [_carrier_name(place), *(getattr(place, word) for word in RELATIONS)]
    return [*(name.partition(".")[0] for name in named if name is not None), *carriers]


def place_all(
    objects: Mapping[str, SceneObject],
    places: Mapping[str, Placement],
    viewer: Pose | None,
    frames: FrameTree = WORLD_FRAME,
    known: KnownPlacement = lambda item, place, placed: None,
) -> tuple[dict[str, SceneObject], dict[str, PlaceError]]:
    """Place all objects that have a placement.

    Objects that depend on a failed placement are not placed either, but no errors are reported for them. ``known``
    returns an object that has been placed before, so that its placement is not solved again.

    Returns:
        All objects with their placements solved, and the errors for failed placements.
    """
    placed = {name: item for name, item in objects.items() if name not in places}
    errors: dict[str, PlaceError] = {}
    for name in order(places, frames):
        if all(other in placed for other in needs(places[name], frames)):
            if (found := known(objects[name], places[name], placed)) is not None:
                placed[name] = found
                continue
            try:
                X_WO = solve(objects[name], places[name], placed, viewer, frames)
                placed[name] = replace(objects[name], X_WO=X_WO)
            except PlaceError as error:
                errors[name] = error
    return {name: placed.get(name, item) for name, item in objects.items()}, errors


@np.errstate(over="ignore", invalid="ignore")
def solve(
    item: SceneObject,
    place: Placement,
    placed: Mapping[str, SceneObject],
    viewer: Pose | None,
    frames: FrameTree = WORLD_FRAME,
) -> Pose:
    """Compute the pose ``X_WO`` of an object from its placement.

    Args:
        item: The object to place.
        place: The placement of the object, or its pose in a frame.
        placed: The objects that are already placed.
        viewer: The frame that defines left, right, front and behind, with x pointing away from the viewer, or None for
            the world frame.
        frames: The frames to which the placement can refer.

    Raises:
        PlaceError: If the placement is infeasible.
    """
    if isinstance(place, FramedPose):
        return frames.pose(place.frame, placed) @ pose(place)
    held, carrier, xy = approach(item, place, placed, viewer, frames)
    lift = _lift(held, carrier, walled=place.inside is not None)
    if lift is None:
        raise unfit(item.name, xy, held, carrier, "on" if place.inside is None else "inside")
    at = np.round([*xy, lift + CLEARANCE], DIGITS) + 0.0
    if not np.isfinite(at).all():
        raise PlaceError(f"the position of `{item.name}` is not finite", "check the sizes and positions around it")
    return Pose.of(at, _rotation(place, _level_frame(place, placed, frames)))


def approach(
    item: SceneObject,
    place: Place,
    placed: Mapping[str, SceneObject],
    viewer: Pose | None,
    frames: FrameTree = WORLD_FRAME,
) -> tuple[Hulls, Carrier, Array]:
    """Return an object's rotated shape above its target position, its support, and the target position (x, y) [m].

    Raises:
        PlaceError: If the position cannot be computed.
    """
    carrier = Carrier.of(_carrier_name(place) or "", placed)
    X_WF = _level_frame(place, placed, frames)
    shape = hulls(item, X_WO=Pose.of(q=_rotation(place, X_WF)))
    if not len(shape.corners):
        raise PlaceError(f"`{item.name}` has no shape to place")
    if place.seen_from is not None:
        viewer = frames.viewer(place.seen_from, placed)
    xy = _position(place, shape, carrier, placed, viewer, X_WF)
    return shape.moved(np.array([*xy, 0.0])), carrier, xy


def _level_frame(place: Place, placed: Mapping[str, SceneObject], frames: FrameTree) -> Pose:
    """Return the frame of a place.

    Raises:
        PlaceError: If the z axis of the frame is not vertical.
    """
    X_WF = frames.pose(place.frame, placed)
    if X_WF.rotation[2, 2] < 1 - LEVEL:
        hint = "use a level frame, or give the object a `pose` in this frame"
        raise PlaceError(f"the z axis of the frame `{place.frame}` is not vertical", hint)
    return X_WF


def _carrier_name(place: Place) -> str | None:
    return place.on if place.on is not None else place.inside


def _rotation(place: Place, X_WF: Pose) -> Array:
    """Return the rotation of an object in the world as a quaternion, shape (4,)."""
    own = quat_from_rpy(*map(math.radians, place.rpy_deg or (0.0, 0.0, place.yaw_deg or 0.0)))
    return own if X_WF is IDENTITY else (X_WF @ Pose.of(q=own)).q


def _position(
    place: Place, shape: Hulls, carrier: Carrier, placed: Mapping[str, SceneObject], viewer: Pose | None, X_WF: Pose
) -> Array:
    """Return the horizontal position of the object frame in the world [m], as an array of shape (2,).

    ``shape`` is posed at the origin.
    """
    if place.offset is None:
        return _anchored(place, shape, carrier, placed, viewer, X_WF)
    shift = X_WF.rotation @ np.array([*place.offset, 0.0])
    return np.asarray(_anchored(place, shape, carrier, placed, viewer, X_WF) + shift[:2])


def _anchored(
    place: Place, shape: Hulls, carrier: Carrier, placed: Mapping[str, SceneObject], viewer: Pose | None, X_WF: Pose
) -> Array:
    """Return the horizontal position without the offset [m], as an array of shape (2,)."""
    if place.xy is not None:
        return np.asarray(X_WF.apply(np.array([*place.xy, 0.0]))[:2])
    if place.local_xy is not None:
        return np.asarray(carrier.X_WC.apply(np.array([*place.local_xy, 0.0]))[:2])
    own = shape.middle(Pose.of(q=_rotation(place, X_WF)).rotation)[:2]
    anchors = {word: name for word in RELATIONS if (name := getattr(place, word)) is not None}
    if not anchors:
        middle = carrier.part.middle(carrier.X_WC.rotation)
        if place.inside is not None:
            middle = hollow(carrier.part, middle, carrier.X_WC.rotation)
        return np.asarray(middle[:2] - own)
    axes = _axes(viewer)
    along: dict[int, float] = {}
    for word, name in anchors.items():
        axis, side = RELATIONS[word]
        anchor = Carrier.of(name, placed)
        (low, high), (mine_low, mine_high) = anchor.part.extent(axes[axis]), shape.extent(axes[axis])
        along[axis] = high + place.gap - mine_low if side > 0 else low - place.gap - mine_high
        if len(anchors) == 1:
            middle = anchor.part.middle(anchor.X_WC.rotation)
            along[1 - axis] = float(axes[1 - axis][:2] @ (middle[:2] - own))
    return np.asarray(along[0] * axes[0][:2] + along[1] * axes[1][:2])


def _axes(viewer: Pose | None) -> tuple[Array, Array]:
    """Return the two horizontal unit vectors that point away from the viewer and to the viewer's left."""
    x, y, _ = (IDENTITY if viewer is None else viewer).rotation[:, 0]
    length = math.hypot(x, y)
    if length < 1e-6:
        raise PlaceError("the viewpoint looks straight up or down, so `left_of` and `behind` are undefined")
    return np.array([x, y, 0.0]) / length, np.array([-y, x, 0.0]) / length


def _lift(held: Hulls, carrier: Carrier, walled: bool) -> float | None:
    """Return the height [m] by which an object must be lifted to rest on its support, or None if it cannot rest there.

    If one part of the support is above another, such as a cabinet above its drawer, the result is the highest free
    space in which the object rests on the specified part and, if ``walled`` is set, has walls around it.
    """
    touching = heights(held, carrier.whole)
    if carrier.pieces is None and not walled:
        return float(touching.max()) if np.isfinite(touching.max()) else None
    leaving = -heights(held.flipped(), flipped(carrier.whole))
    for lift, part in _spaces(leaving, touching):
        on_it = carrier.pieces is None or part in carrier.pieces
        if on_it and (not walled or surrounded(held.moved(np.array([0.0, 0.0, lift + CLEARANCE])), carrier.part)):
            return lift
    return None


def overlap(thing: Hulls, carrier: Hulls) -> bool:
    """Return True if parts of two shapes overlap by more than :data:`CLEARANCE` along z."""
    touching, leaving = heights(thing, carrier), -heights(thing.flipped(), carrier.flipped())
    return bool(((leaving < -CLEARANCE) & (touching > CLEARANCE)).any())


def _spaces(low: Array, high: Array) -> Iterator[tuple[float, int]]:
    """Yield the heights at which an object can rest, from highest to lowest.

    Each height comes with the part of the support that is below the object. Part i of the object collides with part j
    of the support if the object is lifted by ``low[i, j]`` to ``high[i, j]``.
    """
    met = np.isfinite(high)
    order = np.argsort(-high[met], kind="stable")
    ceiling = math.inf
    part = np.nonzero(met)[1][order]
    for bottom, top, below in zip(low[met][order], high[met][order], part, strict=True):
        if top + 2 * CLEARANCE <= ceiling:
            yield float(top), int(below)
        ceiling = min(ceiling, float(bottom))


def unfit(name: str, xy: Array, held: Hulls, carrier: Carrier, where: str) -> PlaceError:
    """Return the error for an object that misses its support or does not fit."""
    if not np.isfinite(heights(held, carrier.part)).any():
        spans = [" to ".join(map(_meters, carrier.part.extent(axis))) for axis in np.eye(3)[:2]]
        spot = ", ".join(map(_meters, xy))
        message = f"`{name}` at ({spot}) is not above `{carrier.name}`, which spans x {spans[0]} and y {spans[1]}"
        return PlaceError(message, f"move `{name}` over `{carrier.name}`")
    if where == "inside" and len(set(carrier.part.part)) == 1:
        message = f"`{name}` cannot be inside `{carrier.name}`, whose only collider is convex and has no cavity"
        hint = "use `on`, or model the cavity with a lathe, a mesh with `collision: decompose`, or parts"
        return PlaceError(message, hint)
    return misfit(name, held, carrier, where)


def misfit(name: str, held: Hulls, carrier: Carrier, where: str) -> PlaceError:
    """Return the error for an object that does not have enough room on or inside its support."""
    own = _size(held.size())
    room = _size(np.array([high - low for low, high in map(carrier.part.extent, carrier.X_WC.rotation.T)]))
    message = f"`{name}` ({own}) does not fit {where} `{carrier.name}` ({room} outside)"
    return PlaceError(message, "open the container, turn the object, make it smaller or move it")


def _meters(value: float) -> str:
    return f"{value:.3f}" if abs(value) < 1e4 else f"{value:.3g}"


def _size(extents: Array) -> str:
    return " x ".join(f"{100 * v:.1f}" if v < 1e4 else f"{100 * v:.3g}" for v in extents) + " cm"
