"""The page of a session: the world as it is, the goal and the sub-tasks, and buttons for the attempt."""

from __future__ import annotations

import html
import json
import logging
import time
from dataclasses import replace
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.evaluate.rollouts.rollout import Progress
from simfoundry.evaluate.task import Task
from simfoundry.predicates import Judge
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.predicate import texts
from simfoundry.studio.view.canvas import Canvas, prepare_view
from simfoundry.studio.view.nodes import DisplayOptions, ViewNode, object_nodes, scene_nodes
from simfoundry.studio.view.panels.panel import by_person, set_value
from simfoundry.studio.view.robots import ShownRobots, robot_at
from simfoundry.teleop.commands import Control
from simfoundry.teleop.keys import CONTROLS_HELP, HELP
from simfoundry.teleop.motion import PoseMotion
from simfoundry.teleop.session import SessionView
from simfoundry.teleop.sources import LiveSource
from simfoundry.teleop.teleoperator import Teleoperator

if TYPE_CHECKING:
    from viser import ViserServer

# Interval between two pictures of the world, and between two updates of the panel [s]. Numbers that change more often
# cannot be read, and browsers without a GPU draw no faster.
PICTURE_S, PANEL_S = 1 / 30, 0.2

# Length of the arrows of the gizmo [m]; they protrude from a gripper.
GIZMO_M = 0.2

# Motion that nobody sees [m, rad]: a tenth of a pixel from a distance of a meter. Servos and contacts always tremble,
# and each message makes browsers draw the world again.
INVISIBLE_M, INVISIBLE_RAD = 1e-4, 1e-4

_log = logging.getLogger(__name__)


class TeleopWindow(SessionView):
    """The page, which all windows of a session share. It follows the session in a thread of its own."""

    def __init__(
        self, server: ViserServer, task: Task, teleoperator: Teleoperator, source: LiveSource, count: int
    ) -> None:
        self._server, self._task, self._teleoperator, self._source = server, task, teleoperator, source
        self._count, self._kept, self._attempt = count, 0, 0
        self._canvas = Canvas(server.scene)
        self._robots = ShownRobots()
        self._judge = Judge(task.scene)
        self._progress: Progress | None = None
        self._lock, self._dirty, self._is_ended = Lock(), Event(), False
        self._state = SceneState.initial(task.scene)
        self._message, self._is_over = "", False
        self._gizmo: Any = None
        self._is_dragged = False
        self._build()
        self._thread = Thread(target=self._work, name="teleop-view", daemon=True)
        self._thread.start()

    # -- the session --------------------------------------------------------------------------------------------------

    def begin(self, task: Task, attempt: int, kept: int) -> None:
        """An attempt begins."""
        with self._lock:
            self._attempt, self._kept, self._progress = attempt, kept, None
            self._message, self._is_over = "", False
        self._dirty.set()

    def show(self, state: SceneState) -> None:
        """Show a state soon."""
        with self._lock:
            self._state = state
            if self._progress is None:
                self._progress = Progress(self._task, self._judge, state)
        self._dirty.set()

    def tell(self, text: str, is_over: bool = False) -> None:
        """Show a sentence."""
        with self._lock:
            self._message, self._is_over = text, is_over
        self._dirty.set()

    def refresh(self) -> None:
        """Show the present state of the session soon."""
        self._dirty.set()

    def close(self) -> None:
        """End the view."""
        self._is_ended = True
        self._dirty.set()
        self._thread.join(timeout=5)

    # -- what is shown ------------------------------------------------------------------------------------------------

    def _build(self) -> None:
        gui, server = self._server.gui, self._server
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
        gui.set_panel_label("SimFoundry teleoperation")
        prepare_view(server, self._task.scene, has_robot=True)
        gui.add_markdown("")
        self._instruction = gui.add_markdown("")
        set_value(self._instruction, f"**{self._task.instruction}**")
        self._status = gui.add_markdown("")
        self._table = gui.add_html("")
        self._buttons = {}
        for label, control in (
            ("Save", Control.SAVE), ("Discard", Control.DISCARD), ("Try again", Control.RETRY),
            ("Pause", Control.PAUSE), ("Mark sub-task", Control.MARK), ("End the session", Control.QUIT),
        ):  # fmt: skip
            button = gui.add_button(label)
            button.on_click(by_person(lambda _, control=control: self._source.press(control)))  # type: ignore[misc]
            self._buttons[control] = button
        with gui.add_folder("Keys"):
            gui.add_markdown(f"{HELP}\n\n{CONTROLS_HELP}" if self._device == "keyboard" else CONTROLS_HELP)
        if self._device == "gizmo":
            self._gizmo = server.scene.add_transform_controls("/gizmo", scale=GIZMO_M, depth_test=False, line_width=3.0)
            self._gizmo.on_update(self._drag)

    @property
    def _device(self) -> str:
        return self._teleoperator.device.name

    async def _drag(self, event: Any) -> None:
        """Send a drag to the device. This runs on the event loop, which keeps the order of events."""
        self._is_dragged = event.phase != "end"
        pose = [round(float(v), 6) for v in (*event.target.position, *event.target.wxyz)]
        self._source.packet(json.dumps({"robot": self._teleoperator.status.active, "pose": pose}).encode())

    def _work(self) -> None:
        self._robots.read(self._task.scene.robots)
        refreshed = 0.0
        while True:
            self._dirty.wait(PANEL_S)
            if self._is_ended:
                return
            self._dirty.clear()
            begun = time.monotonic()
            try:
                with self._lock:
                    state = self._state
                self._draw(state)
                if begun - refreshed >= PANEL_S:
                    refreshed = begun
                    self._refresh(state)
            except Exception:
                _log.exception("the page could not be updated")
            time.sleep(max(0.0, begun + PICTURE_S - time.monotonic()))

    def _draw(self, state: SceneState) -> None:
        scene, options = self._task.scene, DisplayOptions(cameras=False)
        nodes = scene_nodes(scene, options, state)
        for robot in self._robots.known(scene.robots):
            nodes |= object_nodes(robot_at(robot, state), options, "robots")
        motion = self._teleoperator.motion(self._teleoperator.status.active)
        shown = self._canvas.nodes
        with self._server.atomic():
            self._canvas.show(
                {name: _still(replace(node, selects=""), shown.get(name)) for name, node in nodes.items()}
            )
            if self._gizmo is not None and not self._is_dragged and isinstance(motion, PoseMotion):
                goal = motion.goal
                self._gizmo.position, self._gizmo.wxyz = goal.p, goal.q
        self._server.flush()

    def _refresh(self, state: SceneState) -> None:
        with self._lock:
            progress, message, is_over = self._progress, self._message, self._is_over
        status = self._teleoperator.status
        set_value(self._status, self._status_text(message))
        set_value(self._table, self._table_html(state, progress))
        pause = self._buttons[Control.PAUSE]
        if pause.label != (label := "Resume" if status.is_paused else "Pause"):
            pause.label = label
        for control, is_disabled in ((Control.SAVE, not is_over), (Control.PAUSE, is_over), (Control.MARK, is_over)):
            if self._buttons[control].disabled != is_disabled:
                self._buttons[control].disabled = is_disabled

    def _status_text(self, message: str) -> str:
        """Return what happens at the moment, in Markdown."""
        status, source, hz = self._teleoperator.status, self._source, self._teleoperator.action_hz
        wanted = f" of {self._count}" if self._count < 1000 else ""
        limit = self._task.horizon / self._task.control_hz
        lines = [
            f"Attempt {self._attempt + 1} · {self._kept}{wanted} saved · **{status.step / hz:.1f} s** of {limit:g} s"
        ]
        late = f"{source.pace.late} of {source.pace.steps} actions late"
        reaction = status.reaction_ms()
        lines.append(late + (f" · reaction {reaction['median']:g} ms" if reaction else ""))
        grippers = ", ".join(f"{name} {value:.0%}" for name, value in status.grippers.items())
        lines.append(f"moves **{status.active}** · gripper closed: {grippers} · {len(status.marks)} marks")
        refused = self._teleoperator.device.refused.total() + source.refused.total()
        if refused or source.dropped:
            lines.append(f"{refused} packets refused, {source.dropped} dropped")
        if status.lost:
            lines.append(f"⏸ **Paused: {status.lost}.**")
        elif status.is_paused:
            lines.append("⏸ **Paused.**")
        return "\n\n".join([*lines, *([f"**{message}**"] if message else [])])

    def _table_html(self, state: SceneState, progress: Progress | None) -> str:
        """Return the conditions of the goal and the sub-tasks, with their truth."""
        rows = [("goal", text, self._holds(text, state)) for text, _ in texts(self._task.goal)]
        if progress is not None:
            progress.see(1, state)
            rows += [("step", name, at is not None) for name, at in progress.subtasks.items()]
        cells = "".join(
            f"<tr><td>{kind}&nbsp;</td><td>{html.escape(text)}&nbsp;</td>"
            f'<td style="color:{"#1a8f3c" if holds else "#c22"}"><b>{_word(kind, holds)}</b></td></tr>'
            for kind, text, holds in rows
        )
        return f'<table style="font-size:0.8em;margin:0.4em">{cells}</table>'

    def _holds(self, text: str, state: SceneState) -> bool:
        return bool(self._judge(text, state).value)


def _still(node: ViewNode, shown: ViewNode | None) -> ViewNode:
    """Return a node at the pose at which it is shown, if nobody could see the difference."""
    if shown is None:
        return node
    shift, turn = np.abs(node.X_PN.p - shown.X_PN.p), np.abs(node.X_PN.q - shown.X_PN.q)
    return replace(node, X_PN=shown.X_PN) if shift.max() < INVISIBLE_M and turn.max() < INVISIBLE_RAD else node


def _word(kind: str, holds: bool) -> str:
    if kind == "step":
        return "done" if holds else "open"
    return "true" if holds else "false"
