"""Two hundred broken files: ``python -m tests.corpora.faults [files] [batch]``.

``files``: broken meshes go through `compile`, broken URDFs through `import` and then `compile`, in a process that
serves many: it must survive them all. Each file is refused with a reason, or what was made of it loads in MuJoCo.

``batch``: the same meshes once more, all in one `compile` that has to go on to its end and compile the sound scene.

Prints a table of each; exit code 1 where a bar is missed.
"""

from __future__ import annotations

import json
import os
import resource
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
from tests.assets.meshes import blob, obj
from tests.cli.command import MAIN, run
from tests.conftest import REPOSITORY
from tests.corpora.broken import meshes, urdfs

SEED = 2026
MIN_FILES, DAMAGED_URDFS = 200, 80
SECONDS, MEGABYTES = 120.0, 2000.0
"""The most that one broken file may take, on a machine that has other things to do."""

BROKEN = """\
simfoundry: scene/1
name: broken
materials: {{wood: {{density: 500, friction: 0.6}}}}
objects:
  desk: {{fixed: true, shape: {{box: [1.4, 0.7, 0.04]}}, material: wood, pose: {{xyz: [0.45, 0, -0.02]}}}}
  thing: {{asset: {file}, collision: {collision}, solid: {solid}, material: wood, pose: {{xyz: [0.4, 0.1, 0.5]}}}}
"""


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
        for part in (files, batch):
            if not arguments or part.__name__ in arguments:
                started = time.perf_counter()
                missed += part(Path(temporary))
                print(f"({part.__name__}: {time.perf_counter() - started:.0f} s)\n", flush=True)
    print("every bar is met" if not missed else f"{missed} missed")
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
