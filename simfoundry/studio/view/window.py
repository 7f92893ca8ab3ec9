"""The browser's view of a session, which all windows share: the scene, the selection, the gizmo and the panels."""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Any

from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Pose
from simfoundry.scene.model import Scene, SceneObject
from simfoundry.scene.state import SceneState
from simfoundry.studio.acts.act import Act
from simfoundry.studio.acts.move import MoveObject, Snap
from simfoundry.studio.journal import Journal
from simfoundry.studio.marks import ObjectMarks, read_marks, write_marks
from simfoundry.studio.reading import StudioScene
from simfoundry.studio.session import StudioSession
from simfoundry.studio.view.canvas import Canvas, prepare_view
from simfoundry.studio.view.capture_link import CaptureLink
from simfoundry.studio.view.gizmo import SelectionGizmo
from simfoundry.studio.view.lights import lamp_glyphs, light_nodes, panorama_nodes
from simfoundry.studio.view.nodes import DisplayOptions, Nodes, object_nodes, scene_nodes
from simfoundry.studio.view.panels.adding import AddPanel
from simfoundry.studio.view.panels.background import BackgroundPanel
from simfoundry.studio.view.panels.cameras import CameraPanel
from simfoundry.studio.view.panels.capture import CapturePanel
from simfoundry.studio.view.panels.conditions import ConditionsPanel, PredicatePanel
from simfoundry.studio.view.panels.cousins import CousinsPanel
from simfoundry.studio.view.panels.display import DisplayPanel
from simfoundry.studio.view.panels.document import DocumentPanel
from simfoundry.studio.view.panels.findings import FindingsPanel
from simfoundry.studio.view.panels.moving import JointPanel, MovingPanel
from simfoundry.studio.view.panels.objects import ObjectPanel
from simfoundry.studio.view.panels.panel import Panel
from simfoundry.studio.view.panels.physics import PhysicsPanel
from simfoundry.studio.view.panels.pieces import PiecesPanel
from simfoundry.studio.view.panels.recovery import RecoveryPanel
from simfoundry.studio.view.panels.refine import RefinePanel
from simfoundry.studio.view.panels.regions import RegionPanel
from simfoundry.studio.view.panels.rollouts import PlayerPanel, RolloutPanel
from simfoundry.studio.view.panels.shape import ShapePanel
from simfoundry.studio.view.panels.task import TaskPanel
from simfoundry.studio.view.panels.trial import TrialPanel
from simfoundry.studio.view.panels.versions import VersionsPanel
from simfoundry.studio.view.pictures import camera_pictures
from simfoundry.studio.view.pull import PullHandle
from simfoundry.studio.view.robots import ShownRobots, robot_at
from simfoundry.studio.view.stage import TrialStage

if TYPE_CHECKING:
    from viser import GuiApi, ViserServer

# The panels of each tab. Those without a tab are above all tabs.
PANELS: dict[str, tuple[type[Panel], ...]] = {
    "": (DocumentPanel, RecoveryPanel),
    "Edit": (ObjectPanel, ShapePanel, JointPanel, RegionPanel, AddPanel, MovingPanel),
    "Check": (FindingsPanel,),
    "Goal": (ConditionsPanel, PredicatePanel, TaskPanel),
    "Show": (DisplayPanel, CameraPanel),
    "Capture": (CapturePanel, RefinePanel, PiecesPanel, VersionsPanel, BackgroundPanel),
    "Try": (TrialPanel, PhysicsPanel, RolloutPanel, PlayerPanel, CousinsPanel),
}

# Width of the panels [px], with which the names of all tabs fit into one line.
PANEL_PX = 400

# Seconds that a message stays; long enough to read two sentences.
MESSAGE_S = 8.0

_log = logging.getLogger(__name__)


class StudioWindow:
    """The user interface of one session.

    Attributes:
        selection: What is selected, such as ``objects.mug``, or empty.
        options: What is shown besides the objects.
        state: The state that is shown, or None for the initial state of the document.
        is_editable: Whether objects can be moved. It is False while physics runs.
        is_picking: Whether clicks mark points, so that they select nothing, and no arrows are in the way.
        drops: Whether moved objects fall onto what is beneath.
        snap: What moved objects snap to.
        hidden: Names of objects that are not shown.
        move_act: Makes the act of an object that is dragged to a pose.
        capture: The capture from which the scene was reconstructed.
        previews: Called with the name of a node and its pose while it is dragged.
        journal: The journal of the session, or None if it has none.
        policies: The policies that can be tried, as in `simfoundry eval`.
        stage: What is tried, such as physics.
    """

    def __init__(
        self,
        session: StudioSession,
        server: ViserServer,
        is_editable: bool = True,
        capture: Path | None = None,
        journal: Journal | None = None,
        policies: tuple[str, ...] = (),
    ) -> None:
        self.session, self.server, self.journal = session, server, journal
        self.is_editable, self.policies = is_editable, policies
        self.selection = ""
        self.options = DisplayOptions()
        self.state: SceneState | None = None
        self.is_picking = False
        self.drops = True
        self.snap = Snap()
        marks = read_marks(session.path) if journal is not None else ObjectMarks()
        self.session.locked, self.hidden = marks.locked, marks.hidden
        self.move_act: Callable[[str, Pose], Act] = self._plain_move
        self.previews: list[Callable[[str, Pose], None]] = []
        self.capture = CaptureLink(self, capture)
        self.canvas = Canvas(server.scene, self._select_by_click, self._poke)
        self.gizmo = SelectionGizmo(self)
        self._dirty, self._is_moved_only, self._stopped = Event(), False, False
        self.stage = TrialStage(self)
        self.pull = PullHandle(self)
        self._acts = ThreadPoolExecutor(1, "studio-acts")  # acts happen one after another
        self._latest: dict[str, Act] = {}
        self._robots = ShownRobots()
        self._pictured: Scene | None = None
        self._examined: object = None
        self._prepare_scene()
        self._panels = self._built_panels()
        self._unsubscribe = session.subscribe(lambda _what: self.request_refresh())
        server.on_client_disconnect(lambda client: self.gizmo.cancel(client.client_id))
        self.refresh()
        self._worker = Thread(target=self._work, name="studio-view", daemon=True)
        self._worker.start()
        self.capture.start()
        self.request_refresh()

    @property
    def gui(self) -> GuiApi:
        """The controls of the browser, to which panels add theirs."""
        return self.server.gui

    @property
    def selected_object(self) -> str:
        """The name of the selected object, or an empty string."""
        section, _, name = self.selection.partition(".")
        return name if section == "objects" else ""

    def panel(self, kind: type[Any]) -> Any:
        """Return the panel of a class."""
        return next(panel for panel in self._panels if isinstance(panel, kind))

    # -- what people do ---------------------------------------------------------------------------------------------

    def select(self, name: str) -> None:
        """Select something, such as ``objects.mug``, or nothing if the name is empty."""
        self.selection = name
        self.request_refresh()

    def submit(self, act: Act, gesture: str = "", then: Callable[[], None] = lambda: None) -> None:
        """Apply an act after those submitted before, and then call ``then`` if it was possible."""

        def apply() -> None:
            notes = self.session.apply(act, gesture)
            then()
            if notes:
                self.tell(act.label, " ".join(f"{note}." for note in notes))

        self.run(apply)

    def submit_latest(self, act: Act, gesture: str) -> None:
        """Apply the latest act of a continuous gesture; those that later ones replace before their turn are skipped."""
        is_waiting = gesture in self._latest
        self._latest[gesture] = act
        if not is_waiting:
            self.run(lambda: self.session.apply(self._latest.pop(gesture), gesture))

    def _plain_move(self, name: str, X_WO: Pose) -> Act:
        return MoveObject(name, X_WO, drop=self.drops, snap=self.snap)

    def run(self, work: Callable[[], object]) -> None:
        """Run work that changes the session after that submitted before. Errors are shown as messages."""
        self._acts.submit(self._guarded, work)

    def mark(self, locked: frozenset[str], hidden: frozenset[str]) -> None:
        """Lock and hide exactly these objects, in later studios of the document, too."""
        self.session.locked, self.hidden = locked, hidden
        if self.journal is not None:
            self.run(lambda: write_marks(self.session.path, ObjectMarks(locked, hidden)))
        self.request_refresh()

    def save(self) -> None:
        """Save all documents."""

        def write() -> None:
            written = self.session.save()
            names = ", ".join(self.session.shown_path(path) for path in written)
            self.tell("Saved", names or "There was nothing to save.")

        self.run(write)

    def tell(self, title: str, text: str, is_error: bool = False) -> None:
        """Show a message in all windows."""
        color: Any = {"color": "red"} if is_error else {}
        for client in self.server.get_clients().values():
            client.add_notification(title, text, auto_close_seconds=MESSAGE_S, **color)

    def _guarded(self, work: Callable[[], object]) -> None:
        try:
            work()
        except SimfoundryError as error:
            self.tell("Not possible", str(error), is_error=True)
        except OSError as error:
            where = f" in {Path(error.filename).parent}" if error.filename else ""  # the file may be a temporary one
            reason = f"a file{where} cannot be read or written: {error.strerror or error}"
            self.tell("Not possible", reason, is_error=True)
        except Exception as error:
            _log.exception("an act failed")
            self.tell("Something went wrong", f"{type(error).__name__}: {error}", is_error=True)
        self.request_refresh()  # a preview that is not followed by an act returns to the document

    # -- what is shown ----------------------------------------------------------------------------------------------

    @property
    def shown_scene(self) -> StudioScene | None:
        """The scene that is shown: a cousin, or the last good scene of the document."""
        return self.stage.cousin or self.session.scene

    @property
    def shown_state(self) -> SceneState | None:
        """The state that is shown, or None for the initial one, which is shown if a state is of another scene."""
        scene, state = self.shown_scene, self.state
        return state if scene is not None and state is not None and scene.objects.keys() <= state.poses.keys() else None

    @property
    def robot_items(self) -> list[SceneObject]:
        """The robots that are shown, as objects."""
        scene = self.shown_scene
        return self._robots.known(scene.surroundings.robots) if scene is not None else []

    def show_state(self, state: SceneState | None) -> None:
        """Show a state soon. Panels follow at the next refresh, so that states can follow each other fast."""
        self.state = state
        self._dirty.set()

    def request_refresh(self) -> None:
        """Show the present state soon."""
        self._is_moved_only = False
        self._dirty.set()

    def refresh(self) -> None:
        """Show the present state of the session."""
        with self.session.lock, self.server.atomic():
            for panel in self._panels:
                panel.refresh()
            self.gizmo.refresh()
        self._move()

    def _move(self) -> None:
        """Show the nodes in the present state."""
        with self.session.lock, self.server.atomic():
            nodes = self._nodes()
            self.canvas.light("/lights/sky" not in nodes, self.options.shadows)
            self.canvas.show(nodes)
            self.pull.refresh()
        self.server.flush()

    def _nodes(self) -> Nodes:
        scene, state = self.shown_scene, self.shown_state
        nodes: Nodes = {}
        if scene is not None:
            nodes |= scene_nodes(scene.scene, self.options, state)
            if self.options.lights:
                around = scene.surroundings
                nodes |= light_nodes(around, self.options.shadows) | lamp_glyphs(around) | panorama_nodes(around)
            for robot in self.robot_items:
                nodes |= object_nodes(robot_at(robot, state), self.options, "robots")
        for panel in self._panels:
            nodes |= panel.nodes()
        nodes |= self.gizmo.nodes()
        for name in self.hidden & (scene.objects.keys() if scene is not None else set()):
            nodes[f"/objects/{name}"] = replace(nodes[f"/objects/{name}"], is_visible=False)
        dragged = self.gizmo.dragged_node
        if dragged in nodes:
            nodes[dragged] = self.canvas.nodes.get(dragged, nodes[dragged])
        return nodes

    def _work(self) -> None:
        """Follow the session until the window is closed."""
        while True:
            self._dirty.wait()
            if self._stopped:
                return
            self._dirty.clear()
            is_moved_only, self._is_moved_only = self._is_moved_only, True
            try:
                if is_moved_only:
                    self._move()
                    continue
                self.refresh()
                self._examine()
                self._complete()
            except _MoreUrgentError:
                continue
            except Exception:
                _log.exception("the view could not be updated")

    def _examine(self) -> None:
        """Add the findings of lints, once for each text."""
        reading = self.session.reading
        if reading is not self._examined:
            self.session.examine(self._pause)
            self._examined = reading

    def _complete(self) -> None:
        """Add what takes longer: robots, and the pictures of cameras."""
        scene = self.shown_scene
        if scene is None:
            return
        if self._robots.read(scene.surroundings.robots):
            self.request_refresh()
        if self.options.cameras and self.state is None and self._pictured is not scene.scene:
            pictures = camera_pictures(scene.scene, self._pause)
            self._pictured = scene.scene
            self.options = replace(self.options, pictures=pictures)
            self.request_refresh()

    def _select_by_click(self, name: str) -> None:
        if not self.is_picking:
            self.select(name)

    def _poke(self, node: str, origin: tuple[float, ...], direction: tuple[float, ...]) -> None:
        self.pull.poke(node, origin, direction)

    def _pause(self) -> None:
        if self._dirty.is_set():
            if not self._is_moved_only:
                raise _MoreUrgentError
            self._dirty.clear()
            self._move()

    def close(self) -> None:
        """End the view."""
        self.stage.close()
        self._stopped = True
        self._dirty.set()
        self._unsubscribe()
        self._acts.shutdown(wait=True)
        self._worker.join(timeout=5)

    def _prepare_scene(self) -> None:
        server = self.server
        server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
        server.gui.set_panel_label("SimFoundry Studio")
        server.gui.main_panel.dock_right()  # a floating panel would cover objects
        server.gui.main_panel.set_width(PANEL_PX)  # it otherwise depends on which message comes first
        scene = self.session.scene
        if scene is None:
            prepare_view(server, None)
        else:
            prepare_view(server, scene.scene, bool(scene.surroundings.robots))

    def _built_panels(self) -> list[Panel]:
        gui = self.gui
        shown = {tab: [kind for kind in kinds if self.is_editable or not kind.edits] for tab, kinds in PANELS.items()}
        built = [kind(self) for kind in shown.pop("")]
        tabs = gui.add_tab_group()
        for tab, kinds in shown.items():
            if kinds:
                with tabs.add_tab(tab):
                    built += [kind(self) for kind in kinds]
        return built


class _MoreUrgentError(Exception):
    """Raised to end an examination of a state that has changed meanwhile."""
