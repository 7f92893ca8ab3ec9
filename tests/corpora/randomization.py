"""Random recipes, held against what is promised: ``python -m tests.corpora.randomization [PART]... [-n N]``.

Each recipe varies some values of a kitchen, with distributions, splits and groups that are drawn at random.

``engines``   N cousins (40): the masses, frictions, dampings, armatures, gains, positions and gravity that MuJoCo and
              PyBullet report are those in the manifest.
``bytes``     N / 8 recipes: two processes write the same bytes, and so does a run with two workers that is killed.
``refusals``  10 N recipes with a fault: each is refused with a finding at its line, never with a traceback.

Prints a table; exit code 1 where a bar is missed.
"""

from __future__ import annotations

import argparse
import hashlib
import math
import random
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from simfoundry.cousins.run.candidates import CandidateSampler
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.task import Task, load_task
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.load import load
from simfoundry.verify.readback import WorldReadback
from simfoundry.worlds import open_world
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.pybullet_world import PybulletWorld
from tests.cousins.randomization.conftest import write
from tests.cousins.randomization.kitchen import write_kitchen
from tests.readback import read_world

PARTS = ("engines", "bytes", "refusals")

# Greatest relative error of a value in an engine: MJCF, URDF and the documents keep at least six digits.
TOLERANCE = 1e-5

# Paths with the distributions among which a recipe chooses.
PALETTE: Mapping[str, tuple[str, ...]] = {
    "object.cup.mass": ("{range: estimate}", "{times: [0.5, 2]}", "{uniform: [0.1, 0.4]}", "{normal: 0.02}"),
    "object.bowl.mass": ("{log_uniform: [0.1, 1]}", "{shift: 0.1}", "{choose: [0.3, 0.35, 0.5, 0.6]}"),
    "material.steel.friction": ("{times: [0.7, 1.3]}", "{uniform: [0.2, 0.9]}", "{normal: 0.05}"),
    "material.wood.friction": ("{times: [0.7, 1.3]}", "{log_uniform: [0.2, 0.9]}"),
    "cabinet.drawer.damping": ("{log_uniform: [1, 20]}", "{times: [0.5, 2]}"),
    "cabinet.*.friction": ("{uniform: [0, 2]}", "{times: [0.5, 2]}"),
    "cabinet.drawer.armature": ("{uniform: [0.01, 0.1]}",),
    "cabinet.drawer": ("{uniform: [0, 0.1]}",),
    "object.cabinet.friction": ("{times: [0.8, 1.2]}",),
    "gravity": ("{times: [0.98, 1.02]}", "{shift: 0.1}"),
    "robot.arm.gains.stiffness": ("{log_uniform: [0.5, 2]}", "{times: [0.8, 1.2]}"),
    "robot.arm.gains.damping": ("{uniform: [0.5, 2]}",),
    "robot.arm.joints": ("{normal_deg: 2}", "{shift: 0.05}"),
    "robot.arm.pose": ("{shift: [0.02, 0.02, 0], yaw_deg: 3}",),
    "light.*.intensity": ("{uniform: [0.4, 1.2]}", "{times: [0.5, 2]}"),
    "light.key.direction": ("{cone_deg: 30}",),
    "camera.exterior_*.pose": ("{shift: 0.03, turn_deg: 3}",),
    "object.desk.color": ("{choose: [oak, white, slate, walnut]}",),
    "background": ("{choose: [../rooms/*.glb]}",),
    "instruction": ("{choose: [Go., Run., Walk., Stay.]}",),
    "disturbances.action.latency": ("{uniform: [0, 0.1]}",),
    "disturbances.observation.joint_noise": ("{log_uniform: [0.001, 0.01]}",),
}


def random_recipe(chance: random.Random) -> str:
    """Return a recipe with some entries of the palette."""
    paths = chance.sample(sorted(PALETTE), chance.randrange(4, 14))
    lines = []
    for path in paths:
        rule = chance.choice(PALETTE[path])
        group = f", together: {chance.choice('ab')}" if chance.random() < 0.2 and "choose" not in rule else ""
        lines.append(f"  {path}: {rule[:-1]}{group}}}\n")
    cut = round(chance.uniform(0.2, 0.8), 2)
    splits = f"splits: {{train: {{until: {cut}}}, held_out: {{from: {cut}}}}}\n" if chance.random() < 0.5 else ""
    return f"simfoundry: cousins/1\nname: kitchens\ntwin: ../cup.task.yaml\nvary:\n{''.join(lines)}{splits}"


# -- values in the engines ---------------------------------------------------------------------------------------------


def expected(vary: Mapping[str, Any]) -> dict[str, float]:
    """Return what the manifest says of the quantities that engines report."""
    found = {}
    for name, value in vary.items():
        head, *rest = name.split(".")
        if head == "object" and rest[1] == "mass":
            found[f"mass {rest[0]}"] = value
        elif name == "material.steel.friction":
            found |= {"friction cup": value, "friction bowl": value}
        elif name == "material.wood.friction":
            found["friction desk"] = value
        elif head == "cabinet" and len(rest) == 2:
            found[f"{rest[1]} {rest[0]}"] = value
        elif name == "cabinet.drawer":
            found["position drawer"] = value
        elif name.startswith("robot.arm.gains."):
            found[f"gains {rest[-1]}"] = value
        elif name == "robot.arm.joints":
            found |= {f"arm {joint}": position for joint, position in value.items()}
        elif name == "gravity" and not isinstance(value, dict):
            found["gravity z"] = -9.81 * value
    return found


def reported(task: Task, twin: Task, engine: str) -> dict[str, float]:
    """Return the same quantities as an engine reports them."""
    with open_world(task.scene, engine) as world:
        held = read_world(world)
        found = {f"mass {name}": _mass(held, name) for name in ("cup", "bowl")}
        found |= {f"friction {name}": _friction(held, name) for name in ("cup", "bowl", "desk")}
        for joint in ("drawer", "bottom_drawer"):
            told = held.joints[f"cabinet.{joint}"]
            for quantity in ("damping", "friction", "armature", "position"):
                number = getattr(told, quantity)
                found |= {} if number is None else {f"{quantity} {joint}": float(number)}
        found["gravity z"] = float(held.gravity[2]) if held.gravity is not None else math.nan
        found |= {f"arm {name}": position for name, position in world.robot("arm").positions().items()}
        with open_world(twin.scene, engine) as before:
            found |= _gains(world, before)
    return found


def _mass(held: WorldReadback, name: str) -> float:
    return float(next(link.mass or math.nan for key, link in held.links.items() if key.partition(".")[0] == name))


def _friction(held: WorldReadback, name: str) -> float:
    links = [link for key, link in held.links.items() if key.partition(".")[0] == name]
    return float(next(c.friction for link in links for c in link.colliders or () if c.friction is not None))


def _gains(world: Any, before: Any) -> dict[str, float]:
    """Return the factors of the gains of the first arm joint; PyBullet has only their ratio."""
    if isinstance(world, MujocoWorld):
        one, other = world.model, before.model
        servo = one.actuator("arm.joint1").id
        damping = [
            -float(model.actuator_biasprm[servo][2])
            + float(model.dof_damping[model.joint("arm.joint1").dofadr[0]].flat[0])
            for model in (one, other)
        ]
        return {
            "gains stiffness": float(one.actuator_gainprm[servo][0] / other.actuator_gainprm[servo][0]),
            "gains damping": damping[0] / damping[1],
        }
    assert isinstance(world, PybulletWorld)
    return {}


def engines(root: Path, count: int, seed: int) -> bool:
    """Compare the values of accepted cousins with those in both engines."""
    chance = random.Random(seed)
    twin = load_task(root / "cup.task.yaml")
    errors: dict[tuple[str, str], list[float]] = defaultdict(list)
    rejected = 0
    for k in range(count):
        path = root / "recipes" / f"r{k}.cousins.yaml"
        path.write_text(random_recipe(chance))
        one = CandidateSampler.load(path, root / "out", seed)(k + 1)
        if not one.accepted:
            rejected += 1
            continue
        (root / "out").mkdir(exist_ok=True)
        task = load_task(write(root, one)["task"])
        wanted = expected(one.vary)
        for engine in ("mujoco", "pybullet"):
            found = reported(task, twin, engine)
            for name, value in wanted.items():
                if name in found:
                    kind = name.partition(" ")[0]
                    errors[kind, engine].append(abs(found[name] - value) / max(abs(value), 1e-3))
    print(f"engines: {count - rejected} cousins, {rejected} rejected because they do not settle like the twin")
    for (kind, engine), values in sorted(errors.items()):
        print(f"  {kind:<10} {engine:<9} {len(values):>4} values, largest relative error {max(values):.1e}")
    kinds = {"mass", "friction", "damping", "armature", "position", "gravity", "arm", "gains"}
    complete = {kind for kind, engine in errors if engine == "mujoco"} == kinds or count < 40
    return complete and all(max(values) < TOLERANCE for values in errors.values())


# -- bytes -------------------------------------------------------------------------------------------------------------


def _run(path: Path, out: Path, *more: str) -> list[str]:
    line = [sys.executable, "-m", "simfoundry", "cousins", str(path), "-n", "6", "-o", str(out), "--no-gallery"]
    return [*line, "--seed", "7", *more]


def _bytes(folder: Path) -> dict[str, str]:
    files = [path for path in folder.rglob("*") if path.is_file() and ".cousins" not in path.parts]
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(files)}


def same_bytes(root: Path, count: int, seed: int) -> bool:
    """Compare the runs of separate processes, one of which is killed and resumed."""
    chance, alike, killed = random.Random(seed + 1), 0, 0
    for k in range(count):
        path = root / "recipes" / f"b{k}.cousins.yaml"
        path.write_text(random_recipe(chance))
        first, second = root / f"first{k}", root / f"second{k}"
        subprocess.run(_run(path, first, "-j", "1"), check=False, capture_output=True)
        process = subprocess.Popen(_run(path, second, "-j", "2"), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        log = second / ".cousins" / "log.jsonl"
        while process.poll() is None and not (log.exists() and log.read_bytes().count(b"\n") >= 2):
            time.sleep(0.01)
        if process.poll() is None:
            process.kill()
            killed += 1
        process.wait()
        subprocess.run(_run(path, second, "-j", "2"), check=False, capture_output=True)
        alike += bool(_bytes(first)) and _bytes(first) == _bytes(second)
    print(
        f"bytes: {alike} of {count} recipes the same in two processes, {killed} of the second ones killed and resumed"
    )
    return alike == count


# -- refusals ----------------------------------------------------------------------------------------------------------

FAULTS = """\
light.nothing_*.intensity: {uniform: [0, 1]}
object.cup.weight: {uniform: [0, 1]}
lights.key.intensity: {}
object.cup.mass: {uniform: [1, 0]}
object.cup.mass: {uniform: [-1, 1]}
object.cup.mass: {normal: 1e308}
object.cup.mass: {times: [0, 1]}
object.cup.mass: {uniform: [.nan, 1]}
object.cup.mass: {shift: .inf}
object.cup.mass: {choose: []}
object.cup.mass: {choose: [1, 1]}
object.cup.mass: {choose: [heavy]}
object.cup.mass: {uniform: [0.1, 0.2], times: [1, 2]}
object.cup.mass: {uniform: [0.1, 0.2, 0.3]}
object.desk.color: {choose: [unobtainium]}
object.desk.color: {choose: ["#12345"]}
object.desk.color: {uniform: [0, 1]}
background: {choose: [../../../etc/*]}
background: {choose: [/etc/passwd]}
background: {choose: [../rooms/*.png]}
background: {choose: [../rooms/**]}
background: {uniform: [0, 1]}
instruction: {choose: [""]}
instruction: {uniform: [0, 1]}
robot.arm.joints: {uniform: [0, 1]}
robot.arm.gains.stiffness: {uniform: [0, 1]}
robot.arm.gains: {times: [1, 2]}
robot.*.reach: {times: [1, 2]}
cabinet.door: {uniform: [0, 1]}
cabinet.drawer: {uniform: [0, 9]}
cabinet.drawer: {normal_deg: 3}
disturbances.action.latency: {uniform: [0, 99]}
disturbances.latency: {uniform: [0, 1]}
disturbances.action: {uniform: [0, 1]}
disturbances: {uniform: [0, 1]}
gravity: {uniform: [0, 1]}
gravity: {choose: [[0, 0]]}
options.timestep: {uniform: [0, 1]}
camera.wrist.pose: {yaw_deg: 400}
camera.*.pose: {shift: [1, 2]}
light.key.direction: {cone_deg: 0}
object.cup.pose: {turn_deg: 3, yaw_deg: 3}
object.größe.mass: {times: [1, 2]}
"": {times: [1, 2]}
"*": {times: [1, 2]}
"*.*.*": {times: [1, 2]}
object.cup.mass.value: {times: [1, 2]}
object..mass: {times: [1, 2]}
object.cup.mass: 3
object.cup.mass: {range: guess}
object.desk.friction: {range: estimate}
object.cup.mass: {times: [1, 2], together: Ünder}
parameter.gap: {times: [1, 2]}
frame.top.pose: {shift: 1}
robot.arm.model: {choose: [demo_arm, nothing]}
object.cup.pose: {shift: 1.0e+7}
object.cup.mass: {choose: ["*"]}
object.cup.shape: {choose: [box]}
object.cup.category: {choose: [3]}
""".splitlines()
# A path that is longer than any name.
FAULTS.append("a" * 300 + ": {times: [1, 2]}")


def refusals(root: Path, count: int, seed: int) -> bool:
    """Refuse recipes with a fault; the message names the line."""
    chance, wrong = random.Random(seed + 2), []
    faults: Iterator[str] = iter([*FAULTS, *(chance.choice(FAULTS) for _ in range(max(0, count - len(FAULTS))))])
    total = 0
    for fault in faults:
        total += 1
        lines = random_recipe(chance).splitlines(keepends=True)
        kept = [line for line in lines if line.strip().partition(":")[0] != fault.partition(":")[0]]
        text = "".join([*kept[:4], f"  {fault}\n", *kept[4:]])
        try:
            errors = load(root / "recipes" / "fault.cousins.yaml", text=text).errors
        except (SpecError, SimfoundryError) as error:
            wrong.append(f"{fault}: raised {error}")
            continue
        except Exception as error:
            wrong.append(f"{fault}: crashed with {type(error).__name__}: {error}")
            continue
        at_line = [error for error in errors if error.line == 5]
        if not at_line:
            wrong.append(f"{fault}: {'accepted' if not errors else f'found elsewhere: {errors[0]}'}")
    print(f"refusals: {total - len(wrong)} of {total} faults found at their line")
    for text in dict.fromkeys(wrong):
        print(f"  {text}")
    return not wrong


def main() -> int:
    """Run the parts, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], default=[])
    parser.add_argument("-n", type=int, default=40, help="number of cousins for `engines`")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    wanted = options.parts or PARTS
    good = True
    with tempfile.TemporaryDirectory() as folder:
        root = write_kitchen(Path(folder))
        if "engines" in wanted:
            good &= engines(root, options.n, options.seed)
        if "bytes" in wanted:
            good &= same_bytes(root, max(1, options.n // 8), options.seed)
        if "refusals" in wanted:
            good &= refusals(root, 10 * options.n, options.seed)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
