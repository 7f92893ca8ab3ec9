"""Verdicts by bounds, as lints ask for them, are those by exact distances."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path

import numpy as np
import pytest

from simfoundry.lint.draft import drafted
from simfoundry.predicates import Judge, PredicateError
from simfoundry.scene.lower import lower
from simfoundry.scene.state import SceneState
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.load import load
from simfoundry.spec.models.predicate import built_in_predicates, parse_call
from tests.lint.scenes import BOWL, written

SHAPES = {
    "bowl": BOWL,
    "box": "shape: {box: [0.09, 0.05, 0.03]}",
    "ball": "shape: {sphere: 0.03}",
    "tin": "shape: {cylinder: {radius: 0.03, height: 0.05}}",
    "pen": "shape: {capsule: {radius: 0.008, height: 0.12}}",
}
NAMES = (*SHAPES, "desk")
EYE = """\
cameras: {eye: {size: [64, 48], fx: 60, fy: 60, pose: {xyz: [-1, 0.7, 0.8], look_at: [0, 0, 0]}}}
viewpoint: eye
"""

ROUNDING = 1e-6
"""Verdicts may differ where the margin [m] is no more than engines' own rounding."""


def random_scene(folder: Path, rng: np.random.Generator) -> Path:
    """Five things on, in, over and beside each other; some are put where they are, some posed."""
    lines = []
    for k, (name, shape) in enumerate(SHAPES.items()):
        x, y = rng.uniform(-0.12, 0.12, 2).round(3)
        if k and rng.random() < 0.25:
            carrier = rng.choice(["desk", "bowl", "box"]) if name != "box" else "desk"
            where = f"place: {{on: {carrier}, local_xy: [{x / 4:.3f}, {y / 4:.3f}]}}"
        elif k and rng.random() < 0.15:
            where = f"place: {{inside: bowl, local_xy: [{x / 20:.3f}, {y / 20:.3f}]}}"
        else:
            z = 0.0 if name == "bowl" and rng.random() < 0.7 else rng.uniform(-0.02, 0.12)
            angles = rng.uniform(-180, 180, 3) if rng.random() < 0.4 else [0, 0, rng.uniform(-180, 180)]
            angles = [float(v) for v in np.round(angles, 1)]
            where = f"pose: {{xyz: [{x}, {y}, {z:.4f}], rpy_deg: {angles}}}"
        lines += [f"{name}:", f"  {shape}", "  density: 500", f"  {where}"]
    return written(
        folder, "\n".join(lines), EYE if rng.random() < 0.5 else "", f"scene{rng.integers(10**9)}.scene.yaml"
    )


def calls(rng: np.random.Generator, state: SceneState) -> list[str]:
    texts = []
    for name, predicate in built_in_predicates().items():
        match predicate.parameters[:2]:
            case ("thing", "thing") | ("body", "body"):
                texts += [f"{name}({a}, {b})" for a, b in permutations(NAMES, 2)]
            case ("thing", "number"):
                near = {
                    n: x.p + rng.choice([0.0, 0.01, 0.05, 0.3]) * rng.normal(size=3) for n, x in state.poses.items()
                }
                texts += [f"At({n}, {p[0]:.4f}, {p[1]:.4f}, {p[2]:.4f})" for n, p in near.items()]
            case ("joint",):
                pass
            case _:
                texts += [f"{name}({a})" for a in NAMES]
    return texts


@pytest.mark.parametrize("seed", range(24))
def test_bounds_decide_as_distances_do(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    loaded = load(random_scene(tmp_path, rng))
    assert loaded.errors == []
    try:
        scene = lower(loaded)
    except SpecError as error:  # a place that does not fit, which the draft finds as well
        assert "SF210" in str(error)
        with pytest.raises(SpecError) as same:
            drafted(loaded)
        assert str(same.value) == str(error)
        return
    draft, measure, state = drafted(loaded), Judge(scene), SceneState.initial(scene)
    decide = Judge(draft.scene, bounds_first=True)
    wrong = []
    for text in calls(rng, state):
        names = {arg.partition(".")[0] for arg in parse_call(text).args}
        if "pen" in names and names & {"desk", "box"} and draft.distance("pen", min(names - {"pen"}), 0.0) <= 0:
            continue  # MuJoCo's own function for a capsule within a box is approximate
        try:
            found = measure(text, state)
        except PredicateError:  # nothing can be inside a solid thing
            continue
        if decide(text, state).value is not found.value and abs(found.margin) > ROUNDING:
            wrong.append(f"{text}: {found.margin:+.6f}, {found.why}")
    assert wrong == []
