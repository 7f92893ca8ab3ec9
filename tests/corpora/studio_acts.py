"""Random acts in the studio: each is possible or says why, comments stay, and undoing all of them restores every byte.

    python -m tests.corpora.studio_acts [-n ACTS] [--seed SEED] [DOCUMENT ...]

For each document, random acts of all families are applied. After each, the text is loaded afresh, as ``check`` does,
and must have no errors; comments beside objects must be beside the same objects. Then everything is undone, redone and
undone again, and saved twice on the way.
"""

from __future__ import annotations

import argparse
import random
import re
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.geometry.frames import Pose, quat_from_rpy
from simfoundry.lint.lints import lint
from simfoundry.spec.diagnostics import Severity
from simfoundry.spec.load import load
from simfoundry.studio.acts.act import Act, ActError
from simfoundry.studio.acts.add import AddObject
from simfoundry.studio.acts.cameras import AddCamera, MoveCamera, RemoveCamera
from simfoundry.studio.acts.conditions import AddGoal, AddRelation, RemoveGoal, RemoveRelation
from simfoundry.studio.acts.duplicate import DuplicateObject
from simfoundry.studio.acts.joints import SetJoint, movable_joints
from simfoundry.studio.acts.move import MoveObject, Snap
from simfoundry.studio.acts.names import RenameSymbol
from simfoundry.studio.acts.properties import SetProperties
from simfoundry.studio.acts.regions import RemoveRegion, SetRegion
from simfoundry.studio.acts.remove import RemoveObject
from simfoundry.studio.acts.resize import ResizeObject, shape_lengths
from simfoundry.studio.reading import StudioScene
from simfoundry.studio.session import StudioSession
from tests.conftest import REPOSITORY
from tests.studio.conftest import SCENE, TASK

# Documents of the repository in which acts are tried, besides the small project of the tests.
REAL = (
    "scenes/stack_dishware.scene.yaml",
    "scenes/pot_on_stove.scene.yaml",
    "scenes/cluttered.scene.yaml",
    "tasks/stack_dishware.task.yaml",
)

ALL = ("small/desk.scene.yaml", "small/put_mug.task.yaml", *REAL)

# Every so many acts, the lints run as well, which take longer than the act.
LINTED = 25

# Number of acts that are tried for each that is to be possible; about one in three is refused.
TRIES = 5

SHAPES = ({"box": (0.05, 0.06, 0.07)}, {"sphere": 0.02}, {"cylinder": {"radius": 0.03, "height": 0.08}})


class Actor:
    """Someone who acts at random."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)

    def act(self, scene: StudioScene) -> Act:
        """Return a random act, which may be impossible."""
        kinds: list[tuple[int, Callable[[StudioScene, str], Act]]] = [
            (8, self._move), (2, self._set), (2, self._rename), (1, self._add), (1, self._duplicate), (1, self._remove),
            (1, self._relation), (1, self._goal), (1, self._region), (1, self._camera), (1, self._joint),
            (1, self._resize),
        ]  # fmt: skip
        (chosen,) = self.random.choices([kind for _, kind in kinds], [weight for weight, _ in kinds])
        return chosen(scene, self.random.choice([*scene.objects, "nothing"]))

    def _move(self, scene: StudioScene, name: str) -> Act:
        r = self.random
        p = (r.uniform(-0.6, 0.9), r.uniform(-0.5, 0.5), r.uniform(-0.05, 0.6))
        if name in scene.objects and scene.objects[name].fixed:
            p = tuple(scene.objects[name].X_WO.p + np.array([r.uniform(-0.1, 0.1) for _ in range(3)]))
        q = quat_from_rpy(*(r.choice([0.0, 0.0, r.uniform(-3, 3)]) for _ in range(3)))
        snap = r.choice([Snap(), Snap(0.01, 15.0), Snap(0.05)])
        return MoveObject(name, Pose.of(p, q), r.random() < 0.8, r.random() < 0.8, snap)

    def _set(self, scene: StudioScene, name: str) -> Act:
        r = self.random
        materials = [*scene.spec.materials, None, "nothing"]
        values: dict[str, Any] = r.choice(
            [
                {"mass": round(r.uniform(-0.1, 2), 3)}, {"friction": round(r.uniform(0, 1), 2)}, {"mass": None},
                {"material": r.choice(materials)}, {"category": r.choice(["cup", "box", None])},
                {"density": 500.0}, {"color": (0.2, 0.4, 0.6)}, {"restitution": 0.1}, {"fixed": r.choice([True, None])},
            ]
        )  # fmt: skip
        return SetProperties(name, values)

    def _rename(self, scene: StudioScene, name: str) -> Act:
        new = self.random.choice([f"thing_{self.random.randrange(99)}", name, "on", "Bad"])
        return RenameSymbol(f"objects.{name}", new)

    def _add(self, scene: StudioScene, name: str) -> Act:
        return AddObject(f"new_{self.random.randrange(999)}", {"shape": self.random.choice(SHAPES)})

    def _duplicate(self, scene: StudioScene, name: str) -> Act:
        return DuplicateObject(name, self.random.choice([1, 1, 2]), self.random.choice([None, (0.1, 0.0)]))

    def _remove(self, scene: StudioScene, name: str) -> Act:
        return RemoveObject(name)

    def _relation(self, scene: StudioScene, name: str) -> Act:
        if scene.spec.relations and self.random.random() < 0.4:
            return RemoveRelation(self.random.choice(scene.spec.relations))
        other = self.random.choice([*scene.objects, "nothing"])
        return AddRelation(f"{self.random.choice(['OnTop', 'NextTo', 'LeftOf', 'Touching'])}({name}, {other})")

    def _goal(self, scene: StudioScene, name: str) -> Act:
        goals = [text for source, text in scene.conditions if source == "goal"]
        if goals and self.random.random() < 0.4:
            return RemoveGoal(self.random.choice(goals))
        return AddGoal(f"Upright({name})")

    def _region(self, scene: StudioScene, name: str) -> Act:
        if self.random.random() < 0.3:
            return RemoveRegion(name)
        ends = (self.random.uniform(-0.3, 0.3), self.random.uniform(-0.3, 0.3))
        return SetRegion(name, x=self.random.choice([None, ends]), yaw_deg=self.random.choice([None, (-30.0, 30.0)]))

    def _camera(self, scene: StudioScene, name: str) -> Act:
        camera = self.random.choice([*scene.spec.cameras, "nothing"])
        p = [self.random.uniform(-1, 1) for _ in range(3)]
        add = AddCamera(f"view_{self.random.randrange(9)}", Pose.of(p), (0.0, 0.0, 3.0))
        acts: list[Act] = [add, MoveCamera(camera, Pose.of(p)), RemoveCamera(camera)]
        return self.random.choice(acts)

    def _joint(self, scene: StudioScene, name: str) -> Act:
        joints = [(n, j.name) for n in scene.objects for j in movable_joints(scene, n)]
        owner, joint = self.random.choice(joints) if joints else (name, "hinge")
        return SetJoint(owner, joint, self.random.uniform(-1, 2))

    def _resize(self, scene: StudioScene, name: str) -> Act:
        document = scene.loaded.document
        data = document.data["objects"].get(name, {}) if document is not None else {}
        lengths = shape_lengths(data.get("shape") or {})
        return ResizeObject(name, {k: round(v * self.random.uniform(0.5, 1.6), 4) for k, v in lengths.items()})


def comments_beside_objects(text: str) -> dict[str, str]:
    """Return the object that each comment beside a key of an object belongs to."""
    objects = re.search(r"^objects:.*?(?=^\w|\Z)", text, re.MULTILINE | re.DOTALL)
    found: dict[str, str] = {}
    name = ""
    for line in (objects[0] if objects is not None else "").splitlines():
        key = re.match(r"  ([a-z]\w*):", line)
        name = key[1] if key is not None else name
        comment = re.search(r" # (.*)\Z", line)
        if comment is not None and not line.lstrip().startswith("#"):
            found[comment[1]] = name
    return found


def run(path: Path, acts: int, seed: int) -> dict[str, object]:
    """Act at random on one document, and return what happened."""
    session, actor = StudioSession(path), Actor(seed)
    before = {file: file.read_bytes() for file in path.parent.parent.rglob("*.yaml")}
    refused: Counter[str] = Counter()
    done, lost, slowest = 0, 0, 0.0
    spent: list[float] = []
    for _ in range(TRIES * acts):
        if done == acts:
            break
        assert session.scene is not None and session.is_current
        act = actor.act(session.scene)
        scene_path = session.scene.loaded.path.resolve()
        owners = comments_beside_objects(session.texts[scene_path])
        start = time.perf_counter()
        try:
            session.apply(act)
        except ActError as error:
            assert len(str(error)) > 10, error
            refused[type(act).__name__] += 1
            continue
        spent.append(time.perf_counter() - start)
        done += 1
        _check(session, path, done)
        lost += _lost_comments(act, owners, comments_beside_objects(session.texts[scene_path]))
        if done == acts // 2:
            session.save()
    end = dict(session.texts)
    while session.undo():
        pass
    assert {f: t.encode() for f, t in session.texts.items()} == {f: before[f] for f in session.texts}, "undo"
    while session.redo():
        pass
    assert dict(session.texts) == end, "redo"
    while session.undo():
        pass
    session.save()
    assert {file: file.read_bytes() for file in before} == before, "files"
    slowest = max(spent, default=0.0)
    median = float(np.median(spent)) if spent else 0.0
    return {"done": done, "refused": sum(refused.values()), "lost": lost, "median": median, "slowest": slowest}


def _check(session: StudioSession, path: Path, k: int) -> None:
    """Load the text afresh, and require that it has no errors."""
    session_texts = session.texts
    known = session.documents
    loaded = load(path, text=session_texts[path.resolve()], reader=known.read)
    assert not loaded.errors, loaded.errors[0]
    if k % LINTED == 0:
        errors = [d for d in lint(loaded) if d.severity is Severity.ERROR]
        assert not errors, errors[0]


def _lost_comments(act: Act, before: dict[str, str], after: dict[str, str]) -> int:
    """Return the number of comments that are not beside the object that they belong to, which was not removed."""
    gone = {act.name} if isinstance(act, RemoveObject) else set()
    names = {act.old.removeprefix("objects."): act.new} if isinstance(act, RenameSymbol) else {}
    wrong = [c for c, owner in before.items() if owner not in gone and after.get(c) != names.get(owner, owner)]
    for comment in wrong:
        print(f"  lost: {comment!r} of {before[comment]} after {act.label}", file=sys.stderr)
    return len(wrong)


def main() -> None:
    """Run all documents and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "documents", nargs="*", default=[], metavar="DOCUMENT", help=f"by default all: {', '.join(ALL)}"
    )
    parser.add_argument("-n", type=int, default=500, help="acts for each document")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    print(f"{'document':<36}{'acts':>6}{'refused':>9}{'comments lost':>15}{'median':>10}{'slowest':>10}")
    failed = False
    with tempfile.TemporaryDirectory() as folder:
        project = Path(folder) / "project"
        shutil.copytree(REPOSITORY / "specs", project)
        (project / "simfoundry.yaml").touch()
        small = project / "small"
        small.mkdir()
        (small / "desk.scene.yaml").write_text(SCENE)
        (small / "put_mug.task.yaml").write_text(TASK)
        for name in given.documents or ALL:
            found = run(project / name, given.n, given.seed)
            failed |= bool(found["lost"])
            print(
                f"{name:<36}{found['done']:>6}{found['refused']:>9}{found['lost']:>15}"
                f"{1000 * float(str(found['median'])):>8.0f}ms{1000 * float(str(found['slowest'])):>8.0f}ms",
                flush=True,
            )
    sys.exit(failed)


if __name__ == "__main__":
    main()
