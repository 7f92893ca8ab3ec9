"""Check that a variant can serve the same functions in the tasks as the twin's object."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
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
from simfoundry.scene.lengths import length
from simfoundry.scene.model import Collider, Link, Scene, SceneObject, Visual
from simfoundry.scene.object_shapes import bounds, solid
from simfoundry.scene.place import PlaceError, solve
from simfoundry.scene.state import SceneState
from simfoundry.spec.check.checker import HEAVIEST, LIGHTEST
from simfoundry.spec.models.predicate import Call, Effect, parse_call, texts
from simfoundry.spec.models.scene import Place, SceneSpec
from simfoundry.spec.models.task import TaskSpec
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.settle import settle


@dataclass(frozen=True, eq=False)
class Needs:
    """The requirements on a variant.

    Attributes:
        rests: `OnTop` and `Inside` calls that involve the object and must be possible.
        joints: Names of the joints that must move.
        opening: Opening of the gripper that must grasp the object [m], or None.
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
    widths = [hand.opening for hand in hands_of(spec.robots) if hand.opening is not None]
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
    """The twin's object and the requirements that it meets itself; variants must meet only these.

    Attributes:
        item: The lowered object.
        needs: The original requirements.
        rests: Calls that hold in trials with the twin's object.
        lacks: Descriptions of requirements that the twin's object does not meet.
        steady: True if the twin's object stands stably on a table.
        opening: Opening of the gripper [m], or None if grasping is not required or impossible for the twin's object.
    """

    item: SceneObject
    needs: Needs
    rests: tuple[Call, ...]
    lacks: tuple[str, ...]
    steady: bool
    opening: float | None

    @classmethod
    def of(cls, item: SceneObject, needs: Needs) -> ObjectBaseline:
        """Run the checks on the twin itself."""
        kept, lacks = [], []
        for call in needs.rests:
            outcome = rests(call, {**needs.others, item.name: item})
            if outcome.passed:
                kept.append(call)
            else:
                lacks.append(f"{call}: {outcome.why}")
        steady = stands(item)
        if not steady.passed:
            lacks.append(f"stands: {steady.why}")
        width = grasp_width(solid(item))
        opening = needs.opening
        if opening is not None and width > opening - MARGIN:
            lacks.append(f"the object is {length(width)} wide, but the gripper opens only {length(opening)}")
            opening = None
        return cls(item, needs, tuple(kept), tuple(lacks), steady.passed, opening)


def faults(item: SceneObject, twin: ObjectBaseline, category: str) -> Iterator[Reason]:
    """Yield the reasons for rejecting a lowered candidate, starting with the cheapest checks."""
    yield from _open_meshes(item)
    yield from _size(item, twin.item, category_prior(category))
    if twin.opening is not None:
        width = grasp_width(solid(item))
        if width > twin.opening - MARGIN:
            fits = math.isfinite(width)
            narrow = f"is {length(width)} wide at its narrowest" if fits else "cannot be grasped anywhere"
            text = f"it {narrow}, but the gripper opens only {length(twin.opening)}"
            yield Reason("grip", text, {"width": min(width, 1e3), "opening": twin.opening})
    jam = moves(item, twin.item) if twin.needs.joints else None
    if jam is not None:
        yield jam
    if twin.steady:
        outcome = stands(item)
        if not outcome.passed:
            yield Reason("stands", f"on a table, it {outcome.why}")
    for call in twin.rests:
        outcome = rests(call, {**twin.needs.others, item.name: item})
        if not outcome.passed:
            yield Reason("affordance", f"{call} no longer holds: {outcome.why}")


def _open_meshes(item: SceneObject) -> Iterator[Reason]:
    """Yield a reason if a visual or collision mesh is not closed or does not enclose a volume."""
    for link in item.links:
        pieces: tuple[Collider | Visual, ...] = (*link.colliders, *link.visuals)
        for piece in pieces:
            mesh = tessellate(piece.geometry, 12)
            vertices, faces = weld(mesh.vertices, mesh.faces)
            gaps = open_edges(faces)
            volume = mass.mesh(vertices, faces).volume if len(faces) else 0.0
            if gaps or volume <= 0:
                text = f"`{piece.name}` of `{link.name}` has {gaps} open edges and a volume of {volume:.3g} m^3"
                yield Reason("mesh", text, {"gaps": float(gaps), "volume": volume})
                return


def _size(item: SceneObject, twin: SceneObject, sort: CategoryPrior | None) -> Iterator[Reason]:
    """Check the longest side, mass and density against the category's ranges.

    If the category is unknown, the ranges are relative to the twin's object.
    """
    low, high = bounds(item)
    side = float((high - low).max())
    weight = sum(link.mass for link in item.links)
    twin_low, twin_high = bounds(twin)
    before = float((twin_high - twin_low).max()), sum(link.mass for link in twin.links)
    sizes = sort.size if sort is not None else (SCALE[0] * before[0], SCALE[1] * before[0])
    weights = sort.mass if sort is not None else (WEIGHT[0] * before[1], WEIGHT[1] * before[1])
    if not sizes[0] <= side <= sizes[1]:
        text = f"it is {length(side)} long, but objects of its kind are {length(sizes[0])} to {length(sizes[1])}"
        yield Reason("size", text, {"side": side, "least": sizes[0], "most": sizes[1]})
    if not weights[0] <= weight <= weights[1]:
        text = f"it weighs {weight:.3g} kg, but objects of its kind weigh {weights[0]:g} to {weights[1]:g} kg"
        yield Reason("mass", text, {"mass": weight, "least": weights[0], "most": weights[1]})
    density = weight / float(np.prod(high - low))
    if not LIGHTEST / 4 <= density <= HEAVIEST:
        yield Reason("mass", f"its mean density within its bounds is {density:.3g} kg/m^3", {"density": density})


TABLE = "trial_table"
GRAVITY = frozen_array([0.0, 0.0, -9.81])

# Speed below which an object is at rest [m/s], maximum duration of a trial [s], and interval between checks [s].
STILL, LONGEST, LOOK = 0.01, 4.0, 0.25

# How far joints are opened during a trial, as a fraction of their range.
OPENED = 0.95

# Number of positions per joint to test for jamming.
STEPS = 9

# Penetration depth between links of the same object above which a joint is considered jammed [m].
DEEPEST = 0.001

# Minimum joint range of a variant as a fraction of the twin's joint range.
LEAST_RANGE = 0.75

# Orientations in which to put an object into another, as roll, pitch and yaw [deg]: unchanged, rotated about z, and
# tilted in two directions.
TURNS = ((0.0, 0.0, 0.0), (0.0, 0.0, 90.0), (0.0, 90.0, 0.0), (90.0, 0.0, 0.0))


@dataclass(frozen=True)
class TrialOutcome:
    """The result of a trial; ``why`` explains it with numbers."""

    passed: bool
    why: str


def stands(item: SceneObject) -> TrialOutcome:
    """Test whether an object on a table stays in place and does not topple when tilted slightly."""
    placed = _on_table(item)
    if isinstance(placed, TrialOutcome):
        return placed
    with MujocoWorld(_scene(placed)) as world:
        report = settle(world).objects[0]
    return TrialOutcome(report.passed, "; ".join(report.problems) or f"moved {report.drift * 1000:.1f} mm")


def rests(call: Call, things: Mapping[str, SceneObject]) -> TrialOutcome:
    """Test whether ``OnTop(a, b)`` or ``Inside(a, b)`` holds after ``a`` is released on or in ``b``.

    A few orientations of ``a`` are tried, and the joints of ``b`` are opened first. ``things`` contains both objects by
    name.
    """
    a, b = call.args[0], call.args[1].partition(".")[0]
    base = _on_table(_opened(things[b]))
    if isinstance(base, TrialOutcome):
        return base
    why = f"`{a}` could not be placed {'inside' if call.predicate == 'Inside' else 'on'} `{call.args[1]}`"
    for place in _places(call, base):
        try:
            X_WA = solve(things[a], place, {base.name: base}, None)
        except PlaceError as error:
            why = error.message
            continue
        outcome = _let_go(call, replace(things[a], X_WO=X_WA, fixed=False), base)
        if outcome.passed:
            return outcome
        why = outcome.why
    return TrialOutcome(False, why)


def _places(call: Call, base: SceneObject) -> Iterator[Place]:
    inside = call.predicate == "Inside"
    low, high = bounds(base)
    sides = (0.0, 0.25, -0.25) if not inside else (0.0,)
    for y in sides:
        for turn in TURNS if inside else TURNS[:2]:
            local_xy = None if y == 0 else (0.0, round(y * float(high[1] - low[1]), 4))
            rpy = turn if any(turn) else None
            place = Place(inside=call.args[1], rpy_deg=rpy) if inside else Place(on=call.args[1], rpy_deg=rpy)
            yield place if local_xy is None else place.model_copy(update={"local_xy": local_xy})


def _let_go(call: Call, a: SceneObject, b: SceneObject) -> TrialOutcome:
    scene = _scene(b, a)
    with MujocoWorld(scene) as world:
        state = _calmed(world)
        try:
            verdict = Judge(scene)(str(call), state)
        except PredicateError as error:
            return TrialOutcome(False, str(error))
        tilt = state.poses[b.name].rotation[2, 2]
    if tilt < np.cos(np.radians(5.0)):
        return TrialOutcome(False, f"`{b.name}` tilted by {np.degrees(np.arccos(np.clip(tilt, -1, 1))):.0f} deg")
    return TrialOutcome(verdict.value, verdict.why)


def _calmed(world: MujocoWorld) -> SceneState:
    """Simulate until nothing moves anymore, for at most :data:`LONGEST` seconds, and return the state."""
    steps = max(1, round(LOOK / world.timestep))
    for _ in range(round(LONGEST / LOOK)):
        world.step(steps)
        state = world.state()
        if max(state.speeds.values(), default=0.0) < STILL:
            break
    return state


def moves(item: SceneObject, twin: SceneObject) -> Reason | None:
    """Return a reason if a joint has a much smaller range than the twin's or jams along its path, else None."""
    for joint in item.joints:
        own = next((j for j in twin.joints if j.name == joint.name), None)
        if joint.limits is None or own is None or own.limits is None:
            continue
        span, before = (limits[1] - limits[0] for limits in (joint.limits, own.limits))
        if span < LEAST_RANGE * before:
            text = f"`{joint.name}` has a range of {span:.3f}, compared to {before:.3f} in the twin"
            return Reason("joint", text, {"range": span, "twin": before})
    deepest, where = _jam(item)
    if deepest > DEEPEST and deepest > _jam(twin)[0] + 1e-4:
        text = f"its links overlap by {deepest * 1000:.1f} mm with {where}"
        return Reason("joint", text, {"overlap": deepest})
    return None


def _jam(item: SceneObject) -> tuple[float, str]:
    """Return the deepest penetration between links of an object [m] over the range of each joint.

    The second value describes the joint position at which it occurs.
    """
    import mujoco

    worst, where = 0.0, "every joint closed"
    alone = replace(item, X_WO=Pose.of(), fixed=True)
    with MujocoWorld(_scene(alone)) as world:
        model, data = world.model, world.data
        ids = {link.name: model.body(item.qualified(link.name)).id for link in item.links}
        bodies = {k: name for name, k in ids.items()}
        geoms = [g for g in range(model.ngeom) if int(model.geom_bodyid[g]) in bodies and model.geom_contype[g]]
        pairs = [(g, h) for g in geoms for h in geoms if g < h and model.geom_bodyid[g] != model.geom_bodyid[h]]
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
    joints = tuple(
        replace(j, position=j.limits[0] + OPENED * (j.limits[1] - j.limits[0])) if j.limits is not None else j
        for j in item.joints
    )
    return replace(item, joints=joints)


def _on_table(item: SceneObject) -> SceneObject | TrialOutcome:
    free = replace(item, fixed=False, variants=())
    try:
        X_WO = solve(free, Place(on=TABLE, local_xy=(0.0, 0.0)), {TABLE: _table()}, None)
    except PlaceError as error:
        return TrialOutcome(False, error.message)
    return replace(free, X_WO=X_WO)


def _scene(*items: SceneObject) -> Scene:
    return Scene("trial", GRAVITY, (_table(), *items))


def _table() -> SceneObject:
    """Return a wide table whose top is at z = 0."""
    box, middle, inertia = Box(frozen_array([3.0, 3.0, 0.1])), frozen_array(np.zeros(3)), frozen_array(np.eye(3))
    visual, collider = Visual("top", box, frozen_array([0.7, 0.7, 0.7, 1.0])), Collider("top", box, 0.5, 0.1)
    link = Link("base", 100.0, middle, inertia, (visual,), (collider,))
    return SceneObject(TABLE, "table", True, Pose.of([0.0, 0.0, -0.05]), (link,))
