"""BDDL in and out: quantifiers against a brute-force reading, names, regions, round trips, and what is missing."""

from __future__ import annotations

import itertools
import random
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from simfoundry.frontends.bddl.problem import BddlGroup, ConditionReader, read_group, read_problem
from simfoundry.frontends.draft import ImportOptions
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.importer import import_file
from simfoundry.frontends.task_export import TaskExportError, export_task
from simfoundry.scene.lower import lower_file
from simfoundry.spec.load import load_kind
from simfoundry.spec.models.task import TaskSpec
from tests.cli.command import run
from tests.conftest import REPOSITORY
from tests.frontends.bddl.scenes import write_scene

TASKS = REPOSITORY / "specs" / "tasks"
LIBERO = """(define (problem LIBERO_Kitchen_Tabletop_Manipulation)
  (:domain robosuite)
  (:language Put the bowl on the plate)
  (:regions
    (bowl_region (:target table) (:ranges ((-0.1 -0.02 -0.06 0.02))) (:yaw_rotation ((0.5 0.7))))
    (goal_region (:target table) (:ranges ((0.1 0.1 0.2 0.3))))
    (top_region (:target cabinet_1))
    (bottom_region (:target cabinet_1))
  )
  (:fixtures table - table cabinet_1 - wooden_cabinet)
  (:objects bowl_1 bowl_2 - bowl plate_1 - plate)
  (:init (On bowl_1 table_bowl_region) (Open cabinet_1_top_region) (Turnon plate_1))
  (:goal GOAL)
)
"""


def _imported(tmp_path: Path, goal: str, text: str = LIBERO, name: str = "x.bddl") -> TaskSpec:
    file = tmp_path / name
    file.write_text(text.replace("GOAL", goal))
    scene = write_scene(read_problem(file), tmp_path)
    import_file(file, tmp_path / "x.task.yaml", ImportOptions(scene=scene, force=True))
    return _task(tmp_path / "x.task.yaml")


def _task(path: Path) -> TaskSpec:
    spec = load_kind(path, "task/1").spec
    assert isinstance(spec, TaskSpec)
    return spec


def _refused(tmp_path: Path, goal: str) -> str:
    with pytest.raises(ImportRefusedError) as error:
        _imported(tmp_path, goal)
    return str(error.value)


def _holds(condition: Any, facts: Mapping[str, bool]) -> bool:
    """Whether one of our conditions holds where these predicates do."""
    if isinstance(condition, str):
        return facts[condition]
    ((key, below),) = condition.items()
    if key == "not":
        return not _holds(below, facts)
    return {"all": all, "any": any}[key](_holds(item, facts) for item in below)


def _truth(group: BddlGroup, scope: dict[str, str], kinds: Mapping[str, list[str]], facts: Mapping[str, bool]) -> bool:
    """What BEHAVIOR's own evaluation says, written from its definition: counts over all things of a type."""
    below = group.groups
    if group.head in ("and", "or"):
        return {"and": all, "or": any}[group.head](_truth(g, scope, kinds, facts) for g in below)
    if group.head == "not":
        return not _truth(below[0], scope, kinds, facts)
    if group.head == "imply":
        return not _truth(below[0], scope, kinds, facts) or _truth(below[1], scope, kinds, facts)
    if group.head in ("forall", "exists", "forn", "forpairs", "fornpairs"):
        *ranges, body = below
        count = int(ranges.pop(0).head) if group.head.startswith("forn") else 0
        named = [[item.plain for item in r.items] for r in ranges]  # type: ignore[union-attr]
        domains = [[(variable, thing) for thing in kinds[kind]] for variable, _, kind in named]
        if len(domains) == 1:
            each = [_truth(body, {**scope, v: t}, kinds, facts) for v, t in domains[0]]
            return {"forall": all(each), "exists": any(each), "forn": sum(each) == count}[group.head]
        table = {
            (a, b): _truth(body, {**scope, v: a, w: b}, kinds, facts)
            for (v, a), (w, b) in itertools.product(*domains)
            if a != b
        }
        if group.head == "fornpairs":
            return sum(table.values()) == count
        sides = [sum(any(v for k, v in table.items() if k[i] == t) for _, t in domains[i]) for i in range(2)]
        return min(sides) >= min(len(domain) for domain in domains)
    return facts[f"{group.head}({', '.join(scope.get(w.plain, w.plain) for w in group.words)})"]


@pytest.mark.parametrize(
    "text",
    [
        "(forall (?a - cup) (exists (?p - plate) (p ?a ?p)))",
        "(forn (2) (?a - cup) (q ?a))",
        "(fornpairs (2) (?a - cup) (?p - plate) (p ?a ?p))",
        "(forpairs (?a - cup) (?p - plate) (p ?a ?p))",
        "(forpairs (?p - plate) (?a - cup) (p ?a ?p))",
        "(forpairs (?a - cup) (?b - cup) (r ?a ?b))",
        "(imply (q c1) (and (not (q c2)) (or (q c3) (p c1 p1))))",
        "(forall (?a - cup) (imply (q ?a) (forn (1) (?p - plate) (p ?a ?p))))",
    ],
)
def test_quantifiers_mean_what_behavior_means(tmp_path: Path, text: str) -> None:
    (tmp_path / "goal").write_text(text)
    group = read_group(tmp_path / "goal")
    kinds = {"cup": ["c1", "c2", "c3"], "plate": ["p1", "p2"]}
    names: set[str] = set()

    def atom(_: BddlGroup, name: str, words: list[str]) -> str:
        names.add(f"{name}({', '.join(words)})")
        return f"{name}({', '.join(words)})"

    reading = ConditionReader(atom, kinds)
    condition = reading.condition(group, {})
    assert condition is not None and not reading.missing
    rng = random.Random(5)
    seen = set()
    for _ in range(300):
        facts = {name: rng.random() < 0.5 for name in sorted(names)}
        expected = _truth(group, {}, kinds, facts)
        seen.add(expected)
        assert _holds(condition, facts) == expected
    assert len(seen) == 2 or text.startswith("(forall (?a - cup) (imply")


def test_names_regions_and_starts_of_libero(tmp_path: Path) -> None:
    spec = _imported(
        tmp_path, "(And (On bowl_1 plate_1) (In bowl_2 cabinet_1_bottom_region) (Close cabinet_1_top_region))"
    )
    assert spec.instruction == "Put the bowl on the plate"
    assert spec.goal.model_dump()["all"] == (  # type: ignore[union-attr]
        "OnTop(bowl_1, plate_1)", "Inside(bowl_2, cabinet_1.bottom_link)", "Closed(cabinet_1.top_joint)"
    )  # fmt: skip
    assert spec.start.joints == {"cabinet_1": {"top_joint": -0.2}}
    region = spec.reset.objects["bowl_1"]  # the table of the scene stands at (0.3, -0.1) and is turned by 90 degrees
    assert (*region.x, *region.y) == pytest.approx((0.28, 0.32, -0.2, -0.16))
    assert region.yaw_deg == pytest.approx((28.6479, 40.107), abs=1e-3)


def test_a_goal_region_is_a_point_and_says_so(tmp_path: Path) -> None:
    spec = _imported(tmp_path, "(And (On bowl_1 table_goal_region))")
    assert spec.goal == "At(bowl_1, 0.1, 0.05)"


def test_on_where_the_words_say_in_counts_inside_too(tmp_path: Path) -> None:
    text = LIBERO.replace("on the plate", "in the plate")
    goal = _imported(tmp_path, "(On bowl_1 plate_1)", text).goal
    assert goal.model_dump() == {"any": ("OnTop(bowl_1, plate_1)", "Inside(bowl_1, plate_1)")}  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("goal", "said"),
    [
        ("(And (Turnon plate_1))", "line 13: the predicate `turnon` is not supported"),
        ("(And (On spoon_1 plate_1) (On fork_1 plate_1))", "2 items are missing: line 13: the scene has no object"),
        ("(And (Open plate_1))", "`plate_1` has no joint that can be opened"),
        ("(And)", "the goal is empty"),
        ("(And (forall (?x - spoon) (On ?x plate_1)))", "no object has this variable's type"),
        ("(And (forn (3) (?x - bowl) (On ?x plate_1)))", "exactly 3 conditions must be true, but there are only 2"),
        ("(And (In bowl_1 cabinet_1_middle_region))", "the scene has no object `cabinet_1_middle_region`"),
    ],
)
def test_what_is_missing_is_said_with_its_line(tmp_path: Path, goal: str, said: str) -> None:
    assert said in _refused(tmp_path, goal)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("(define (problem x)", "1: this parenthesis is never closed"),
        ("(define (problem x) (:goal (and)))\n)", "2: unmatched closing parenthesis"),
        ("", "the file is empty"),
        ("(define (problem x))", "the problem has no `(:goal"),
        ("(define (problem x) (:goal (a)) (:goal (b)))", "there is more than one `:goal` section"),
        ("(define (problem x) (:goal (a b) (c d)))", "the goal must be a single condition"),
        ("(" * 100, "nested more than 64 levels deep"),
        ("(define (problem x) (:objects a -) (:goal (a)))", "`-` must be placed between names and their type"),
        ("(define (problem x) (:regions (r (:target t) (:ranges ((1 2 x 4))))) (:goal (a)))", "4 numbers"),
    ],
)
def test_a_broken_file_is_answered_with_its_line(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "x.bddl").write_text(text)
    with pytest.raises(ImportRefusedError) as error:
        read_problem(tmp_path / "x.bddl")
    assert said in str(error.value) and "x.bddl" in str(error.value)


def test_names_can_be_bound_by_hand(tmp_path: Path) -> None:
    file, scene = tmp_path / "x.bddl", tmp_path / "scene.scene.yaml"
    file.write_text(LIBERO.replace("GOAL", "(On bowl_1 plate_1)"))
    write_scene(read_problem(file), tmp_path)
    file.write_text(file.read_text().replace("bowl_1", "dish").replace("(:init", "(:init ; nothing\n"))
    scene.write_text(scene.read_text().replace("category: bowl", "category: basin").replace("bowl_", "basin_"))
    result = run("import", file, "-o", tmp_path / "x.task.yaml", "--scene", scene)
    assert result.code == 2 and "the scene has no object `dish` (a bowl)" in result.err
    result = run("import", file, "-o", tmp_path / "x.task.yaml", "--scene", scene, "--bind", "dish=basin_2")
    assert result.code == 0, result.err
    assert _task(tmp_path / "x.task.yaml").goal == "OnTop(basin_2, plate_1)"


def _said(condition: Any, whole: bool, released: bool) -> set[str]:
    """The predicates of a conjunction; of whole objects only, and without what BDDL leaves out, where that is meant."""
    if not isinstance(condition, str):
        return set().union(*(_said(item, whole, released) for item in condition.all))
    if condition.startswith("Released") and not released:
        return set()
    return {re.sub(r"\.\w+", "", condition) if whole else condition}


@pytest.mark.parametrize("name", ["store_marker", "serve_fruits", "cup_in_bowl", "stack_dishware", "throw_away_trash"])
@pytest.mark.parametrize("format_", ["libero", "behavior", "omnigibson"])
def test_a_task_goes_out_and_comes_back(tmp_path: Path, name: str, format_: str) -> None:
    shutil.copytree(REPOSITORY / "specs", tmp_path / "specs", ignore=shutil.ignore_patterns("captures"))
    (tmp_path / "simfoundry.yaml").touch()  # marks the project
    source = tmp_path / "specs/tasks" / f"{name}.task.yaml"
    spec = _task(source)
    scene_file = source.parent / spec.scene
    export = export_task(spec, lower_file(scene_file), format_)
    file = tmp_path / "specs" / f"{name}.{'yaml' if format_ == 'omnigibson' else 'bddl'}"
    file.write_text(export.text)
    import_file(file, tmp_path / "specs/back.task.yaml", ImportOptions(scene=scene_file))
    back = _task(tmp_path / "specs/back.task.yaml")
    how = (format_ != "libero", format_ == "omnigibson")  # only LIBERO names a part; only the release asks for release
    assert _said(back.goal, *how) == _said(spec.goal, *how)
    if format_ == "behavior":
        assert any("reset" in note for note in export.notes)
        return
    assert back.instruction == spec.instruction
    assert back.reset.objects.keys() == spec.reset.objects.keys()
    for key, region in spec.reset.objects.items():
        found = back.reset.objects[key]
        if format_ == "libero":
            assert (*found.x, *found.y) == pytest.approx((*region.x, *region.y), abs=1e-4)
        else:  # the release centers ranges on the pose of the scene
            assert found.x[0] <= region.x[0] + 1e-6 and found.x[1] >= region.x[1] - 1e-6


def test_what_a_format_cannot_say_is_refused(tmp_path: Path) -> None:
    spec = _task(TASKS / "cup_in_bowl.task.yaml")
    scene = lower_file(TASKS / spec.scene)
    either = spec.model_copy(update={"goal": _imported(tmp_path, "(Or (On bowl_1 plate_1) (On bowl_2 plate_1))").goal})
    with pytest.raises(TaskExportError, match="`any`"):
        export_task(either, scene, "libero")
    with pytest.raises(TaskExportError, match="no predicate for `Upright"):
        export_task(spec.model_copy(update={"goal": "Upright(cup)"}), scene, "libero")
    with pytest.raises(TaskExportError, match="cannot express any part of the goal"):
        export_task(spec.model_copy(update={"goal": "Released(cup)"}), scene, "behavior")


def test_the_command_replaces_no_file_that_was_edited(tmp_path: Path) -> None:
    out = tmp_path / "task.bddl"
    task = TASKS / "cup_in_bowl.task.yaml"
    result = run("export", task, "-f", "libero", "-o", out, "--json")
    assert result.code == 0 and result.json["notes"] and "(In cup bowl)" in out.read_text()
    assert run("export", task, "-f", "libero", "-o", out).code == 0
    out.write_text(f"{out.read_text()}; edited\n")
    assert run("export", task, "-f", "libero", "-o", out).code == 2
    assert run("export", task, "-f", "libero", "-o", out, "--force", "--strict").code == 1
