"""Trials in processes of their own: physics, policies that hang, and recordings."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from simfoundry.scene.state import SceneState
from simfoundry.studio.session import StudioSession
from simfoundry.studio.trial.engine import Push, TrialDocument
from simfoundry.studio.trial.physics import PhysicsTrial
from simfoundry.studio.trial.playback import Playback

# Seconds for a process that imports a simulator on a busy machine.
PATIENCE = 90.0


def until(condition: Callable[[], Any], what: str = "") -> None:
    """Wait until a condition holds."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, f"{what or condition} did not happen"
        time.sleep(0.02)


class Stage:
    """What a trial shows and tells."""

    def __init__(self) -> None:
        self.states: list[SceneState] = []
        self.said: list[str] = []

    def height(self, name: str) -> float:
        """Return the height of an object in the last state [m]."""
        return float(self.states[-1].poses[name].p[2])


def document_of(path: Path, edited: tuple[str, str] | None = None) -> TrialDocument:
    """Return a document to try, with an edit that is not saved."""
    session = StudioSession(path)
    texts = dict(session.texts)
    if edited is not None:
        texts[session.path] = texts[session.path].replace(*edited)
    return TrialDocument(session.path, texts)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_physics_plays_steps_pushes_settles_and_resets(desk: Path, engine: str) -> None:
    pytest.importorskip(engine)
    stage = Stage()
    lifted = document_of(desk, ("0.0201]", "0.2]"))  # unsaved: the ball is in the air
    physics = PhysicsTrial(lifted, engine, stage.states.append, stage.said.append)
    try:
        until(lambda: stage.states)
        assert stage.height("ball") == pytest.approx(0.2)
        physics.step(0.1)
        until(lambda: len(stage.states) == 2)
        assert stage.height("ball") == pytest.approx(0.2 - 9.81 * 0.1**2 / 2, abs=5e-3) and not physics.is_playing
        physics.play()
        until(lambda: stage.height("ball") < 0.03, "the fall")
        physics.pause()
        before = stage.states[-1].poses["mug"].p
        physics.push(Push("mug", (4.0, 0.0, 0.0), tuple(before.tolist())), 0.1)
        for _ in range(10):
            physics.step()
        until(lambda: stage.states[-1].poses["mug"].p[0] > before[0] + 0.02, "the push")
        settled: list[Any] = []
        physics.settle(lambda state, problems: settled.append((state, problems)))
        until(lambda: settled, "settling")
        assert settled[0][0].poses["ball"].p[2] == pytest.approx(0.02, abs=2e-3)
        physics.reset()
        until(lambda: stage.height("ball") == pytest.approx(0.2), "the reset")
        assert physics.elapsed == 0.0 and stage.said == []
    finally:
        physics.close()


@pytest.mark.slow
def test_a_scene_that_cannot_be_opened_is_told(desk: Path) -> None:
    stage = Stage()
    physics = PhysicsTrial(
        document_of(desk, ("mass: 0.3", "mass: heavy")), "mujoco", stage.states.append, stage.said.append
    )
    until(lambda: stage.said)
    assert "expected a number" in stage.said[0]
    physics.close()


def test_a_recording_plays_at_real_speed_and_is_scrubbed() -> None:
    shown: list[float] = []
    playback = Playback(lambda state: shown.append(state.joints["time"]), hz=50.0)
    for k in range(51):
        playback.add(SceneState.of({}, {"time": k / 50}))
    playback.add(SceneState.of({}, {"time": 9.0}))
    playback.complete(51)
    assert (playback.duration, shown) == (1.0, [0.0])
    playback.seek(0.5)
    assert shown[-1] == 0.5
    begun = time.monotonic()
    playback.play()
    until(lambda: not playback.is_playing)
    assert 0.4 < time.monotonic() - begun < 5.0 and shown[-1] == 1.0
    assert shown[1:] == sorted(shown[1:])
    playback.seek(7.0)
    assert playback.position == 1.0
    playback.play()  # from the start, because it was at the end
    until(lambda: 0.0 <= playback.position < 0.9)
    playback.pause()
    playback.close()
    assert not any(thread.name == "studio-playback" and thread.is_alive() for thread in threading.enumerate())
