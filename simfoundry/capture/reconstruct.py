"""Fit a solid to each segment of an image, and change the scene that was reconstructed from them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from simfoundry.capture.description.level_object import level_shape
from simfoundry.capture.findings import LEFT_OUT, UNSURE, CaptureFinding
from simfoundry.capture.frame import CaptureError, Frame, Segmentation, SupportSurface
from simfoundry.capture.frames.reduced import reduced_frame, reduced_segmentation, reduction
from simfoundry.capture.segment.constraints import without_occluders
from simfoundry.capture.segment.masks import Labels, Mask, outline_of
from simfoundry.capture.shapes.evidence import WINDOW_MARGIN
from simfoundry.capture.shapes.fit import FittedShape, fit_shape
from simfoundry.capture.shapes.solid_casts import cast_mesh
from simfoundry.geometry.frames import Array, Pose, frozen_array
from simfoundry.geometry.shapes import Box, tessellate
from simfoundry.spec.models.predicate import parse_call
from simfoundry.spec.models.scene import SceneSpec

Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """A reconstructed scene, along with the results of each stage of the reconstruction.

    Attributes:
        spec: The scene.
        files: The files that it references, by relative path.
        support: The surface that supports the objects.
        segmentation: The pixels of the objects.
        names: The number of each object in the segmentation, by its name in the scene.
        shapes: The solids of the objects, by name.
        findings: What is doubtful, such as segments that did not become objects.
        removal: Returns the names of the objects in the order in which they are removed from the image, those of a
            layer together, once the images without them are made.
        candidates: Files of shapes of models and of those that they were compared with, by relative path.
        compared: The costs by which the shapes of models were judged, by name of the object.
    """

    spec: SceneSpec
    files: dict[str, bytes]
    support: SupportSurface
    segmentation: Segmentation
    names: dict[str, int]
    shapes: dict[str, FittedShape]
    findings: tuple[CaptureFinding, ...] = ()
    removal: Callable[[], tuple[tuple[str, ...], ...]] = tuple
    candidates: Mapping[str, bytes] = field(default_factory=dict)
    compared: Mapping[str, dict[str, Any]] = field(default_factory=dict)


def with_supports(spec: SceneSpec, supports: Mapping[str, Sequence[str]]) -> SceneSpec:
    """Return the spec with ``OnTop`` relations that match the given supports.

    Relations that still hold are preserved.
    """
    relations = []
    for text in spec.relations:
        call = parse_call(text)
        upper, lower = call.args
        holds = supports.get(upper, ())
        relations += [text] if lower in holds else [f"{call.predicate}({upper}, {other})" for other in holds]
    return spec.model_copy(update={"relations": tuple(relations)})


# Fits one segment, given the image, its pixels, the height [m] of what it stands on, what is around it, and its number.
SegmentFit = Callable[[Frame, Mask, float, Labels, int], FittedShape]

# Applies a function to each number, in order, as ``map`` does, and perhaps in several threads.
Fitted = FittedShape | CaptureFinding
ForEach = Callable[[Callable[[int], Fitted], Sequence[int]], Iterable[Fitted]]

# Margin [px] around an object within which other objects matter to its fit, beside a share of its size: that of rays.
MARGIN_PX = 7

LEFT_OUT_HINT = "move the camera closer, state the division under `decomposition`, or add the object by hand"

# Maximum depth [m] of an object's visible points below the top of its support; fitted tops are off by 1 to 2 cm.
SUNK = 0.03

DOUBTFUL = 0.5  # Minimum confidence of a fit: with a lower F1 score, most of the surface is elsewhere

CARRIED = 0.25  # Minimum fraction of an object's visible points that must be above its support

FOOTHOLD = 0.01  # Minimum distance [m] by which a box extends past the middle of the object that it supports

DEEPEST = 0.12  # Maximum depth [m] that may be added to a box to support an object

EDGE = 0.01  # Distance [m] past the edge of a support within which points still count as above it


def fit_segments(
    frame: Frame,
    support: SupportSurface,
    segmentation: Segmentation,
    report: Progress,
    fit: SegmentFit | None = None,
    each: ForEach = map,
) -> tuple[dict[int, FittedShape], dict[int, int], tuple[CaptureFinding, ...]]:
    """Fit a shape to every segment, from the bottom up.

    ``fit`` fits one segment, for example by reusing an earlier result. The default is :func:`fit_shape`. It is given
    large images at a lower resolution. ``each`` applies it to the segments that stand equally far up in a pile, which
    it may fit at the same time.

    Returns:
        The fitted shapes by segment number, the number of the support of each segment (0 for the table), and a finding
        for each segment that was left out.
    """
    shapes: dict[int, FittedShape] = {}
    carriers: dict[int, int] = {}
    findings = []
    layers, whole = _bottom_up(segmentation), segmentation
    step = reduction(frame.depth.shape)
    frame, segmentation = reduced_frame(frame, step), reduced_segmentation(segmentation, step)
    for k, index in segmentation.surfaces.items():
        shapes[k], carriers[k] = level_shape(frame, support, support.levels[index], ()), 0

    def fitted(k: int) -> Fitted:
        seen, mask = without_occluders(frame, segmentation, k), segmentation.labels == k
        others = nearby_labels(segmentation.labels, k)
        try:
            if fit is None:
                return fit_shape(seen, support, mask, heights[k], labels=others)
            return fit(seen, mask, heights[k], others, k)
        except CaptureError as error:
            return left_out(whole, k, error.message)

    for layer in layers:
        numbers = [k for k in layer if k not in segmentation.surfaces]
        standing = {k: _carrier(frame, support, segmentation, shapes, k) for k in numbers}
        heights = {k: base_z for k, (_, base_z) in standing.items()}
        for k, shape in zip(numbers, each(fitted, numbers), strict=True):
            report(f"shape {k}", len(carriers) / sum(map(len, layers)))
            carriers[k] = standing[k][0]
            if isinstance(shape, CaptureFinding):
                findings.append(shape)
                continue
            if shape.confidence < DOUBTFUL:
                findings.append(unsure(whole, k, shape.confidence))
            shapes[k] = shape
            if carriers[k]:
                shapes[carriers[k]] = deepened(shapes[carriers[k]], shape, support.X_WC.p)
    for k, index in segmentation.surfaces.items():
        carried = [footprint(shapes[on]) for on, carrier in carriers.items() if carrier == k and on in shapes]
        shapes[k] = level_shape(frame, support, support.levels[index], carried)
    return dict(sorted(shapes.items())), carriers, tuple(findings)


def nearby_labels(labels: Labels, k: int) -> Labels:
    """Return what object ``k`` has around it, whatever the numbers of the objects are.

    Only this much of the segmentation influences the fit of an object, so that its result can be reused if objects
    elsewhere change.

    Returns:
        1 at the pixels of the object, 2 at those of others that rays beside the object can hit, and otherwise 0. The
        shape is (h, w).
    """
    rows, columns = np.nonzero(labels == k)
    out = np.zeros(labels.shape, np.int32)
    if not len(rows):
        return out
    reach = MARGIN_PX + int(WINDOW_MARGIN * max(np.ptp(rows), np.ptp(columns)))
    top, left = max(0, int(rows.min()) - reach), max(0, int(columns.min()) - reach)
    window = np.s_[top : int(rows.max()) + reach + 1, left : int(columns.max()) + reach + 1]
    out[window] = np.where(labels[window] == k, 1, np.where(labels[window] > 0, 2, 0))
    return out


def left_out(segmentation: Segmentation, k: int, reason: str, name: str = "") -> CaptureFinding:
    """Return the finding that segment ``k`` did not become an object, with the corners of its pixels."""
    rows, columns = np.nonzero(segmentation.labels == k)
    corners = ((int(columns.min()), int(rows.min())), (int(columns.max()), int(rows.max()))) if len(rows) else ()
    subject = f"`{name}`" if name else f"the object with the number {k} in segments.png"
    return CaptureFinding(LEFT_OUT, f"{subject} was left out: {reason}", LEFT_OUT_HINT, outline=corners)


def unsure(segmentation: Segmentation, k: int, confidence: float) -> CaptureFinding:
    """Return the finding that the solid of segment ``k`` is little more than a guess."""
    message = f"the solid of the object with the number {k} in segments.png is a guess (confidence {confidence:.2f})"
    hint = "show it from closer or from another side, or replace its shape in the scene"
    return CaptureFinding(UNSURE, message, hint, outline=outline_of(segmentation.labels == k))


def _bottom_up(segmentation: Segmentation) -> list[list[int]]:
    """Return the object numbers in layers: those on the table, those on these, and so on."""
    numbers = [int(k) for k in np.unique(segmentation.labels) if k > 0]

    def level(k: int, seen: frozenset[int] = frozenset()) -> int:
        on = segmentation.supports.get(k, 0)
        return 0 if on == 0 or k in seen else 1 + level(on, seen | {k})

    levels = {k: level(k) for k in numbers}
    return [[k for k in numbers if levels[k] == each] for each in sorted(set(levels.values()))]


def _carrier(
    frame: Frame, support: SupportSurface, segmentation: Segmentation, shapes: dict[int, FittedShape], k: int
) -> tuple[int, float]:
    """Return the number of the fitted object that supports ``k``, or 0 for the table, and the height of its base [m].

    The support graph is trusted only if a substantial fraction of the visible points of ``k`` are above the supporting
    solid. An object whose base is merely hidden by a neighbor is not supported by that neighbor.
    """
    import shapely

    on = segmentation.supports.get(k, 0)
    if on not in shapes:
        return 0, 0.0
    seen = support.X_WC.apply(frame.points[(segmentation.labels == k) & np.isfinite(frame.depth)])
    if not len(seen):
        return 0, 0.0
    base_z = carrying_height(shapes[on], seen)
    if np.percentile(seen[:, 2], 5) < base_z - SUNK:
        return 0, 0.0
    below = shapely.MultiPoint(footprint(shapes[on])).convex_hull.buffer(EDGE)
    is_above = shapely.contains(below, shapely.points(seen[:, :2])).mean() >= CARRIED
    return (on, base_z) if is_above else (0, 0.0)


def carrying_height(carrier: FittedShape, points: Array) -> float:
    """Return the height [m] at which a solid carries an object, whose points in the world [m] have shape (n, 3).

    It is that of the floor beneath the object in an open container, and the top of any other solid.
    """
    top = _top(carrier)
    if not carrier.hollow:
        return top
    mesh, (low, high) = tessellate(carrier.geometry), np.percentile(points[:, :2], [2.0, 98.0], axis=0)
    eye = np.array([*((low + high) / 2), top + 1.0])
    hit = cast_mesh(eye, np.array([[0.0, 0.0, -1.0]]), carrier.X_WO.apply(mesh.vertices), mesh.faces).depth[0]
    return float(eye[2] - hit) if np.isfinite(hit) else top


def deepened(carrier: FittedShape, carried: FittedShape, eye: Array) -> FittedShape:
    """Return a box that is extended in depth until it reaches under the middle of the object on it.

    The far side of a box is never visible, and an object on the box hides its top. The objects are at rest, so a box
    depth that would let them fall must be wrong. ``eye`` [m] is the position of the camera in the world. The visible
    side of the box does not move.
    """
    if not isinstance(carrier.geometry, Box):
        return carrier
    X_WO, size = carrier.X_WO, np.array(carrier.geometry.size)
    away = X_WO.rotation.T @ (X_WO.p - eye)
    axis = int(np.argmax(np.abs(away[:2])))
    middle = X_WO.inverse().apply(np.append(footprint(carried).mean(axis=0), X_WO.p[2]))
    need = float(np.sign(away[axis]) * middle[axis]) + FOOTHOLD - size[axis] / 2
    if not 0 < need <= DEEPEST:
        return carrier
    shift = np.zeros(3)
    shift[axis] = np.sign(away[axis]) * need / 2
    size[axis] += need
    return replace(carrier, geometry=Box(frozen_array(size)), X_WO=X_WO @ Pose.of(shift))


def footprint(shape: FittedShape) -> Array:
    """Return the corners of a fitted shape, projected to world xy.

    Returns:
        Array of shape (n, 2) [m].
    """
    return shape.X_WO.apply(tessellate(shape.geometry).vertices)[:, :2]


def _top(shape: FittedShape) -> float:
    """Return the height of the highest point of a fitted shape above the support [m]."""
    return float(shape.X_WO.apply(tessellate(shape.geometry).vertices)[:, 2].max())
