"""Other compilers, each in an environment of its own, timed in turns with ours.

They clash with each other and with us in what they need, so each is a process that works when it is told to::

    python3.11 -m venv synth && synth/bin/pip install scene-synthesizer==1.15.0 usd-core
    python3.11 -m venv converter && converter/bin/pip install mujoco-usd-converter==0.8.0
    export SCENE_SYNTHESIZER_PYTHON=$PWD/synth/bin/python MUJOCO_USD_CONVERTER_PYTHON=$PWD/converter/bin/python

A peer whose variable is not set is left out.
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from types import TracebackType
from typing import Self

from tests.benchmarks import reference

_LOOP = """
import sys, time
out = sys.argv[1]
def loop(work):
    work(); print("ready", flush=True)
    for _ in sys.stdin:
        start = time.perf_counter(); work(); print(time.perf_counter() - start, flush=True)
"""

_SCENE_SYNTHESIZER = """
import logging, numpy as np, scene_synthesizer as synth
logging.disable(logging.ERROR)
origin = ("center", "center", "center")
make = {
    "box": lambda: synth.BoxAsset([0.04, 0.05, 0.06], origin=origin, mass=0.1),
    "cylinder": lambda: synth.CylinderAsset(radius=0.02, height=0.06, origin=origin, mass=0.08),
    "sphere": lambda: synth.SphereAsset(radius=0.02, origin=origin, mass=0.05),
}
def at(x, y, z):
    matrix = np.eye(4); matrix[:3, 3] = x, y, z; return matrix
scene = synth.Scene()
scene.add_object(synth.BoxAsset([SIDE, SIDE, 0.03], origin=origin), "table", transform=at(0, 0, TOP))
for name, kind, x, y, z in THINGS:
    scene.add_object(make[kind](), name, transform=at(x, y, z))
def work():
    scene.export(out + "/scene.urdf"); scene.export(out + "/scene.usda")
loop(work)
"""

_MUJOCO_USD_CONVERTER = """
import shutil, mujoco_usd_converter
def work():
    shutil.rmtree(out + "/usd", ignore_errors=True)
    mujoco_usd_converter.Converter().convert(out + "/scene.xml", out + "/usd")
loop(work)
"""

VARIABLES = {
    "scene-synthesizer": "SCENE_SYNTHESIZER_PYTHON",
    "mujoco-usd-converter": "MUJOCO_USD_CONVERTER_PYTHON",
}
"""The environment variable of each peer that names its Python."""

DOES = {
    "scene-synthesizer": "URDF and usda of a scene that is built already",
    "mujoco-usd-converter": "MJCF to USD, in layers",
}


class Peer:
    """A peer that holds the scene of ``count`` things and works once for each call of :meth:`seconds`."""

    def __init__(self, name: str, count: int, folder: Path) -> None:
        folder.mkdir(parents=True)
        (folder / "scene.xml").write_text(reference.mjcf(count))
        script = _LOOP + (_SCENE_SYNTHESIZER if name == "scene-synthesizer" else _MUJOCO_USD_CONVERTER)
        for word, value in (
            ("SIDE", reference.table_size(count)),
            ("TOP", reference.TOP - 0.015),
            ("THINGS", [tuple(thing) for thing in reference.things(count)]),
        ):
            script = script.replace(word, repr(value))
        (folder / "work.py").write_text(script)
        environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
        self._process = subprocess.Popen(
            [os.environ[VARIABLES[name]], str(folder / "work.py"), str(folder)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=(folder / "errors.txt").open("wb"),
            text=True,
            env=environment,
        )
        if self._line() != "ready":
            raise RuntimeError(f"{name} does not work:\n{(folder / 'errors.txt').read_text()[-2000:]}")

    def seconds(self) -> float:
        """How long it takes once more."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return float(self._line())

    def _line(self) -> str:
        """The next line of ours; peers print words of their own between."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.strip() == "ready" or line.replace(".", "").replace("e-", "").strip().isdigit():
                return line.strip()
        return ""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(timeout=60)


def present() -> list[str]:
    """The peers whose environments are named."""
    return [name for name, variable in VARIABLES.items() if os.environ.get(variable)]
