"""States over time that are played at real speed, with a slider: a policy that runs, or a recording."""

from __future__ import annotations

import time
from collections.abc import Callable
from threading import Condition, Thread

from simfoundry.scene.state import SceneState
from simfoundry.studio.trial.physics import FRAME_S

# Maximum number of states that are kept: an hour at 15 Hz, which takes about a gigabyte for twenty objects.
MAX_FRAMES = 54_000


class Playback:
    """States at a constant frequency, of which one is shown. States may be added while others are played.

    Attributes:
        hz: The number of states per second [Hz].
        position: The time of the state that is shown [s].
        speed: The factor by which playing is faster than real time.
        is_playing: Whether the position advances.
        is_complete: False while more states may be added.
    """

    def __init__(self, show: Callable[[SceneState], object], hz: float = 15.0) -> None:
        self._show = show
        self._frames: list[SceneState] = []
        self._changed = Condition()
        self._closed = False
        self.hz, self.position, self.speed = hz, 0.0, 1.0
        self.is_playing, self.is_complete = False, False
        self._thread = Thread(target=self._work, name="studio-playback", daemon=True)
        self._thread.start()

    @property
    def duration(self) -> float:
        """The time of the last state so far [s]."""
        return max(0, len(self._frames) - 1) / self.hz

    @property
    def count(self) -> int:
        """The number of states so far."""
        return len(self._frames)

    def add(self, state: SceneState) -> None:
        """Add the next state."""
        with self._changed:
            if len(self._frames) < MAX_FRAMES:
                self._frames.append(state)
            if len(self._frames) == 1:
                self._show(state)
            self._changed.notify()

    def complete(self, count: int = MAX_FRAMES) -> None:
        """State that no more states follow, and drop those after the first ``count``."""
        with self._changed:
            del self._frames[count:]
            self.position = min(self.position, self.duration)
            self.is_complete = True
            self._changed.notify()

    def play(self) -> None:
        """Play from the position on, or from the start if it is at the end."""
        with self._changed:
            if self.is_complete and self.position >= self.duration:
                self.position = 0.0
            self.is_playing = True
            self._changed.notify()

    def pause(self) -> None:
        """Stop at the position."""
        with self._changed:
            self.is_playing = False

    def seek(self, position: float) -> None:
        """Show the state at a time [s]."""
        with self._changed:
            self.position = min(max(position, 0.0), self.duration)
            self._show_present()

    def close(self) -> None:
        """End playing."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join(timeout=5)

    def _show_present(self) -> None:
        if self._frames:
            self._show(self._frames[min(len(self._frames) - 1, round(self.position * self.hz))])

    def _work(self) -> None:
        last = time.monotonic()
        while True:
            with self._changed:
                if self._closed:
                    return
                waits = not self.is_playing or (self.position >= self.duration and not self.is_complete)
                self._changed.wait(None if waits else FRAME_S)
                now = time.monotonic()
                passed, last = now - last, now
                if self.is_playing and not waits:
                    self.position = min(self.position + passed * self.speed, self.duration)
                    self._show_present()
                    if self.is_complete and self.position >= self.duration:
                        self.is_playing = False
