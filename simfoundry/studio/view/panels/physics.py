"""Physics: play, pause, step, reset, push, and keep what came of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from simfoundry.scene.state import SceneState
from simfoundry.studio.acts.keep import KeepState
from simfoundry.studio.trial.physics import PhysicsTrial
from simfoundry.studio.view.panels.panel import Panel, by_person, set_value
from simfoundry.worlds import world_names

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

# Number of sentences about objects that did not settle well that are shown.
MAX_PROBLEMS = 4

OF_COUSIN = "The state of a cousin cannot be kept in the document; go back to the document, or open the cousin itself."


class PhysicsPanel(Panel):
    """The buttons of physics, and what it does at the moment."""

    edits = False

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        gui = window.gui
        with gui.add_folder("Physics"):
            names = world_names()
            self._engine = gui.add_dropdown("Engine", names, initial_value=names[0])
            self._run = gui.add_button_group("Physics", ("Play", "Pause", "Step", "Reset"))
            self._run.on_click(lambda event: self._press(event.target.value))
            force = gui.add_slider("Poke [N]", 0.1, 20.0, 0.1, window.pull.poke_n)
            force.on_update(by_person(self._set_force))
            if window.is_editable:
                gui.add_button("Settle and keep").on_click(lambda _: self._settle())
                gui.add_button("Keep this state").on_click(lambda _: self._keep())
            self._status = gui.add_markdown("")

    def refresh(self) -> None:
        """Show what physics does."""
        trial, text = self.window.stage.trial, ""
        if isinstance(trial, PhysicsTrial):
            rate = f", at {trial.rate:.0%} of real time" if trial.is_playing and trial.rate < 0.9 else ""
            text = f"{'Playing' if trial.is_playing else 'Paused'} at {trial.elapsed:.2f} s{rate}. "
            text += "Click on an object to poke it, or drag the handle of the selected one."
        set_value(self._status, text)

    def _set_force(self, event: Any) -> None:
        self.window.pull.poke_n = float(event.target.value)

    def _press(self, button: str) -> None:
        stage = self.window.stage

        def press() -> None:
            trial = self._physics()
            actions = {"Play": trial.play, "Pause": trial.pause, "Step": trial.step, "Reset": trial.reset}
            actions[button]()
            self.window.request_refresh()

        stage.run(press)

    def _physics(self) -> PhysicsTrial:
        """Return the physics that is shown, which is started if there is none."""
        stage = self.window.stage
        if isinstance(stage.trial, PhysicsTrial):
            return stage.trial
        engine = self._engine.value
        trial = stage.begin(lambda document, show, tell: PhysicsTrial(document, engine, show, tell), tries_cousin=True)
        trial.pull_by(self.window.pull.forces)
        return trial

    def _settle(self) -> None:
        if self.window.stage.cousin is not None:
            self.window.stage.tell(OF_COUSIN)
            return
        self.window.stage.run(lambda: self._physics().settle(self._settled))

    def _settled(self, state: SceneState, problems: Sequence[str]) -> None:
        stage = self.window.stage
        rest = f" and {len(problems) - MAX_PROBLEMS} more" if len(problems) > MAX_PROBLEMS else ""
        said = f" But {'; '.join(problems[:MAX_PROBLEMS])}{rest}." if problems else ""

        def done() -> None:
            stage.end()
            stage.tell(f"Settled and kept, as one edit that can be undone.{said}")

        self.window.submit(KeepState(state), then=done)

    def _keep(self) -> None:
        stage, state = self.window.stage, self.window.shown_state
        if stage.cousin is not None:
            stage.tell(OF_COUSIN)
            return
        if state is None or stage.trial is None:
            stage.tell("There is no state to keep; press Play first.")
            return
        self.window.submit(KeepState(state, "try"), then=stage.end)
