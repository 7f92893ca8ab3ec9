"""A reader that crashes, hangs, or is not there, does not take the rest with it."""

from __future__ import annotations

import stat
import sys
from pathlib import Path

import pytest

from simfoundry.errors import SimfoundryError
from simfoundry.verify.engines import UnknownEngineError, all_engines, find_engine, find_installed, interpreters
from simfoundry.verify.process import EngineJob, Run, ask
from simfoundry.verify.readback import WorldReadback, mesh_bounds, pose_of, shape_bounds
from simfoundry.verify.run import built
from tests.scenes import primitives_scene, scene_of

HERE = Path(sys.executable)
MUJOCO = find_engine("mujoco")


def loader(folder: Path, body: str) -> EngineJob:
    """A build whose own loader does something."""
    folder.mkdir()
    (folder / "load.py").write_text(body)
    return EngineJob(folder)


@pytest.mark.slow  # 7 s: it waits for a timeout
def test_crashes_and_hangs_are_answers_and_the_rest_goes_on(tmp_path: Path) -> None:
    good = EngineJob(built("good", primitives_scene(), [MUJOCO], tmp_path / "good").builds["mujoco"])
    crash = loader(
        tmp_path / "crash",
        "import os, sys\n"
        "def load():\n"
        "    print('last words', file=sys.stderr, flush=True)\n"
        "    os.kill(os.getpid(), 11)\n",
    )
    hang = loader(tmp_path / "hang", "import time\ndef load():\n    time.sleep(60)\n")
    leave = loader(tmp_path / "leave", "import os\ndef load():\n    os._exit(7)\n")
    wrong = loader(tmp_path / "wrong", "def load():\n    raise ValueError('<bad> build')\n")
    chatty = loader(tmp_path / "chatty", "import os\ndef load():\n    os.write(1, b'noise')\n    raise KeyError('x')\n")
    done: list[int] = []
    answers = ask(HERE, MUJOCO.readback, [crash, good, hang, wrong, leave, chatty, good], 6.0, done.append)
    assert [a.facts is not None for a in answers] == [False, True, False, False, False, False, True]
    assert answers[0].error == "crashed: SIGSEGV; its last output was: last words"
    assert answers[2].error == "did not respond within 6 s"
    assert answers[3].error == "ValueError: <bad> build"
    assert answers[4].error == "ended with exit code 7"
    assert answers[5].error == "KeyError: 'x'"
    assert done == [1, 2, 3, 4, 5, 6, 7]


def test_a_run_says_where_things_are(tmp_path: Path) -> None:
    from simfoundry.verify.rigs import lopsided, posed

    folder = built("fall", scene_of(lopsided("stone", posed(0, 0, 5, 0.3))), [MUJOCO], tmp_path).builds["mujoco"]
    (answer,) = ask(HERE, MUJOCO.readback, [EngineJob(folder, Run(0.5, 0.1))], 30.0)
    times = [m.time for m in answer.moments]
    assert times == pytest.approx([0, 0.1, 0.2, 0.3, 0.4, 0.5])
    for moment in answer.moments:
        fallen = 5 - moment.pose("stone").p[2]
        assert fallen == pytest.approx(9.81 * moment.time * (moment.time + 0.002) / 2, abs=1e-6)


def test_engines_are_found_here_and_elsewhere(tmp_path: Path) -> None:
    bare = tmp_path / "python"
    bare.write_text("#!/bin/sh\necho '{}'\n")
    bare.chmod(bare.stat().st_mode | stat.S_IXUSR)
    newton = tmp_path / "newton"
    newton.write_text('#!/bin/sh\necho \'{"newton:newton": "9.9", "warp:warp-lang": "1", "mujoco:mujoco": "3", '
                      '"mujoco_warp:mujoco-warp": "3"}\'\n')  # fmt: skip
    newton.chmod(newton.stat().st_mode | stat.S_IXUSR)
    engines = {engine.name: engine for engine in all_engines()}
    places = interpreters([f"mujoco={bare}"], (), {"SIMFOUNDRY_ENGINES": f"{bare},newton={newton}"})
    found = find_installed(engines, places)
    mujoco, from_mjcf = found["mujoco"], found["newton-mjcf"]
    assert mujoco is not None
    assert mujoco.python == HERE  # the one that was named does not have it
    assert from_mjcf is not None
    assert (from_mjcf.python, from_mjcf.version) == (newton, "9.9")
    assert found["newton-usd"] is None  # pxr is missing there


def test_what_is_no_engine_is_said_with_those_there_are(tmp_path: Path) -> None:
    with pytest.raises(UnknownEngineError, match=r"no engine is called `bullet`; available engines: .*mujoco, "):
        find_engine("bullet")
    with pytest.raises(UnknownEngineError, match="no engine is called `bullet`"):
        interpreters([f"bullet={HERE}"], (), {})
    with pytest.raises(SimfoundryError, match=r"the interpreter .*nowhere, configured for drake, does not exist"):
        interpreters([f"drake={tmp_path}/nowhere"], (), {})


def test_facts_survive_the_way_between_processes() -> None:
    from simfoundry.verify.expected import expected_readback
    from tests.scenes import full_scene

    facts = expected_readback(full_scene(), "urdf")
    assert WorldReadback.from_json(facts.to_json()) == facts


def test_bounds_contain_the_shape_and_touch_it() -> None:
    import numpy as np

    from simfoundry.geometry.shapes import tessellate
    from tests.scenes import box, pose

    X = pose(0.3, -0.2, 0.1, 0.7, -0.4, 1.9)
    corners = mesh_bounds(np.array(tessellate(box(0.1, 0.2, 0.3)).vertices), X)
    assert shape_bounds("box", [0.1, 0.2, 0.3], X) == pytest.approx(corners, abs=1e-12)
    for kind, height in (("cylinder", 0.3), ("capsule", 0.3)):
        turn = np.linspace(0, 2 * np.pi, 720)
        rim = 0.05 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
        ends = np.concatenate([rim + [0, 0, height / 2], rim - [0, 0, height / 2]])
        low, high = np.reshape(shape_bounds(kind, [0.05, height], X), (2, 3))
        points = X.apply(ends)
        slack = 1e-5 if kind == "cylinder" else 0.05
        assert (points.min(axis=0) >= low - 1e-9).all()
        assert (points.max(axis=0) <= high + 1e-9).all()
        assert np.abs(points.max(axis=0) - high).max() <= slack
    assert pose_of((0, 0, 0, 1, 0, 0, 0)).is_identity
