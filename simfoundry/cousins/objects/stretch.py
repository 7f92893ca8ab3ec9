"""A thing stretched along its axes: parts, frames of links and ways of joints together, so that all still fit.

All links must be turned alike at rest (no joint turns its child's frame), as in furniture; otherwise only a factor that
is the same along all three axes keeps them together.
"""

from __future__ import annotations

import numpy as np

from simfoundry.cousins.objects.parts import aimed, at, each, moved, parts_of, rod, shaped, with_rod
from simfoundry.geometry.frames import Array
from simfoundry.scene.poses import pose
from simfoundry.spec.models.asset import AssetSpec, JointSpec, PartSpec
from simfoundry.spec.models.base import BoxShape, LatheShape, PrismShape, Shape, SphereShape

SQUARE = 1e-6
"""A rotation whose matrix is this near to a permutation turns boxes onto the axes."""


def stretched(spec: AssetSpec, factor: Array) -> AssetSpec:
    """The asset with its x, y and z multiplied by ``factor``, shape (3,), the nearest that its shapes allow.

    What is round about z keeps x and y alike, a ball stays a ball; walls grow with the rest.
    """
    f = allowed(spec, factor)
    out = each(spec, lambda _, part: stretched_part(part, f))
    joints = {name: _joint(joint, f) for name, joint in spec.joints.items()}
    return out.model_copy(update={"joints": joints})


def allowed(spec: AssetSpec, factor: Array) -> Array:
    """The factor that the shapes of an asset allow, shape (3,)."""
    f = np.array(factor, dtype=np.float64)
    turned = any(not pose(joint.pose).is_identity and _turns(joint) for joint in spec.joints.values())
    if turned or is_ball(spec) or any(p.mesh is not None for p in parts_of(spec).values()):
        return np.full(3, float(np.cbrt(f.prod())))
    if any(_round_about_z(part) for part in parts_of(spec).values()):
        f[:2] = np.sqrt(f[0] * f[1])
    return f


def stretched_part(part: PartSpec, f: Array) -> PartSpec:
    """One part with the axes of its link multiplied by ``f``, shape (3,)."""
    there = moved(part, at(part) * f)
    if part.mesh is not None:
        return there.model_copy(update={"scale": part.scale * float(np.cbrt(f.prod()))})
    assert part.shape is not None
    turn = pose(part.pose).rotation
    local = np.abs(turn.T) @ f
    if not _is_square(turn):
        size = rod(part)
        if size is not None:
            return _leaning_rod(there, size, turn[:, 2], f)
        upright = abs(turn[2, 2]) > 1 - SQUARE and abs(f[0] - f[1]) < SQUARE
        local = np.array([f[0], f[1], f[2]]) if upright else np.full(3, float(np.cbrt(f.prod())))
    return shaped(there, _scaled(there.shape, local))


def _scaled(shape: Shape | None, f: Array) -> Shape:
    """A shape with its own axes multiplied by ``f``, shape (3,)."""
    x, y, z = (float(v) for v in f)
    across = float(np.sqrt(x * y))
    match shape:
        case BoxShape():
            a, b, c = shape.box
            return BoxShape(box=(a * x, b * y, c * z))
        case SphereShape():
            return SphereShape(sphere=shape.sphere * float(np.cbrt(x * y * z)))
        case LatheShape():
            rings = tuple((r * across, h * z) for r, h in shape.lathe.profile)
            return LatheShape.model_validate({"lathe": {"profile": rings}})
        case PrismShape():
            outline = tuple((u * x, v * y) for u, v in shape.prism.outline)
            return PrismShape.model_validate({"prism": {"outline": outline, "height": shape.prism.height * z}})
    part = PartSpec(shape=shape)
    size = rod(part)
    assert size is not None
    scaled = with_rod(part, size[0] * across, size[1] * z).shape
    assert scaled is not None
    return scaled


def _leaning_rod(part: PartSpec, size: tuple[float, float], axis: Array, f: Array) -> PartSpec:
    """A cylinder or capsule that lies across the axes: its ends go where the stretch takes them."""
    along = axis * f
    length = float(np.linalg.norm(along))
    thick = float(np.sqrt(f.prod() / length))
    there = with_rod(part, size[0] * thick, size[1] * length)
    return there.model_copy(update={"pose": aimed(at(there), along / length)})


def _joint(joint: JointSpec, f: Array) -> JointSpec:
    way = joint.pose.model_copy(update={"xyz": tuple(float(v) for v in np.array(joint.pose.xyz) * f)})
    changes: dict[str, object] = {"pose": way}
    if joint.limits is not None:
        axis = np.abs(np.array(joint.axis)) / np.linalg.norm(joint.axis)
        low, high = (float(v * (axis @ f)) for v in joint.limits)
        changes["limits"] = (low, high)
    return joint.model_copy(update=changes)


def _turns(joint: JointSpec) -> bool:
    return not _is_square(pose(joint.pose).rotation) or pose(joint.pose).rotation.trace() < 3 - SQUARE


def is_ball(spec: AssetSpec) -> bool:
    """Whether an asset is nothing but one ball."""
    every = list(parts_of(spec).values())
    return len(every) == 1 and isinstance(every[0].shape, SphereShape)


def _round_about_z(part: PartSpec) -> bool:
    """Whether it would no longer be what it is with another factor in x than in y."""
    turn = pose(part.pose).rotation
    if not _is_square(turn):
        return rod(part) is None
    upright = abs(turn[2, 2]) > 1 - SQUARE
    return (isinstance(part.shape, LatheShape) or rod(part) is not None) and upright


def _is_square(rotation: Array) -> bool:
    """Whether a rotation maps axes onto axes."""
    return bool((np.abs(np.abs(rotation).max(axis=0) - 1) < SQUARE).all())
