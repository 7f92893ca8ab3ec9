"""Forces by mouse while physics is shown: a click pokes, and a handle at the selected object pulls it like a spring."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.geometry.frames import Array
from simfoundry.scene.model import SceneObject
from simfoundry.studio.trial.engine import Push
from simfoundry.studio.trial.physics import FRAME_S, PhysicsTrial
from simfoundry.worlds.rest import center_of_mass

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

# Natural frequency of the spring [Hz], which is critically damped: an object follows the mouse within a quarter second.
SPRING_HZ = 2.0

# Duration of a poke [s], as long as that of a finger.
POKE_S = 0.1

# Length of the handle's arrows [m].
HANDLE_M = 0.12


class PullHandle:
    """The handle at the selected object, and the forces that people apply.

    Attributes:
        poke_n: The force of a poke [N].
    """

    def __init__(self, window: StudioWindow) -> None:
        self._window = window
        self._handle: Any = None
        self._name = ""
        self._target: Array | None = None  # where the handle is dragged to
        self._dragged_by: int | None = None
        self._last: Array | None = None  # center of mass at the last call, from which the velocity follows
        self.poke_n = 2.0
        window.server.on_client_disconnect(lambda client: self._cancel(client.client_id))

    @property
    def _physics(self) -> PhysicsTrial | None:
        trial = self._window.stage.trial
        return trial if isinstance(trial, PhysicsTrial) else None

    def poke(self, node: str, origin: Sequence[float], direction: Sequence[float]) -> None:
        """Push what was clicked on along the line of sight, if physics is shown.

        Args:
            node: The node, such as ``/objects/cabinet/drawer``.
            origin: The origin of the line of sight in the world [m].
            direction: Its direction.
        """
        physics, scene, parts = self._physics, self._window.shown_scene, node.split("/")
        if physics is None or scene is None or len(parts) < 3 or parts[1] != "objects" or parts[2] not in scene.objects:
            return
        item = scene.objects[parts[2]]
        link = parts[3].removesuffix("_colliders") if len(parts) > 3 else item.root.name
        along = np.array(direction) / np.linalg.norm(direction) * self.poke_n
        push = Push(item.qualified(link), _triple(along), _triple(np.array(origin)))  # anywhere on the line is the same
        physics.push(push, POKE_S)

    def forces(self) -> Sequence[Push]:
        """Return the force of the spring at the moment. Called by the thread of physics."""
        target, item, at = self._target, self._item(), self._center()
        last, self._last = self._last, at
        if target is None or item is None or at is None:
            return ()
        velocity = np.zeros(3) if last is None else (at - last) / FRAME_S
        omega, mass = 2 * math.pi * SPRING_HZ, sum(link.mass for link in item.links)
        force = mass * (omega**2 * (target - at) - 2 * omega * velocity)
        return (Push(item.name, _triple(force), _triple(at)),)

    def refresh(self) -> None:
        """Put the handle where the selected object is, or remove it."""
        at = self._center() if self._physics is not None else None
        name = self._window.selected_object
        if self._handle is not None and (at is None or name != self._name):
            self._handle.remove()
            self._handle, self._target, self._dragged_by = None, None, None
        if at is None:
            return
        if self._handle is None:
            self._add(name)
        if self._target is None and self._handle.position.tolist() != at.tolist():
            self._handle.position = at

    def _add(self, name: str) -> None:
        self._name, self._last = name, None
        self._handle = self._window.server.scene.add_transform_controls(
            "/pull", scale=HANDLE_M, disable_rotations=True, depth_test=False, line_width=3.0
        )

        async def on_update(event: Any) -> None:  # on the event loop, which keeps the order of events
            if event.client_id not in self._window.server.get_clients() or name != self._name:
                return  # events may still be waiting when their browser is gone
            is_over = event.phase == "end"
            self._dragged_by = None if is_over else event.client_id
            self._target = None if is_over else np.array(event.target.position)

        self._handle.on_update(on_update)

    def _cancel(self, client_id: int) -> None:
        if self._dragged_by == client_id:
            self._dragged_by = self._target = None

    def _item(self) -> SceneObject | None:
        scene = self._window.shown_scene
        item = scene.objects.get(self._window.selected_object) if scene is not None else None
        return item if item is not None and not item.fixed else None

    def _center(self) -> Array | None:
        item, state = self._item(), self._window.state
        return center_of_mass(item, state.poses[item.name]) if item and state and item.name in state.poses else None


def _triple(v: Array) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in v)
    return x, y, z
