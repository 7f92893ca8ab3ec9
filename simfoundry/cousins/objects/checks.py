"""Check that a variant can replace the twin's object in its tasks."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, product
from types import MappingProxyType

import numpy as np

from simfoundry.assets import mass
from simfoundry.assets.mesh import open_edges, weld
from simfoundry.cousins.objects.appearance import CategoryPrior, category_prior
from simfoundry.cousins.recipe.candidate import Reason
from simfoundry.geometry.frames import Pose, frozen_array
from simfoundry.geometry.grasp_width import grasp_width
from simfoundry.geometry.shapes import Box, tessellate
from simfoundry.predicates import Judge
from simfoundry.predicates.judging.bodies import PredicateError
from simfoundry.robots.reach import hands_of
from simfoundry.scene.carriers import PlaceError
from simfoundry.scene.frames import FrameTree
from simfoundry.scene.lengths import length
from simfoundry.scene.model import Collider, Link, Scene, SceneObject, Visual
from simfoundry.scene.object_shapes import bounds, solid
from simfoundry.scene.place import solve
from simfoundry.scene.state import SceneState
from simfoundry.spec.check.checker import HEAVIEST, LIGHTEST
from simfoundry.spec.models.predicate import Call, Effect, parse_call, texts
from simfoundry.spec.models.scene import Place, SceneSpec
from simfoundry.spec.models.task import TaskSpec
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.rest import run_to_rest, tilt_deg
from simfoundry.worlds.settle import settle


@dataclass(frozen=True, eq=False)
class Needs:
    """The requirements that a variant must meet.

    Attributes:
        rests: `OnTop` and `Inside` calls that involve the object and must be satisfiable.
        joints: Names of the joints that must move.
        opening: Opening of the gripper that must grasp the object [m], or None if no gripper must grasp it.
        others: The other objects in the calls, by name.
    """

    rests: tuple[Call, ...] = ()
    joints: tuple[str, ...] = ()
    opening: float | None = None
    others: Mapping[str, SceneObject] = field(default_factory=lambda: MappingProxyType({}))


def needs_of(name: str, spec: SceneSpec, scene: Scene, tasks: Sequence[TaskSpec]) -> Needs:
    """Collect the requirements that tasks impose on an object.

    Args:
        name: Name of the object.
        spec: Document of the scene.
        scene: The lowered scene.
        tasks: The tasks.
    """
    goals = [goal for task in tasks for goal in (task.goal, *(step.goal for step in task.subtasks.values()))]
    calls = dict.fromkeys(parse_call(text) for goal in goals for text, path in texts(goal) if "not" not in path)
    mine = [c for c in calls if any(argument.partition(".")[0] == name for argument in c.args)]
    known = {item.name: item for item in scene.objects}
    rests = [
        c for c in mine if c.declaration.effect is Effect.PLACE and all(a.partition(".")[0] in known for a in c.args)
    ]
    carried = any(c.declaration.effect.grasps and c.args[0].partition(".")[0] == name for c in mine)
    joints = tuple(j.name for j in known[name].joints if j.has_axis and j.limits is not None)
    others = {o: known[o] for c in rests for a in c.args if (o := a.partition(".")[0]) != name}
    widths = [hand.opening for hand in hands_of(spec.robots, FrameTree(spec)) if hand.opening is not None]
    opening = max(widths, default=None) if carried else None
    return Needs(tuple(rests), joints, opening, MappingProxyType(others))


# Allowed range of the longest side relative to the twin's, if the category is unknown.
SCALE = (0.6, 1.6)

# Allowed range of the mass relative to the twin's, if the category is unknown.
WEIGHT = (0.25, 4.0)

# Clearance that a gripper requires in addition to the grasp width [m].
MARGIN = 0.003


@dataclass(frozen=True, eq=False)
class ObjectBaseline:
    """The twin's object and the requirements that it meets.

    Variants need to meet only these requirements.

    Attributes:
        item: The lowered object.
        needs: The requirements that the twin's object meets.
        lacks: Descriptions of the requirements that the twin's object does not meet.
        steady: True if the twin's object is stable on a table.
    """

    item: SceneObject
    needs: Needs
    lacks: tuple[str, ...]
    steady: bool

    @classmethod
    def of(cls, item: SceneObject, needs: Needs) -> ObjectBaseline:
        """Run the checks on the twin's object."""
        failures = {call: rest_failure(call, {**needs.others, item.name: item}) for call in needs.rests}
        lacks = [f"{call}: {why}" for call, why in failures.items() if why is not None]
        unstable = instability(item)
        if unstable is not None:
            lacks.append(f"stands: {unstable}")
        width, opening = grasp_width(solid(item)), needs.opening
        if opening is not None and width > opening - MARGIN:
            lacks.append(f"the object is {length(width)} wide, but the gripper only opens to {length(opening)}")
            opening = None
        rests = tuple(call for call, why in failures.items() if why is None)
        return cls(item, replace(needs, rests=rests, opening=opening), tuple(lacks), unstable is None)


def faults(item: SceneObject, twin: ObjectBaseline, category: str) -> Iterator[Reason]:
    """Yield the reasons for rejecting a lowered candidate. The cheapest checks are performed first."""
    yield from _open_meshes(item)
    yield from _size(item, twin.item, category_prior(category))
    opening = twin.needs.opening
    if opening is not None:
        width = grasp_width(solid(item))
        if width > opening - MARGIN:
            fits = math.isfinite(width)
            narrow = f"is {length(width)} wide at its narrowest" if fits else "cannot be grasped anywhere"
            text = f"it {narrow}, but the gripper only opens to {length(opening)}"
            yield Reason("grip", text, {"width": min(width, 1e3), "opening": opening})
    if twin.needs.joints:
        yield from _joint_faults(item, twin.item)
    if twin.steady and (why := instability(item)) is not None:
        yield Reason("stands", f"on a table, it {why}")
    for call in twin.needs.rests:
        if (why := rest_failure(call, {**twin.needs.others, item.name: item})) is not None:
            yield Reason("affordance", f"{call} no longer holds: {why}")


def _open_meshes(item: SceneObject) -> Iterator[Reason]:
    """Yield a reason if a visual or collision mesh is not closed or does not enclose a volume."""
    for link in item.links:
        pieces: tuple[Collider | Visual, ...] = (*link.colliders, *link.visuals)
        for piece in pieces:
            mesh = tessellate(piece.geometry, 12)
            vertices, faces = weld(mesh.vertices, mesh.faces)
            gaps, volume = open_edges(faces), mass.mesh(vertices, faces).volume if len(faces) else 0.0
            if gaps or volume <= 0:
                text = f"`{piece.name}` of `{link.name}` has {gaps} open edges and a volume of {volume:.3g} m^3"
                yield Reason("mesh", text, {"gaps": float(gaps), "volume": volume})
                return


def _size(item: SceneObject, twin: SceneObject, sort: CategoryPrior | None) -> Iterator[Reason]:
    """Yield a reason for each quantity (longest side, mass, density) that is outside the category's range.

    If the category is unknown, the ranges are relative to the twin's object.
    """
    low, high = bounds(item)
    twin_low, twin_high = bounds(twin)
    side, before = float((high - low).max()), float((twin_high - twin_low).max())
    weight, twin_weight = (sum(link.mass for link in one.links) for one in (item, twin))
    sizes = sort.size if sort is not None else (SCALE[0] * before, SCALE[1] * before)
    weights = sort.mass if sort is not None else (WEIGHT[0] * twin_weight, WEIGHT[1] * twin_weight)
    if not sizes[0] <= side <= sizes[1]:
        text = f"it is {length(side)} long, but objects of its kind are {length(sizes[0])} to {length(sizes[1])}"
        yield Reason("size", text, {"side": side, "least": sizes[0], "most": sizes[1]})
    if not weights[0] <= weight <= weights[1]:
        text = f"it weighs {weight:.3g} kg, but objects of its kind weigh {weights[0]:g} to {weights[1]:g} kg"
        yield Reason("mass", text, {"mass": weight, "least": weights[0], "most": weights[1]})
    density = weight / float(np.prod(high - low))
    if not LIGHTEST / 4 <= density <= HEAVIEST:
        yield Reason("mass", f"its mean density within its bounding box is {density:.3g} kg/m^3", {"density": density})


# Name of the table in a trial.
TABLE = "trial_table"
GRAVITY = frozen_array([0.0, 0.0, -9.81])

# Time over which objects at rest must not move [s], and maximum duration of a trial [s].
WINDOW_S, LONGEST_S = 0.25, 4.0

# Maximum tilt [deg] of an object that supports or contains another object after a trial.
MAX_TILT_DEG = 5.0

# How far joints are opened during a trial, as a fraction of their range.
OPENED = 0.95

# Number of positions per joint to test for jamming.
STEPS = 9

# Penetration depth [m] between links of the same object above which a joint is considered jammed.
DEEPEST = 0.001

# Minimum joint range of a variant as a fraction of the twin's joint range.
LEAST_RANGE = 0.75

# Orientations to try when one object is put into another, as roll, pitch and yaw [deg]: unchanged, rotated about z, and
# tilted in two directions.
TURNS = ((0.0, 0.0, 0.0), (0.0, 0.0, 90.0), (0.0, 90.0, 0.0), (90.0, 0.0, 0.0))


def instability(item: SceneObject) -> str | None:
    """Return the reason why an object on a table moves, or topples when tilted slightly.

    The result is None if the object is stable.
    """
    try:
        placed = _on_table(item)
    except PlaceError as error:
        return error.message
    with MujocoWorld(_scene(placed)) as world:
        return "; ".join(settle(world).objects[0].problems) or None


def rest_failure(call: Call, objects: Mapping[str, SceneObject]) -> str | None:
    """Return the reason why ``OnTop(a, b)`` or ``Inside(a, b)`` does not hold after ``a`` is released on or in ``b``.

    The joints of ``b`` are opened first. Then a few orientations of ``a`` are tried. The result is None if the
    predicate holds for at least one of them. ``objects`` contains both objects, keyed by name.
    """
    a, b = call.args[0], call.args[1].partition(".")[0]
    try:
        base = _on_table(_opened(objects[b]))
    except PlaceError as error:
        return error.message
    why: str | None = f"`{a}` could not be placed {'inside' if call.predicate == 'Inside' else 'on'} `{call.args[1]}`"
    for place in _places(call, base):
        try:
            X_WA = solve(objects[a], place, {base.name: base}, None)
        except PlaceError as error:
            why = error.message
            continue
        why = _release_failure(call, replace(objects[a], X_WO=X_WA, fixed=False), base)
        if why is None:
            break
    return why


def _places(call: Call, base: SceneObject) -> Iterator[Place]:
    low, high = bounds(base)
    inside = call.args[1] if call.predicate == "Inside" else None
    on = call.args[1] if inside is None else None
    for y, turn in product((0.0,), TURNS) if inside else product((0.0, 0.25, -0.25), TURNS[:2]):
        xy = (0.0, round(y * float(high[1] - low[1]), 4)) if y else None
        yield Place(on=on, inside=inside, rpy_deg=turn if any(turn) else None, local_xy=xy)


def _release_failure(call: Call, a: SceneObject, b: SceneObject) -> str | None:
    """Return the reason why a predicate does not hold after ``a`` is released and comes to rest.

    The result is None if the predicate holds.
    """
    scene = _scene(b, a)
    with MujocoWorld(scene) as world:
        run_to_rest(world, WINDOW_S, 0.0, LONGEST_S, lambda _: ())
        state = world.state()
    try:
        verdict = Judge(scene)(str(call), state)
    except PredicateError as error:
        return str(error)
    tilt = tilt_deg(b.X_WO, state.poses[b.name])
    if tilt > MAX_TILT_DEG:
        return f"`{b.name}` tilted by {tilt:.0f} deg"
    return None if verdict.value else verdict.why


def _joint_faults(item: SceneObject, twin: SceneObject) -> Iterator[Reason]:
    """Yield a reason if a joint has a much smaller range than in the twin or if the links jam."""
    limits = {joint.name: joint.limits for joint in twin.joints if joint.limits is not None}
    for joint in item.joints:
        if joint.limits is None or joint.name not in limits:
            continue
        span, before = (high - low for low, high in (joint.limits, limits[joint.name]))
        if span < LEAST_RANGE * before:
            text = f"`{joint.name}` has a range of {span:.3f}, compared to {before:.3f} in the twin"
            yield Reason("joint", text, {"range": span, "twin": before})
            return
    deepest, where = _jam(item)
    if deepest > DEEPEST and deepest > _jam(twin)[0] + 1e-4:
        yield Reason("joint", f"its links overlap by {deepest * 1000:.1f} mm with {where}", {"overlap": deepest})


def _jam(item: SceneObject) -> tuple[float, str]:
    """Return the depth of the deepest penetration between links of an object and a description of the joint positions.

    The depth is in meters. Each joint is moved over its entire range while the other joints stay closed.
    """
    import mujoco

    worst, where = 0.0, "every joint closed"
    alone = replace(item, X_WO=Pose.of(), fixed=True)
    with MujocoWorld(_scene(alone)) as world:
        model, data = world.model, world.data
        bodies = {model.body(item.qualified(link.name)).id for link in item.links}
        geoms = [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in bodies and model.geom_contype[g]]
        pairs = [(g, h) for g, h in combinations(geoms, 2) if model.geom_bodyid[g] != model.geom_bodyid[h]]
        for joint in item.joints:
            if joint.limits is None:
                continue
            for position in np.linspace(*joint.limits, STEPS):
                world.reset(SceneState.of({}, {f"{item.name}.{joint.name}": float(position)}))
                for g, h in pairs:
                    distance = mujoco.mj_geomDistance(model, data, g, h, 1e-3, None)
                    if -distance > worst:
                        worst, where = -distance, f"`{joint.name}` at {position:.3f}"
    return worst, where


def _opened(item: SceneObject) -> SceneObject:
    """Return the object with its joints opened for a trial."""
    at = {j.name: j.limits[0] + OPENED * (j.limits[1] - j.limits[0]) for j in item.joints if j.limits is not None}
    return replace(item, joints=tuple(replace(j, position=at.get(j.name, j.position)) for j in item.joints))


def _on_table(item: SceneObject) -> SceneObject:
    """Return an object placed on the table.

    Raises:
        PlaceError: The object cannot be placed.
    """
    free = replace(item, fixed=False, variants=())
    return replace(free, X_WO=solve(free, Place(on=TABLE, local_xy=(0.0, 0.0)), {TABLE: _table()}, None))


def _scene(*items: SceneObject) -> Scene:
    return Scene("trial", GRAVITY, (_table(), *items))


def _table() -> SceneObject:
    """Return a wide table whose top is at z = 0."""
    box, middle, inertia = Box(frozen_array([3.0, 3.0, 0.1])), frozen_array(np.zeros(3)), frozen_array(np.eye(3))
    visual, collider = Visual("top", box, frozen_array([0.7, 0.7, 0.7, 1.0])), Collider("top", box, 0.5, 0.1)
    link = Link("base", 100.0, middle, inertia, (visual,), (collider,))
    return SceneObject(TABLE, "table", True, Pose.of([0.0, 0.0, -0.05]), (link,))
