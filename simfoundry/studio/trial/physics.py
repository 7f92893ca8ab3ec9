"""Physics of a scene in real time: play, pause, step, reset, push and settle."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any

from simfoundry.errors import SimfoundryError
from simfoundry.runtime.workers import Limits, Worker, WorkerError
from simfoundry.scene.state import SceneState
from simfoundry.studio.trial.engine import Push, TrialDocument
from simfoundry.studio.trial.states import state_data, state_of

ENGINE = "simfoundry.studio.trial.engine"

# Time between two pictures [s]. More pictures per second do not look smoother, and cost time in each browser.
FRAME_S = 1 / 30

# Maximum time for an answer [s], which settling of a heavy scene or decomposing its meshes may take.
SILENCE_S = 300.0


class PhysicsTrial:
    """A world in a process of its own, and the thread that advances it.

    All methods return at once. ``show`` receives each state, and ``tell`` each sentence for people; both are called by
    the thread. The text of the document is never changed.

    Attributes:
        is_playing: Whether physics advances by itself.
        elapsed: The simulated time since the last reset [s].
        rate: The simulated time per real time while playing: 1 if physics keeps up.
    """

    def __init__(
        self,
        document: TrialDocument,
        engine: str,
        show: Callable[[SceneState], object],
        tell: Callable[[str], object],
    ) -> None:
        self._show, self._tell = show, tell
        self._worker = Worker(Limits.shared(SILENCE_S, 1))
        self._commands: SimpleQueue[Callable[[], object] | None] = SimpleQueue()
        self._pull: Callable[[], Sequence[Push]] = tuple
        self._pushes: list[tuple[Push, float]] = []  # with the time for which each of them still acts
        self._closed = False
        self.is_playing = False
        self.elapsed = 0.0
        self.rate = 1.0
        self._commands.put(lambda: self._shown(self._ask("begin", document, engine)))
        self._thread = Thread(target=self._work, name="studio-physics", daemon=True)
        self._thread.start()

    # -- what people do ---------------------------------------------------------------------------------------------

    def play(self) -> None:
        """Advance in real time."""
        self.is_playing = True
        self._commands.put(lambda: None)  # wakes the thread

    def pause(self) -> None:
        """Stop advancing."""
        self.is_playing = False

    def step(self, seconds: float = FRAME_S) -> None:
        """Advance once, and pause."""
        self.is_playing = False
        self._commands.put(lambda: self._advance(seconds))

    def reset(self, state: SceneState | None = None) -> None:
        """Return to a state, by default the initial one, and pause."""
        self.is_playing = False

        def back() -> None:
            self._pushes.clear()
            self.elapsed = 0.0
            self._shown(self._ask("reset", None if state is None else state_data(state)))

        self._commands.put(back)

    def push(self, push: Push, seconds: float) -> None:
        """Apply a force for a while; it acts as soon as physics advances."""
        self._commands.put(lambda: self._pushes.append((push, seconds)))

    def pull_by(self, forces: Callable[[], Sequence[Push]]) -> None:
        """Apply the forces that a function returns, which is called whenever physics advances."""
        self._pull = forces

    def settle(self, then: Callable[[SceneState, Sequence[str]], object]) -> None:
        """Settle from the present state. ``then`` receives the state at rest and a sentence for each problem."""
        self.is_playing = False

        def run() -> None:
            found = self._ask("settle_objects")
            state = state_of(found["state"])
            self._show(state)
            then(state, found["problems"])

        self._commands.put(run)

    def close(self) -> None:
        """End the process, even if it hangs."""
        self._closed, self.is_playing = True, False
        self._commands.put(None)
        self._worker.close()
        self._thread.join(timeout=5)

    # -- the thread -------------------------------------------------------------------------------------------------

    def _work(self) -> None:
        due = time.monotonic()
        while not self._closed:
            try:
                if self.is_playing:
                    now = time.monotonic()
                    due = max(due, now - FRAME_S)  # physics that is slower than real time does not catch up later
                    command = self._commands.get(timeout=max(0.0, due - now))
                else:
                    command = self._commands.get()
                    due = time.monotonic()
            except Empty:
                command = self._tick
                due += FRAME_S
            if command is None:
                return
            try:
                command()
            except SimfoundryError as error:
                self.is_playing = False
                if not self._closed:
                    self._tell(f"physics stopped, because it {error}" if isinstance(error, WorkerError) else str(error))

    def _tick(self) -> None:
        begun = time.monotonic()
        self._advance(FRAME_S)
        self.rate = min(1.0, FRAME_S / max(time.monotonic() - begun, 1e-6))

    def _advance(self, seconds: float) -> None:
        pushes = [*self._pull(), *(push for push, _ in self._pushes)]
        self._pushes = [(push, left - seconds) for push, left in self._pushes if left > seconds]
        found = self._ask("advance", seconds, pushes)
        self.elapsed += seconds
        self._shown(found)

    def _shown(self, data: Any) -> None:
        self._show(state_of(data))

    def _ask(self, function: str, *arguments: Any) -> Any:
        answer = self._worker.call(f"{ENGINE}:{function}", *arguments)
        if isinstance(answer, SimfoundryError):
            raise answer
        return answer
