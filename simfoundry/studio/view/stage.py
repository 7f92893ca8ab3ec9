"""States that the window shows in place of the document's initial state: physics, a rollout, a recording or a cousin.

Only one of them is shown at a time, for all windows of the session. It ends when the text changes, and nothing here
changes the text.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import RLock
from typing import TYPE_CHECKING, Protocol, TypeVar

from simfoundry.errors import SimfoundryError
from simfoundry.scene.state import SceneState
from simfoundry.studio.reading import StudioScene
from simfoundry.studio.trial.engine import TrialDocument

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

# Interval at which panels follow a trial [s]: numbers that change more often cannot be read.
PANELS_S = 0.4


class StagedTrial(Protocol):
    """A trial that the window can show."""

    def close(self) -> None:
        """End the trial, even if its process hangs."""


AnyTrial = TypeVar("AnyTrial", bound=StagedTrial)

# Functions for a trial: they show a state, and tell people a sentence.
Show = Callable[[SceneState], None]
Tell = Callable[[str], None]


class TrialStage:
    """The trial that is shown.

    Attributes:
        message: The latest sentence about a trial.
        cousin: The scene of a cousin that is shown in place of the document, or None.
    """

    def __init__(self, window: StudioWindow) -> None:
        self._window = window
        self._lock = RLock()
        self._trial: StagedTrial | None = None
        self._scene: StudioScene | None = None
        self._was_editable = True
        self._refreshed = 0.0
        self._jobs = ThreadPoolExecutor(1, "studio-trials")  # what takes longer, such as reading a recording
        self.message = ""
        self.cousin: StudioScene | None = None
        self._unsubscribe = window.session.subscribe(self._follow)

    @property
    def trial(self) -> StagedTrial | None:
        """The running trial, or None."""
        return self._trial

    def begin(self, create: Callable[[TrialDocument, Show, Tell], AnyTrial], tries_cousin: bool = False) -> AnyTrial:
        """End what is shown, and begin something else.

        Args:
            create: Function that creates the trial from the document, and from functions that show a state and tell
                people a sentence. These may be called from any thread.
            tries_cousin: Whether the cousin that is shown, if any, is tried instead of the document.

        Raises:
            SimfoundryError: If the text has an error.
        """
        session = self._window.session
        with session.lock, self._lock:
            cousin = self.cousin if tries_cousin else None
            self.end()
            if session.scene is None or not session.is_current:
                raise SimfoundryError("the text has an error, so nothing can be tried; correct it first")
            self._scene, self.message = session.scene, ""
            document = TrialDocument(session.path, dict(session.texts))
            if cousin is not None:
                self.cousin, document = cousin, TrialDocument(cousin.root.path, {})
            token = object()
            self._token = token

            def show(state: SceneState) -> None:
                if self._token is token:
                    self._show(state)

            def tell(text: str) -> None:
                if self._token is token:
                    self.tell(text)

            self._was_editable, self._window.is_editable = self._window.is_editable, False
            trial = create(document, show, tell)
            self._trial = trial
        self._window.request_refresh()
        return trial

    def show_cousin(self, scene: StudioScene | None) -> None:
        """Show the scene of a cousin, or the document again."""
        with self._lock:
            self.end()
            if scene is not None:
                self._was_editable, self._window.is_editable = self._window.is_editable, False
                self._scene = self._window.session.scene
            self.cousin = scene
        self._window.request_refresh()

    def end(self) -> None:
        """Show the document again."""
        with self._lock:
            trial, self._trial, self._token = self._trial, None, None
            if trial is not None or self.cousin is not None:
                self._window.is_editable = self._was_editable
            self._scene = self.cousin = None
            self._window.show_state(None)
        if trial is not None:
            trial.close()
        self._window.request_refresh()

    def run(self, work: Callable[[], object]) -> None:
        """Run work that takes longer, after that requested before. Errors become the message."""

        def guarded() -> None:
            try:
                work()
            except (SimfoundryError, OSError) as error:
                self.tell(str(error))

        self._jobs.submit(guarded)

    def tell(self, text: str) -> None:
        """Show a sentence about the trial."""
        self.message = text
        self._window.request_refresh()

    def close(self) -> None:
        """End the trial, and stop following the session."""
        self._unsubscribe()
        self.end()
        self._jobs.shutdown(wait=False, cancel_futures=True)

    _token: object | None = None

    def _show(self, state: SceneState) -> None:
        self._window.show_state(state)
        if (now := time.monotonic()) - self._refreshed > PANELS_S:
            self._refreshed = now
            self._window.request_refresh()

    def _follow(self, _what: str) -> None:
        """End a trial of a text that has changed."""
        is_shown = self._trial is not None or self.cousin is not None
        if is_shown and self._window.session.scene is not self._scene:
            self.end()
            self.tell("The text has changed, so that the document is shown again.")
