"""Kills, and two hundred broken files: ``python -m tests.corpora.faults [kills] [files] [batch]``.

``kills``: a compile over an existing build is ended by kill -9 at 50 moments, half of them spread over the whole run,
half from when it starts to write. After each the build must be the whole old or the whole new one, byte by byte, and
load in MuJoCo, OpenUSD and PyBullet.

``files``: broken meshes go through `compile`, broken URDFs through `import` and then `compile`, in a process that
serves many: it must survive them all. Each file is refused with a reason, or what was made of it loads in MuJoCo.

``batch``: the same meshes once more, all in one `compile` that has to go on to its end and compile the sound scene.

Prints a table of each; exit code 1 where a bar is missed.
"""

from __future__ import annotations

import hashlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simfoundry.runtime.workers import Limits, Worker, WorkerError
from simfoundry.verify.engines import find_engine
from simfoundry.verify.process import EngineJob, ask
from tests.assets.meshes import blob, obj
from tests.cli.command import MAIN, run
from tests.conftest import REPOSITORY
from tests.corpora.broken import meshes, urdfs

KILLS, SEED = 50, 2026
MIN_FILES, DAMAGED_URDFS = 200, 80
SECONDS, MEGABYTES = 120.0, 2000.0
"""The most that one broken file may take, on a machine that has other things to do."""

ENGINES = {"mujoco": "mjcf", "usd": "usd", "pybullet": "pybullet"}

SCENE = """\
simfoundry: scene/1
name: faults
materials: {{wood: {{density: 500, friction: 0.6}}}}
objects:
  desk: {{fixed: true, shape: {{box: [1.4, 0.7, 0.04]}}, material: wood, pose: {{xyz: [0.45, 0, -0.02]}}}}
  cup: {{shape: {{cylinder: {{radius: 0.04, height: {height}}}}}, material: wood, pose: {{xyz: [0.4, 0.1, 0.05]}}}}
  blob: {{asset: blob.obj, collision: hull, material: wood, pose: {{xyz: [0.4, -0.2, 1]}}}}
"""
BROKEN = """\
simfoundry: scene/1
name: broken
materials: {{wood: {{density: 500, friction: 0.6}}}}
objects:
  desk: {{fixed: true, shape: {{box: [1.4, 0.7, 0.04]}}, material: wood, pose: {{xyz: [0.45, 0, -0.02]}}}}
  thing: {{asset: {file}, collision: {collision}, solid: {solid}, material: wood, pose: {{xyz: [0.4, 0.1, 0.5]}}}}
"""


# -- kills ----------------------------------------------------------------------------------------------------------


def kills(folder: Path) -> int:
    """Kill compiles; the number of bars missed."""
    root = folder / "killed"
    root.mkdir()
    (root / "simfoundry.yaml").write_text("")
    (root / "blob.obj").write_text(obj(*blob(np.random.default_rng(SEED), 4000)))
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY), "SIMFOUNDRY_CACHE": str(folder / "cache")}
    whole = {}
    for height in ("0.095", "0.12"):
        (root / f"{height}.scene.yaml").write_text(SCENE.format(height=height))
        (root / "a.scene.yaml").write_text(SCENE.format(height=height))
        seconds, writing = _durations(root, environment)
        whole[height] = _hashes(root / "build")
    assert len(whole["0.12"]) > 10 and whole["0.12"] != whole["0.095"]
    names = {json.dumps(found): height for height, found in whole.items()}
    rng = np.random.default_rng(SEED)
    found: Counter[str] = Counter()
    for k in range(KILLS):
        before = names.get(json.dumps(_hashes(root / "build")), "")
        target = "0.12" if before == "0.095" else "0.095"
        (root / "a.scene.yaml").write_text(SCENE.format(height=target))
        if k % 2:
            _kill(root, environment, float(rng.uniform(0, writing)), at_writing=True)
        else:
            _kill(root, environment, float(rng.uniform(0, 1.1 * seconds)), at_writing=False)
        after = names.get(json.dumps(_hashes(root / "build")), "MIXED")
        found["the whole old build" if after == before else "the whole new build" if after == target else "MIXED"] += 1
        found["with a staging folder left"] += bool(list((root / "build").glob(".build.new.*")))
        shutil.copytree(root / "build", folder / "kept" / str(k), ignore=shutil.ignore_patterns(".*"))
    _compile(root, environment).wait()
    left = [p.name for p in (root / "build").iterdir() if p.name.startswith(".")]
    said = ", ".join(f"{n} x {what}" for what, n in found.items() if n)
    print(f"{KILLS} kills of {seconds:.2f} s, of which it writes {1000 * writing:.0f} ms: {said}")
    print(f"left after the next run: {', '.join(left) or 'nothing'}")
    return int(found["MIXED"] > 0) + int(bool(left)) + _loads([folder / "kept" / str(k) for k in range(KILLS)])


def _compile(root: Path, environment: Mapping[str, str]) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-c", MAIN, "compile", "a.scene.yaml"]
    return subprocess.Popen(command, cwd=root, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _durations(root: Path, environment: Mapping[str, str]) -> tuple[float, float]:
    """How long a compile takes, and how long of that it writes [s]."""
    started = time.perf_counter()
    process = _compile(root, environment)
    writes = _waited(root / "build", process)
    process.wait()
    ended = time.perf_counter()
    return ended - started, ended - writes


def _waited(build: Path, process: subprocess.Popen[bytes], before: frozenset[str] = frozenset()) -> float:
    """The moment at which a folder to write in has appeared that was not there ``before``, or the process is done."""
    while process.poll() is None and not _staging(build) - before:
        time.sleep(0.0002)
    return time.perf_counter()


def _staging(build: Path) -> frozenset[str]:
    return frozenset(path.name for path in build.glob(".build.*"))


def _kill(root: Path, environment: Mapping[str, str], delay: float, at_writing: bool) -> None:
    """End a compile ``delay`` seconds after its start, or after it has started to write."""
    before = _staging(root / "build")
    process = _compile(root, environment)
    if at_writing:
        _waited(root / "build", process, before)
    time.sleep(delay)
    process.send_signal(signal.SIGKILL)
    process.wait()


def _hashes(folder: Path) -> dict[str, str]:
    """Of every file that is no leftover."""
    files = (p for p in sorted(folder.rglob("*")) if p.is_file() and not p.relative_to(folder).parts[0].startswith("."))
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def _loads(builds: list[Path]) -> int:
    """How many engines do not load every build."""
    missed = 0
    for engine, target in ENGINES.items():
        answers = ask(
            Path(sys.executable), find_engine(engine).readback, [EngineJob(build / target) for build in builds]
        )
        errors = [answer.error for answer in answers if answer.error]
        print(f"{engine:<9} loads {len(answers) - len(errors)} of {len(answers)}{': ' + errors[0] if errors else ''}")
        missed += bool(errors)
    return missed


# -- broken files ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Verdict:
    """What became of a broken file: `refused`, `taken`, or else what went wrong; and why, and what it cost."""

    name: str
    what: str
    why: str
    seconds: float
    megabytes: float

    @property
    def missed(self) -> bool:
        """Whether the bar is missed."""
        return self.what not in ("refused", "taken") or self.seconds > SECONDS or self.megabytes > MEGABYTES


def files(folder: Path) -> int:
    """Put every broken file through; the number of those that miss the bar."""
    os.environ["SIMFOUNDRY_CACHE"] = str(folder / "cache")
    rng = np.random.default_rng(SEED)
    worker = Worker(Limits(4 * SECONDS, 12 * 2**30))
    verdicts = []
    for name, place, function in _cases(folder, rng):
        verdict = _judged(worker, name, place, function)
        verdicts.append(verdict)
        if verdict.missed:
            print(f"MISSED {name}: {verdict.what}, {verdict.seconds:.1f} s, {verdict.megabytes:.0f} MB: {verdict.why}")
    worker.close()
    for kind in ("mesh", "urdf"):
        mine = [v for v in verdicts if v.name.startswith(kind)]
        found = Counter(v.what for v in mine)
        slow, large = max(mine, key=lambda v: v.seconds), max(mine, key=lambda v: v.megabytes)
        print(
            f"{len(mine)} {kind}s: {', '.join(f'{n} {what}' for what, n in found.items())}; "
            f"at most {slow.seconds:.1f} s ({slow.name}) and {large.megabytes:.0f} MB ({large.name})"
        )
    print("reasons: " + "; ".join(f"{n} x {why}" for why, n in Counter(map(_kind, verdicts)).most_common(12)))
    return sum(v.missed for v in verdicts) + int(len(verdicts) < MIN_FILES)


def _cases(folder: Path, rng: np.random.Generator) -> Iterator[tuple[str, Path, str]]:
    """Name, place, and what to call with it."""
    for k, (name, parts) in enumerate(meshes.broken(rng)):
        place = _scene_with(folder / "meshes" / f"{k}_{name}", parts, solid="hull" if k % 3 == 0 else "exact")
        yield f"mesh {name}", place, "compile_scene"
    (folder / "large").mkdir()
    (folder / "large" / "simfoundry.yaml").write_text("")
    for name, path in meshes.ten_million(folder / "large"):
        scene = path.with_name("a.scene.yaml")
        scene.write_text(BROKEN.format(file=path.name, collision="auto", solid="exact"))
        yield f"mesh {name}", scene, "compile_scene"
    (folder / "urdfs").mkdir()
    texts = [(name, text.encode()) for name, text in urdfs.named()]
    for name, data in [*texts, *urdfs.damaged(rng, DAMAGED_URDFS)]:
        path = folder / "urdfs" / f"{name}.urdf"
        path.write_bytes(data)
        yield f"urdf {name}", path, "import_urdf"
    for name, parts in meshes.broken(rng):
        if name.endswith(("_stl", "_obj")):
            place = folder / "urdf_meshes" / name
            place.mkdir(parents=True)
            for file, data in parts.items():
                (place / file).write_bytes(data)
            file = next(iter(parts))
            text = urdfs.robot(urdfs.link("a", urdfs.INERTIAL + urdfs.MESH.format(file)))
            (place / "a.urdf").write_text(text)
            yield f"urdf with {name}", place / "a.urdf", "import_urdf"


def _scene_with(place: Path, parts: Mapping[str, bytes], solid: str) -> Path:
    place.mkdir(parents=True)
    (place / "simfoundry.yaml").write_text("")
    for file, data in parts.items():
        (place / file).write_bytes(data)
    collision = "hull" if solid == "hull" else "auto"
    (place / "a.scene.yaml").write_text(BROKEN.format(file=next(iter(parts)), collision=collision, solid=solid))
    return place / "a.scene.yaml"


def _judged(worker: Worker, name: str, place: Path, function: str) -> Verdict:
    started = time.perf_counter()
    try:
        what, why, megabytes = worker.call(f"tests.corpora.faults:{function}", place)
    except WorkerError as error:
        what, why, megabytes = "CRASHED", str(error), 0.0
    return Verdict(name, what, why, time.perf_counter() - started, megabytes)


def _kind(verdict: Verdict) -> str:
    """The reason without names and numbers."""
    words = verdict.why.split()
    code = next((w for w in words if w.startswith("error[")), "")
    return code or (verdict.what if verdict.what == "taken" else " ".join(w for w in words if w.isalpha())[:40])


def compile_scene(scene: Path) -> tuple[str, str, float]:
    """Compile a scene, in a process that serves many: what became of it, why, and the memory that it took [MB]."""
    _forget_peak()
    done = run("compile", scene, "-o", scene.parent / "build")
    if done.code == 0:
        return _taken(scene.parent / "build")
    return _refused(done.code, done.err)


def import_urdf(path: Path) -> tuple[str, str, float]:
    """Import a URDF as an asset, and compile a scene with it."""
    _forget_peak()
    out = path.parent / "out" / path.stem
    done = run("import", path, "-o", out / "thing.asset.yaml")
    if done.code != 0:
        return _refused(done.code, done.err)
    scene = out / "a.scene.yaml"
    scene.write_text(
        "simfoundry: scene/1\nname: a\nobjects: {thing: {asset: thing.asset.yaml, pose: {xyz: [0, 0, 1]}}}\n"
    )
    done = run("compile", scene, "-o", out / "build")
    return _taken(out / "build") if done.code == 0 else ("NOT COMPILED", done.err, _peak())


def _taken(build: Path) -> tuple[str, str, float]:
    import mujoco

    try:
        mujoco.MjModel.from_xml_path(str(build / "mjcf" / "scene.xml"))
    except ValueError as error:
        return "NOT LOADED", str(error), _peak()
    return "taken", "", _peak()


def _refused(code: int, said: str) -> tuple[str, str, float]:
    """A refusal is exit code 2, with a finding or a sentence, and without a traceback."""
    clean = code == 2 and "Traceback" not in said and ("error[SF" in said or said.startswith("Error: "))
    return ("refused" if clean else "WITHOUT A REASON"), said.strip()[:300], _peak()


def _forget_peak() -> None:
    """Let the kernel count the most memory of this process anew, where it can."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return


def _peak() -> float:
    """The most memory of this process since then [MB]."""
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM:"))


# -- all in one run -------------------------------------------------------------------------------------------------


def batch(folder: Path) -> int:
    """One compile of all broken meshes and of one sound scene; the number of bars missed."""
    root, rng = folder / "batch", np.random.default_rng(SEED)
    for name, parts in meshes.broken(rng):
        _scene_with(root / name, parts, solid="exact")
    _scene_with(root / "sound", {"a.obj": obj(*blob(rng)).encode()}, solid="exact")
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY), "SIMFOUNDRY_CACHE": str(folder / "cache")}
    command = [sys.executable, "-c", MAIN, "compile", str(root), "-o", str(folder / "built"), "--json"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    scenes = {Path(scene["scene"]).parent.name: scene for scene in json.loads(done.stdout)["scenes"]}
    states = Counter(scene["state"] for scene in scenes.values())
    silent = [
        name for name, s in scenes.items() if s["state"] == "failed" and not (s.get("findings") or s.get("error"))
    ]
    good = done.returncode == 1 and scenes["sound"]["state"] == "compiled" and not silent and not done.stderr
    print(f"one run over {len(scenes)}: {', '.join(f'{n} {state}' for state, n in states.items())}; "
          f"the sound one {scenes['sound']['state']}; exit code {done.returncode}")  # fmt: skip
    return int(not good)


def main(arguments: list[str]) -> int:
    """Run the parts that are asked for; 1 where a bar is missed."""
    missed = 0
    with tempfile.TemporaryDirectory() as temporary:
        for part in (kills, files, batch):
            if not arguments or part.__name__ in arguments:
                started = time.perf_counter()
                missed += part(Path(temporary))
                print(f"({part.__name__}: {time.perf_counter() - started:.0f} s)\n", flush=True)
    print("every bar is met" if not missed else f"{missed} missed")
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
