"""One frame to a scene spec with meshes: the stages in order, each a pure function of what came before."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets import mass
from simfoundry.capture.annotate import SUPPORT, TABLE, Kind, Substance, color_word, kind_of, unique_names
from simfoundry.capture.errors import CaptureError
from simfoundry.capture.frame import Frame, Segmentation, Support
from simfoundry.capture.segment.decompose import decompose
from simfoundry.capture.segment.ground import find_support
from simfoundry.capture.shapes.fit import FittedShape, fit_shape
from simfoundry.capture.shapes.texture import dominant_color, textured_mesh
from simfoundry.capture.support import Thickness, beneath, support_mesh, thickness
from simfoundry.scene.frames import Pose
from simfoundry.scene.meshfile import obj_with_material
from simfoundry.scene.model import Box, Cylinder, Geometry, Mesh, Sphere
from simfoundry.scene.poses import pose_spec
from simfoundry.spec.base import (
    BoxShape,
    CameraPose,
    CylinderShape,
    Estimate,
    Lathe,
    LatheShape,
    Material,
    Origin,
    Prism,
    PrismShape,
    Round,
    Shape,
    SphereShape,
)
from simfoundry.spec.base import Pose as PoseSpec
from simfoundry.spec.relations import parse_relation
from simfoundry.spec.scene import CameraSpec, LightSpec, ObjectSpec, SceneSpec

Progress = Callable[[str, float], None]

SUPPORT_NAME = "table"

SUNK = 0.03
"""What stands on something is not seen lower than this below its top [m]; fits of tops err by a centimetre or two."""

DOUBTFUL = 0.05
"""A fit of less confidence than this explains next to nothing of what was seen."""

CARRIED = 0.25
"""Share of an object's seen points that lie above what carries it."""

EDGE = 0.01
"""How far they may lie beyond its edge [m]."""


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """A spec, the files it refers to by relative path, and what was seen on the way.

    ``names`` gives the number of each object in ``segmentation``; ``skipped`` says why a segment became no object.
    """

    spec: SceneSpec
    files: dict[str, bytes]
    support: Support
    segmentation: Segmentation
    names: dict[str, int]
    shapes: dict[str, FittedShape]
    skipped: tuple[str, ...] = field(default=())


def reconstruct(
    name: str, frame: Frame, given_names: dict[str, int] | None = None, progress: Progress | None = None
) -> Reconstruction:
    """Everything one picture tells, as a scene spec called ``name``.

    ``given_names`` names objects by their number in ``frame.instances``. Raises :class:`CaptureError` where the picture
    holds no support or no object.
    """
    report = progress or (lambda stage, share: None)
    report("support", 0.0)
    support = find_support(frame)
    report("objects", 0.1)
    segmentation = decompose(frame, support)
    shapes, carriers, skipped = _fit_all(frame, support, segmentation, report)
    if not shapes:
        raise CaptureError("SF504", "no object could be fitted", "; ".join(skipped))
    colors = {k: dominant_color(frame, segmentation.labels == k) for k in shapes}
    names = _names(frame, segmentation, shapes, colors, given_names or {})
    grounded = [_footprint(shape) for k, shape in shapes.items() if not carriers[k]]
    support = replace(support, outline=beneath(support.outline, grounded))
    slab = thickness(frame, support)
    files = _mesh_files(SUPPORT_NAME, support_mesh(frame, support, slab.value))
    objects = {SUPPORT_NAME: _support_spec(name, support, slab)}
    materials = {SUPPORT.name: _material(SUPPORT)}
    for done, (k, shape) in enumerate(shapes.items()):
        report(names[k], 0.7 + 0.3 * done / len(shapes))
        mesh = textured_mesh(shape, frame, support, segmentation.labels == k)
        files |= _mesh_files(names[k], mesh)
        substance = TABLE[kind_of(shape.geometry, shape.hollow)]
        materials[substance.name] = _material(substance)
        objects[names[k]] = _object_spec(name, names[k], shape, mesh, substance, colors[k])
    relations = tuple(f"OnTop({names[k]}, {names.get(carriers[k], SUPPORT_NAME)})" for k in shapes)
    spec = SceneSpec(
        simfoundry="scene/1",
        name=name,
        viewpoint="view",
        materials=materials,
        objects=objects,
        cameras={"view": _camera_spec(frame, support)},
        lights={
            "key": LightSpec(type="distant", intensity=0.45, direction=(0.4, -0.3, -1.0)),
            "sky": LightSpec(type="dome", intensity=0.7),
        },
        relations=relations,
        origin=Origin(capture=name, fit=_metres(support.residual)),
    )
    return Reconstruction(
        spec,
        files,
        support,
        segmentation,
        {n: k for k, n in names.items()},
        {names[k]: s for k, s in shapes.items()},
        skipped,
    )


def without(built: Reconstruction, names: Collection[str], reason: str) -> Reconstruction:
    """The reconstruction without some of its objects; what stood on them is said to stand on the support."""
    gone = set(names)
    files = {path: data for path, data in built.files.items() if Path(path).stem not in gone}
    relations = []
    for text in built.spec.relations:
        predicate, (upper, lower) = parse_relation(text)
        if upper not in gone:
            relations.append(f"{predicate}({upper}, {SUPPORT_NAME if lower in gone else lower})")
    objects = {name: item for name, item in built.spec.objects.items() if name not in gone}
    used = {item.material for item in objects.values()}
    materials = {name: item for name, item in built.spec.materials.items() if name in used}
    update = {"objects": objects, "materials": materials, "relations": tuple(relations)}
    return replace(
        built,
        spec=built.spec.model_copy(update=update),
        files=files,
        names={n: k for n, k in built.names.items() if n not in gone},
        shapes={n: s for n, s in built.shapes.items() if n not in gone},
        skipped=(*built.skipped, *(f"{name}: {reason}" for name in sorted(gone))),
    )


def with_supports(spec: SceneSpec, supports: Mapping[str, Sequence[str]]) -> SceneSpec:
    """The spec whose ``OnTop`` relations are those that hold: the ones it has where they do, else what carries now."""
    relations = []
    for text in spec.relations:
        predicate, (upper, lower) = parse_relation(text)
        holds = supports.get(upper, ())
        relations += [text] if lower in holds else [f"{predicate}({upper}, {other})" for other in holds]
    return spec.model_copy(update={"relations": tuple(relations)})


def _fit_all(
    frame: Frame, support: Support, segmentation: Segmentation, report: Progress
) -> tuple[dict[int, FittedShape], dict[int, int], tuple[str, ...]]:
    """Fit every segment, those that carry first; with what each stands on, 0 for the support."""
    shapes: dict[int, FittedShape] = {}
    carriers: dict[int, int] = {}
    skipped: list[str] = []
    order = _bottom_up(segmentation)
    for done, k in enumerate(order):
        report(f"shape {k}", 0.3 + 0.4 * done / max(len(order), 1))
        carriers[k] = _carrier(frame, support, segmentation, shapes, k)
        base_z = _top(shapes[carriers[k]]) if carriers[k] else 0.0
        try:
            shape = fit_shape(frame, support, segmentation.labels == k, base_z, labels=segmentation.labels)
        except CaptureError as error:
            skipped.append(f"segment {k}: {error.message}")
            continue
        if shape.confidence < DOUBTFUL:
            skipped.append(f"segment {k}: no shape explains it (confidence {shape.confidence:.2f})")
        else:
            shapes[k] = shape
    return dict(sorted(shapes.items())), carriers, tuple(skipped)


def _bottom_up(segmentation: Segmentation) -> list[int]:
    """Object numbers so that each comes after what it stands on."""
    numbers = [int(k) for k in np.unique(segmentation.labels) if k > 0]

    def level(k: int, seen: frozenset[int] = frozenset()) -> int:
        on = segmentation.supports.get(k, 0)
        return 0 if on == 0 or k in seen else 1 + level(on, seen | {k})

    return sorted(numbers, key=lambda k: (level(k), k))


def _carrier(frame: Frame, support: Support, segmentation: Segmentation, shapes: dict[int, FittedShape], k: int) -> int:
    """The fitted object that ``k`` stands on, 0 for the support.

    What the picture suggests is believed only if the carrier's solid lies below a good part of what is seen of ``k``:
    a foot that is merely hidden by a neighbour does not stand on it.
    """
    import shapely

    on = segmentation.supports.get(k, 0)
    if on not in shapes:
        return 0
    seen = support.X_WC.apply(frame.points[(segmentation.labels == k) & np.isfinite(frame.depth)])
    if not len(seen) or np.percentile(seen[:, 2], 5) < _top(shapes[on]) - SUNK:
        return 0
    below = shapely.MultiPoint(_footprint(shapes[on])).convex_hull.buffer(EDGE)
    return on if shapely.contains(below, shapely.points(seen[:, :2])).mean() >= CARRIED else 0


def _footprint(shape: FittedShape) -> NDArray[np.float64]:
    """Corners of a fitted shape seen from above, in world xy [m], shape (n, 2)."""
    return shape.X_WO.apply(_corners(shape.geometry))[:, :2]


def _top(shape: FittedShape) -> float:
    """Height of the highest point of a fitted shape above the support [m]."""
    return float(shape.X_WO.apply(_corners(shape.geometry))[:, 2].max())


def _corners(geometry: Geometry) -> NDArray[np.float64]:
    from simfoundry.scene.tessellate import tessellate

    return tessellate(geometry).vertices


def _names(
    frame: Frame,
    segmentation: Segmentation,
    shapes: dict[int, FittedShape],
    colors: dict[int, tuple[float, float, float]],
    given: dict[str, int],
) -> dict[int, str]:
    """A name for every object: the capture's own where it has one, else its colour and what it looks like."""
    wanted: dict[int, str] = {}
    if frame.instances is not None:
        for name, number in given.items():
            covered = segmentation.labels[(frame.instances == number) & (segmentation.labels > 0)]
            if len(covered):
                wanted[int(np.bincount(covered).argmax())] = name
    for k, shape in shapes.items():
        wanted.setdefault(k, f"{color_word(colors[k])}_{kind_of(shape.geometry, shape.hollow)}")
    return dict(zip(shapes, unique_names((wanted[k] for k in shapes), [SUPPORT_NAME]), strict=True))


def _support_spec(capture: str, support: Support, slab: Thickness) -> ObjectSpec:
    outline = tuple((_metres(x), _metres(y)) for x, y in support.outline)
    note = "thickness measured at its edge" if slab.measured else "thickness assumed: no edge was seen"
    return ObjectSpec(
        category="table",
        fixed=True,
        shape=PrismShape(prism=Prism(outline=outline, height=slab.value)),
        visual=f"meshes/{SUPPORT_NAME}.obj",
        material=SUPPORT.name,
        pose=PoseSpec(xyz=(0.0, 0.0, -slab.value / 2)),
        origin=Origin(capture=capture, fit=_metres(support.residual), note=note),
    )


def _object_spec(
    capture: str, name: str, shape: FittedShape, mesh: Mesh, substance: Substance, color: tuple[float, float, float]
) -> ObjectSpec:
    primitive = _shape_spec(shape)
    volume = mass.mesh(_corners(shape.geometry), _faces(shape.geometry)).volume
    kilograms = [_significant(volume * d) for d in (substance.density, substance.lowest, substance.highest)]
    low, high = min(kilograms[0], kilograms[1]), max(kilograms[0], kilograms[2])
    return ObjectSpec(
        category=kind_of(shape.geometry, shape.hollow).value,
        shape=primitive,
        asset=None if primitive is not None else f"meshes/{name}.obj",
        visual=f"meshes/{name}.obj" if primitive is not None else None,
        material=substance.name,
        color=_rgb(color) if mesh.texture is None else None,
        mass=Estimate(value=kilograms[0], range=(low, high), by="material_table"),
        pose=pose_spec(shape.X_WO),
        origin=Origin(capture=capture, fit=_metres(shape.fit_m), confidence=round(shape.confidence, 2)),
    )


def _shape_spec(shape: FittedShape) -> Shape | None:
    """The shape as a spec writes it, None where only a mesh can hold it."""
    geometry = shape.geometry
    if shape.profile is not None:
        return LatheShape(lathe=Lathe(profile=tuple((_metres(r), _metres(z)) for r, z in shape.profile)))
    match geometry:
        case Box():
            x, y, z = (_metres(v) for v in geometry.size)
            return BoxShape(box=(x, y, z))
        case Cylinder():
            return CylinderShape(cylinder=Round(radius=_metres(geometry.radius), height=_metres(geometry.height)))
        case Sphere():
            return SphereShape(sphere=_metres(geometry.radius))
    return None


def _faces(geometry: Geometry) -> NDArray[np.int32]:
    from simfoundry.scene.tessellate import tessellate

    return tessellate(geometry).faces


def _camera_spec(frame: Frame, support: Support) -> CameraSpec:
    height, width = frame.depth.shape
    X_WC: Pose = support.X_WC
    x, y, z = (_metres(v) for v in X_WC.p)
    qw, qx, qy, qz = (round(float(v), 6) for v in X_WC.q)
    return CameraSpec(
        size=(width, height),
        fx=round(float(frame.K[0, 0]), 3),
        fy=round(float(frame.K[1, 1]), 3),
        cx=round(float(frame.K[0, 2]), 3),
        cy=round(float(frame.K[1, 2]), 3),
        pose=CameraPose(xyz=(x, y, z), quat_wxyz=(qw, qx, qy, qz)),
    )


def _material(substance: Substance) -> Material:
    return Material(density=substance.density, friction=substance.friction)


def _mesh_files(name: str, mesh: Mesh) -> dict[str, bytes]:
    return {f"meshes/{path}": data for path, data in obj_with_material(mesh, name).items()}


def _metres(value: float) -> float:
    """A length to a tenth of a millimetre, finer than any sensor here."""
    return round(float(value), 4)


def _significant(value: float) -> float:
    return float(f"{value:.2g}")


def _rgb(color: tuple[float, float, float]) -> tuple[float, float, float]:
    r, g, b = (round(float(c), 2) for c in color)
    return r, g, b


__all__ = ["Kind", "Reconstruction", "reconstruct"]
