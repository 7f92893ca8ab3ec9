"""Observations as a policy receives them, with the latency and the noise of sensors."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

from simfoundry.evaluate.observations import Images
from simfoundry.evaluate.policies.base import ImageSize, RobotReading
from simfoundry.evaluate.rollouts.control import camera_images, readings
from simfoundry.evaluate.rollouts.execution import Execution
from simfoundry.evaluate.rollouts.noise import NoiseSeed, SensorNoise
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.disturbances import ObservationDisturbances
from simfoundry.spec.models.signals import ImageKind
from simfoundry.worlds.base import World, WorldRobot

Captured = TypeVar("Captured")


@dataclass(frozen=True, eq=False)
class SensedMoment:
    """Sensor readings at the start of an action.

    Attributes:
        robots: The readings of the robots.
        state: The poses and joint positions of objects as they are observed.
        images: The images of each kind, keyed by camera.
        true_robots: The current readings of the robots without latency and noise.
    """

    robots: Mapping[str, RobotReading]
    state: SceneState
    images: Images
    true_robots: Mapping[str, RobotReading]


class Sensors:
    """The sensors of a rollout.

    What is observed at a time is captured earlier by the latency, but not before the rollout starts, when the world is
    at rest. Images are rendered only for actions that may be preceded by an observation.
    """

    def __init__(
        self,
        world: World,
        execution: Execution,
        cameras: Mapping[str, ImageSize],
        kinds: Iterable[ImageKind],
        disturbances: ObservationDisturbances,
        seed: NoiseSeed,
    ) -> None:
        self._world, self._execution = world, execution
        self._robots: Mapping[str, WorldRobot] = execution.controller.robots
        self._cameras, self._kinds = cameras, tuple(kinds)
        self._noise = SensorNoise(disturbances, seed)
        latency, about = disturbances.latency, disturbances
        of_images = latency if about.image_latency is None else about.image_latency
        self._states = _Channel(round(latency / world.timestep), execution, self._read)
        self._images = _Channel(round(of_images / world.timestep), execution, self._render)
        execution.captures = (self._states, *([self._images] if cameras else []))

    def observe(self, state: SceneState) -> SensedMoment:
        """Return the observation at the start of the next action, when ``state`` is the current state of the world."""
        now, noise = self._execution.now, self._noise
        true_robots = readings(self._world, self._robots)
        robots, seen = self._states.take() if self._states.is_late else (true_robots, state)
        bases = {name: self._world.scene.robot(name).X_WB for name in robots}
        images = self._images.take() if self._cameras else {kind: {} for kind in self._kinds}
        return SensedMoment(
            noise.readings(robots, bases, now), noise.state(seen, now), self._disturbed(images, now), true_robots
        )

    def skip(self, actions: int) -> None:
        """Render no images for the observations before the next ``actions`` actions, because nobody will ask."""
        self._images.skip_until(self._execution.start_of(self._execution.actions + actions))

    def _read(self) -> tuple[Mapping[str, RobotReading], SceneState]:
        return readings(self._world, self._robots), self._world.state()

    def _render(self) -> Images:
        return camera_images(self._world, self._cameras, self._kinds)

    def _disturbed(self, images: Images, now: int) -> Images:
        about, found = self._noise.about, dict(images)
        if ImageKind.COLOR in found and (about.image_noise or about.exposure or about.exposure_noise):
            found[ImageKind.COLOR] = {n: self._noise.image(i, n, now) for n, i in found[ImageKind.COLOR].items()}
        if ImageKind.DEPTH in found and (about.depth_noise or about.depth_dropout):
            found[ImageKind.DEPTH] = {n: self._noise.depth(i, n, now) for n, i in found[ImageKind.DEPTH].items()}
        return found


class _Channel(Generic[Captured]):
    """A sensor whose observations are older than the moment at which they are used.

    Args:
        delay: The latency, in physics steps.
        execution: The execution of actions, before each of which there can be an observation.
        capture: A function that reads the sensor.
    """

    def __init__(self, delay: int, execution: Execution, capture: Callable[[], Captured]) -> None:
        self._delay, self._execution, self._capture = delay, execution, capture
        self._next = 0  # the index of the action whose observation is captured next
        self._from = 0  # the physics step of the first observation that is needed
        self._kept: deque[tuple[int, Captured]] = deque()

    @property
    def is_late(self) -> bool:
        """True if the sensor has latency."""
        return self._delay > 0

    @property
    def due(self) -> int | None:
        """The physics step at which the sensor must be read next, or None without latency."""
        return max(0, self._execution.start_of(self._next) - self._delay) if self._delay else None

    def read(self, now: int) -> None:
        """Read the sensor for all observations whose capture is due at the physics step ``now``."""
        captured: list[Captured] = []
        while self.due is not None and self.due <= now:
            used = self._execution.start_of(self._next)
            if used >= self._from:
                captured = captured or [self._capture()]
                self._kept.append((used, captured[0]))
            self._next += 1

    def take(self) -> Captured:
        """Return the observation at the start of the next action."""
        now = self._execution.now
        if not self._delay:
            return self._capture()
        self.read(now)
        while len(self._kept) > 1 and self._kept[1][0] <= now:
            self._kept.popleft()
        return self._kept[0][1]  # within an action, what was observed at its start

    def skip_until(self, step: int) -> None:
        """Read nothing for observations before a physics step."""
        self._from = step
