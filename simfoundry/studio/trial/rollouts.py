"""Rollouts to watch: a policy that runs in a process of its own, or a recording that is replayed there."""

from __future__ import annotations

import json
from collections.abc import Callable
from threading import Thread
from typing import Any

from simfoundry.errors import SimfoundryError
from simfoundry.runtime.workers import Limits, Worker
from simfoundry.scene.state import SceneState
from simfoundry.studio.trial.physics import ENGINE
from simfoundry.studio.trial.playback import Playback
from simfoundry.studio.trial.states import state_of

# Maximum time between two states [s], after which a policy counts as hanging; it can be stopped at any time before.
SILENCE_S = 600.0


class RolloutTrial:
    """A rollout that is computed in a process of its own, and played as its states arrive.

    Attributes:
        playback: The states so far.
        is_running: Whether the rollout is still being computed.
        outcome: What came of it, once it has ended, or an empty mapping.
    """

    def __init__(
        self,
        show: Callable[[SceneState], object],
        tell: Callable[[str], object],
        function: str,
        *arguments: Any,
    ) -> None:
        """Start a function of :mod:`simfoundry.studio.trial.engine` that reports states.

        Args:
            show: Receives each state to show.
            tell: Receives each sentence for people about what happens.
            function: The name of the function.
            *arguments: Its arguments.
        """
        self._tell = tell
        self._worker = Worker(Limits.shared(SILENCE_S, 1))
        self._call = function, arguments
        self._stopped = False
        self.playback = Playback(show)
        self.is_running = True
        self.outcome: dict[str, Any] = {}
        self.playback.play()
        self._thread = Thread(target=self._work, name="studio-rollout", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the rollout, even if the policy hangs. The states so far stay."""
        self._stopped = True
        self._worker.close()

    def close(self) -> None:
        """End the rollout and its playback."""
        self.stop()
        self._thread.join(timeout=5)
        self.playback.close()

    def _work(self) -> None:
        function, arguments = self._call
        try:
            answer = self._worker.call(f"{ENGINE}:{function}", *arguments, progress=self._progress)
            if isinstance(answer, SimfoundryError):
                raise answer
            self.outcome = dict(answer)
            self.playback.complete(self.outcome["steps"] + 1)  # a policy may have answered beyond the success
            self._tell(ending(self.outcome))
        except SimfoundryError as error:
            self._tell("Stopped." if self._stopped else f"The rollout ended with an error: {error}")
        finally:
            self.is_running = False
            self.playback.complete()
            self._worker.close()

    def _progress(self, text: str) -> None:
        if not text.startswith("{"):  # what the libraries below report, such as a decomposition of meshes
            self._tell(text)
            return
        for kind, content in json.loads(text).items():
            if kind == "state":
                self.playback.add(state_of(content))
            elif kind == "hz":
                self.playback.hz = float(content)
            else:
                self._tell(f"{str(content)[:1].upper()}{str(content)[1:]} …")


def ending(outcome: dict[str, Any]) -> str:
    """Return one or two sentences about the outcome of a rollout."""
    steps = outcome["steps"]
    text = f"Success after {steps} control steps." if outcome["success"] else f"Failure: {outcome['reason']}."
    if outcome.get("is_identical") is False:
        text += " The replay differs from the recording, because the scene, the task or the engine has changed since."
    return text
