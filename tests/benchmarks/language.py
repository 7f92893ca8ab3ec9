"""How long `check`, `fmt`, `diff` and `merge` take from the shell, and where a check's time goes: prints medians.

    python -m tests.benchmarks.language [RUNS]

Times of a busy machine mean little; the ratios to a bare start of Python and to the imports of others do.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

LIBRARIES = "import click, yaml; from pydantic import BaseModel, Discriminator, Field, Tag, model_validator"
SHAPES = (
    ("{box: [0.05, 0.04, 0.06]}", 0.03),
    ("{sphere: 0.03}", 0.03),
    ("{cylinder: {radius: 0.03, height: 0.06}}", 0.03),
    ("{lathe: {profile: [[0, 0], [0.02, 0], [0.04, 0.06], [0.036, 0.06], [0.018, 0.004], [0, 0.004]]}}", 0.0),
)


def scene(count: int) -> str:
    """A desk with ``count - 1`` things on it that neither overlap nor hang in the air."""
    side = int(count**0.5) + 1
    lines = ["simfoundry: scene/1", "name: many", "materials: {ceramic: {density: 2400}}", "objects:"]
    lines.append(
        f"  desk: {{fixed: true, shape: {{box: [{side / 5}, {side / 5}, 0.04]}}, pose: {{xyz: [0, 0, -0.02]}}}}"
    )
    for k in range(count - 1):
        shape, z = SHAPES[k % 4]
        x, y = (0.1 * (v - side / 2) for v in divmod(k, side))
        pose = f"{{xyz: [{x:.3f}, {y:.3f}, {z}], yaw_deg: {k * 7 % 360}}}"
        lines += [f"  thing_{k}:", f"    shape: {shape}", "    material: ceramic", f"    pose: {pose}"]
    lines.append("cameras: {top: {size: [640, 480], fx: 200, fy: 200, pose: {xyz: [-3, 0, 8], look_at: [0, 0, 0]}}}")
    return "\n".join([*lines, "relations: [OnTop(thing_1, desk)]", ""])


def seconds(runs: int, *args: str) -> float:
    """The median wall time of a Python process."""
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        done = subprocess.run([sys.executable, *args], capture_output=True, text=True)
        times.append(time.perf_counter() - start)
        assert done.returncode == 0, done.stdout + done.stderr
    return statistics.median(times)


def inside(runs: int, path: Path) -> dict[str, float]:
    """Median times of the parts of a check in a process that has everything loaded."""
    from simfoundry.lint.lints import lint
    from simfoundry.spec.load import load
    from simfoundry.spec.yaml.text import read

    times: dict[str, list[float]] = {"read": [], "read and check": [], "lint": []}
    for _ in range(runs):
        start = time.perf_counter()
        read(path)
        times["read"].append(time.perf_counter() - start)
        start = time.perf_counter()
        loaded = load(path)
        times["read and check"].append(time.perf_counter() - start)
        start = time.perf_counter()
        lint(loaded)
        times["lint"].append(time.perf_counter() - start)
    return {name: statistics.median(values) for name, values in times.items()}


def commands(runs: int, path: Path) -> dict[str, float]:
    """Medians of the commands that work on a scene of 1,000 objects."""
    command = ("-m", "simfoundry.cli.main")
    text = path.read_text()
    ours, theirs = path.with_name("ours.scene.yaml"), path.with_name("theirs.scene.yaml")
    ours.write_text(text.replace("yaw_deg: 35}", "yaw_deg: 36}"))
    theirs.write_text(text.replace("name: many", "name: more"))
    merge = ("merge", str(path), str(ours), str(theirs), "-o", str(path.with_name("merged.scene.yaml")), "--force")
    return {
        "fmt of 1000 objects": seconds(runs, *command, "fmt", "--diff", str(path)),
        "diff of 1000 objects": seconds(runs, *command, "diff", str(path), str(ours)),
        "merge of 1000 objects": seconds(runs, *command, *merge),
    }


def tree(runs: int, folder: Path) -> dict[str, float]:
    """The median of a check of 1,000 scenes of ten objects."""
    folder.mkdir()
    for k in range(1000):
        (folder / f"scene_{k}.scene.yaml").write_text(scene(10))
    return {"check of 1000 scenes": seconds(runs, "-m", "simfoundry.cli.main", "check", str(folder))}


def main(runs: int) -> None:
    """Print the table."""
    bare = seconds(runs, "-c", "pass")
    rows = {"python -c pass": bare, "click, yaml and pydantic": seconds(runs, "-c", LIBRARIES)}
    with tempfile.TemporaryDirectory() as folder:
        for count in (10, 1000):
            path = Path(folder) / f"of_{count}.scene.yaml"
            path.write_text(scene(count))
            rows[f"check of {count} objects"] = seconds(runs, "-m", "simfoundry.cli.main", "check", str(path))
            rows |= {f"  of {count}: {name}": value for name, value in inside(runs, path).items()}
        rows |= commands(runs, path)
        rows |= tree(max(1, runs // 4), Path(folder) / "tree")
    for name, value in rows.items():
        print(f"{name:<28} {value * 1000:7.1f} ms {value / bare:7.1f} x")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 11)
