"""Policies to run from a start of the task, recordings to open, and the player of both."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from simfoundry.errors import SimfoundryError
from simfoundry.studio.trial.engine import TrialDocument
from simfoundry.studio.trial.folders import has_recordings
from simfoundry.studio.trial.playback import Playback
from simfoundry.studio.trial.recordings import Recording, demonstration_states, find_recordings
from simfoundry.studio.trial.rollouts import RolloutTrial
from simfoundry.studio.view.panels.folders import NONE, FolderChoice
from simfoundry.studio.view.panels.panel import Panel, by_person, set_value
from simfoundry.studio.view.stage import Show, Tell
from simfoundry.worlds import world_names

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

# Policies that need nothing besides the task. Others are named when the studio is started, because they run code.
BUILT_IN = ("expert", "random")

# Factors of real time.
SPEEDS = {"1/4": 0.25, "1/2": 0.5, "1": 1.0, "2": 2.0, "4": 4.0}


class RolloutPanel(Panel):
    """Run a policy and watch it, or open a recording."""

    edits = False

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        gui = window.gui
        self._policies = policies = tuple(dict.fromkeys((*window.policies, *BUILT_IN)))
        with gui.add_folder("Policy"):
            self._policy = gui.add_dropdown("Policy", policies, initial_value=policies[0])
            self._index = gui.add_number("Start", 0, min=0, max=9999, step=1)
            self._seed = gui.add_number("Seed", 0, min=0, step=1)
            names = world_names()
            self._engine = gui.add_dropdown("In", names, initial_value=names[0])
            self._buttons = gui.add_button_group("Policy run", ("Run", "Stop"))
            self._buttons.on_click(lambda event: self._run() if event.target.value == "Run" else self._stop())
        with gui.add_folder("Recording", expand_by_default=False):
            self._folders = FolderChoice(window, "Recorded in", "recordings", has_recordings, self._list)
            self._choice = gui.add_dropdown("Rollout", (NONE,), initial_value=NONE)
            self._choice.on_update(by_person(lambda event: window.stage.run(lambda: self._show(event.target.value))))
        self._recordings: dict[str, Recording] = {}

    def _run(self) -> None:
        policy, engine = self._policy.value, self._engine.value
        index, seed = int(self._index.value), int(self._seed.value)
        if policy not in self._policies:  # a browser may send anything, and a policy can be any code
            return

        def create(document: TrialDocument, show: Show, tell: Tell) -> RolloutTrial:
            return RolloutTrial(show, tell, "run_policy", document, policy, index, seed, engine)

        self.window.stage.run(lambda: self.window.stage.begin(create, tries_cousin=True))

    def _stop(self) -> None:
        trial = self.window.stage.trial
        if isinstance(trial, RolloutTrial):
            trial.stop()

    def _list(self, folder: Path) -> None:
        scene = self.session.scene
        if scene is None:
            raise SimfoundryError("the text has an error, so there is no task whose recordings could be shown")
        found = find_recordings(folder, scene)
        self._recordings = {recording.label: recording for recording in found}
        self._choice.options = (NONE, *self._recordings)
        set_value(self._choice, NONE)
        self.window.stage.tell(f"{len(found)} recording{'s' * (len(found) != 1)} of the task; choose one.")

    def _show(self, label: str) -> None:
        recording, stage, scene = self._recordings.get(label), self.window.stage, self.session.scene
        if recording is None or scene is None:
            stage.end()
            return
        if recording.record is not None:
            record, actions = recording.record, recording.actions
            stage.begin(lambda doc, show, tell: RolloutTrial(show, tell, "run_recorded", doc, dict(record), actions))
            return
        states, hz = demonstration_states(recording, scene, self.window.robot_items)

        def create(_document: TrialDocument, show: Show, _tell: Tell) -> Playback:
            playback = Playback(show, hz)
            for state in states:
                playback.add(state)
            playback.complete()
            playback.play()
            return playback

        stage.begin(create)


class PlayerPanel(Panel):
    """A slider over time, which plays at real speed."""

    edits = False

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        gui = window.gui
        self._folder = gui.add_folder("Player", visible=False)
        with self._folder:
            self._time = gui.add_slider("Time [s]", 0.0, 1.0, 0.01, 0.0)
            self._time.on_update(by_person(self._seek))
            self._speed = gui.add_dropdown("Speed", tuple(SPEEDS), initial_value="1")
            self._speed.on_update(by_person(self._set_speed))
            self._buttons = gui.add_button_group("Player", ("Play", "Pause", "Close"))
            self._buttons.on_click(lambda event: self._press(event.target.value))
            self._status = gui.add_markdown("")

    @property
    def playback(self) -> Playback | None:
        """The rollout or recording that is played, or None."""
        trial = self.window.stage.trial
        return trial.playback if isinstance(trial, RolloutTrial) else trial if isinstance(trial, Playback) else None

    def refresh(self) -> None:
        """Follow what is played."""
        playback = self.playback
        if self._folder.visible != (playback is not None):
            self._folder.visible = playback is not None
        if playback is None:
            return
        longest = max(round(playback.duration, 2), 0.01)
        if self._time.max != longest:
            self._time.max = longest
        set_value(self._time, min(round(playback.position, 2), longest))
        trial = self.window.stage.trial
        state = "running" if isinstance(trial, RolloutTrial) and trial.is_running else "complete"
        set_value(self._status, f"{playback.position:.2f} of {playback.duration:.2f} s, {state}")

    def _seek(self, event: Any) -> None:
        playback = self.playback
        if playback is not None:
            playback.pause()
            playback.seek(float(event.target.value))

    def _set_speed(self, event: Any) -> None:
        playback = self.playback
        if playback is not None:
            playback.speed = SPEEDS[event.target.value]

    def _press(self, button: str) -> None:
        playback = self.playback
        if button == "Close":
            self.window.stage.end()
        elif playback is not None:
            playback.speed = SPEEDS[self._speed.value]
            (playback.play if button == "Play" else playback.pause)()
            self.window.request_refresh()
