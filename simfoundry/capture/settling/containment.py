"""Relations ``Inside`` of a scene at rest: which containers hold which objects."""

from __future__ import annotations

from simfoundry.predicates import Judge, PredicateError
from simfoundry.scene.lower import pose
from simfoundry.scene.model import Scene
from simfoundry.scene.object_shapes import world_bounds
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.predicate import parse_call
from simfoundry.spec.models.scene import SceneSpec

# Minimum margin [m] by which a relation must hold to be stated: poses are rounded by 0.1 mm when they are written, and
# other engines let an object sink in by less than this.
CLEAR = 5e-4


def with_containers(spec: SceneSpec, scene: Scene) -> SceneSpec:
    """Return the spec with the relations ``Inside`` that hold in it, before the ``OnTop`` of the same object.

    The predicate decides, so that half of an object must be in the cavity: a can in a tray is on the tray only.

    Args:
        spec: A scene at rest, with ``OnTop`` relations.
        scene: The scene as lowered, whose poses may be others.
    """
    state = SceneState.of({name: pose(item.pose) for name, item in spec.objects.items()}, {})
    judge = Judge(scene)
    bounds = {o.name: world_bounds(o, state.poses[o.name]) for o in scene.objects}
    found: dict[str, list[str]] = {}
    for upper in (o.name for o in scene.objects if not o.fixed):
        base, middle = bounds[upper][0][2], (bounds[upper][0] + bounds[upper][1]) / 2
        for lower in (name for name in bounds if name != upper):
            low, high = bounds[lower]
            is_above = ((low < middle) & (middle < high))[:2].all()
            if is_above and base < high[2] - CLEAR and _is_inside(judge, state, upper, lower):
                found.setdefault(upper, []).append(f"Inside({upper}, {lower})")
    relations: list[str] = []
    for text in spec.relations:
        relations += [*found.pop(parse_call(text).args[0], ()), text]
    rest = [text for texts in found.values() for text in texts]
    return spec.model_copy(update={"relations": (*relations, *rest)})


def _is_inside(judge: Judge, state: SceneState, upper: str, lower: str) -> bool:
    try:
        verdict = judge(f"Inside({upper}, {lower})", state)
    except PredicateError:  # an object without a shape to measure
        return False
    return verdict.value and verdict.margin > CLEAR
