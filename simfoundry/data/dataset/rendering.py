"""Images of a trajectory, rendered in the recorded states when they are read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.data.dataset.contents import ImageView
from simfoundry.data.dataset.episode import Images
from simfoundry.data.trajectory import Trajectory
from simfoundry.evaluate.policies.base import ImageSize
from simfoundry.evaluate.policies.remote import resize_with_pad
from simfoundry.evaluate.rollouts.control import camera_images
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.signals import ImageKind
from simfoundry.worlds.base import World

# Maximum size of the images of an episode that are kept in memory for a second reader [bytes]; two cameras of 640 x 480
# take 550 MB in 20 s at 15 Hz. The images of larger episodes are rendered again.
KEPT_BYTES = 2**30


class RenderedFrames:
    """The images of a trajectory.

    Args:
        views: The images to render, by feature.
        trajectory: The trajectory.
        world: Function that opens the world in which they are rendered. Its scene may differ in its pictures from the
            scene in which the trajectory was recorded.
        names: The names of the objects, joints and motions, in the order of the observations, by key.
    """

    def __init__(
        self,
        views: Mapping[str, ImageView],
        trajectory: Trajectory,
        world: Callable[[], World],
        names: Mapping[str, tuple[str, ...]],
    ) -> None:
        self._views, self._trajectory, self._world, self._names = views, trajectory, world, names
        self._kept: list[Images] | None = None

    def frames(self, final: bool = False) -> Iterator[Images]:
        """Yield the images of each frame and, if ``final`` is set, those after the last action."""
        count = self._trajectory.length + final
        if self._kept is not None and len(self._kept) >= count:
            yield from self._kept[:count]
            return
        kept: list[Images] | None = [] if self._bytes(count) <= KEPT_BYTES else None
        for images in self._rendered(count):
            if kept is not None:
                kept.append(images)
            yield images
        self._kept = kept

    def _rendered(self, count: int) -> Iterator[Images]:
        if not self._views:
            yield from ({} for _ in range(count))
            return
        world = self._world()
        for state in states_of(world, self._trajectory, self._names, count):
            world.reset(state)
            yield dict(self._images(world))

    def _images(self, world: World) -> Iterator[tuple[str, NDArray[Any]]]:
        rendered: dict[tuple[str, ImageSize], dict[ImageKind, NDArray[Any]]] = {}
        for key, view in self._views.items():
            place = (view.camera, view.render)
            if place not in rendered:
                kinds = {v.kind for v in self._views.values() if (v.camera, v.render) == place}
                found = camera_images(world, {view.camera: view.render}, sorted(kinds))
                rendered[place] = {kind: images[view.camera] for kind, images in found.items()}
            image = resize_with_pad(rendered[place][view.kind], view.size)
            yield key, image if image.ndim == 3 else image[..., None]

    def _bytes(self, count: int) -> int:
        pixels = sum(view.size.width * view.size.height for view in self._views.values())
        return 4 * count * pixels  # at most four bytes per pixel: float32 and int32


def states_of(
    world: World, trajectory: Trajectory, names: Mapping[str, tuple[str, ...]], count: int
) -> Iterator[SceneState]:
    """Yield the first ``count`` states of a trajectory, as states of a world."""
    recorded = trajectory.observations
    models = {name: tuple(positions) for name, positions in world.state().robots.items()}
    for k in range(count):
        yield SceneState.of(
            dict(zip(names["objects"], _poses(recorded["objects"][k]), strict=True)),
            dict(zip(names["joints"], map(float, recorded["joints"][k]), strict=True)),
            dict(zip(names["motions"], _poses(recorded["motions"][k]), strict=True)),
            {
                name: dict(zip(joints, map(float, recorded[f"{name}/model"][k]), strict=True))
                for name, joints in models.items()
                if f"{name}/model" in recorded
            },
        )


def _poses(rows: Array) -> list[Pose]:
    return [Pose.of(row[:3], row[3:]) for row in np.reshape(rows, (-1, 7))]
