"""Contents of nodes that are shown: plain data that can be compared, so that only what differs is sent."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.shapes import Geometry
from simfoundry.render.glb import glb_of
from simfoundry.scene.model import LightType


@dataclass(frozen=True, eq=False)
class SurfaceContent:
    """Visible surfaces in one frame, which are written as GLB only if they are sent.

    Surfaces that are not lit have their own colors whatever the lights, like a sky.
    """

    key: str
    pieces: tuple[tuple[Geometry, Pose, tuple[float, ...]], ...]
    is_lit: bool = True

    @property
    def glb(self) -> bytes:
        """The surfaces as a GLB file."""
        return _kept_glb(self)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SurfaceContent) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)


@lru_cache(maxsize=512)  # copies of one object share a file
def _kept_glb(content: SurfaceContent) -> bytes:
    return glb_of(content.pieces, content.is_lit)


@dataclass(frozen=True)
class FrameContent:
    """A frame, with axes of the given length [m], or without axes if it is zero."""

    axes: float = 0.0


@dataclass(frozen=True)
class LinesContent:
    """Line segments between pairs of points [m], with a color (sRGB, 0 to 255) and a thickness [px]."""

    points: tuple[tuple[tuple[float, float, float], tuple[float, float, float]], ...]
    rgb: tuple[int, int, int]
    thickness: float = 2.0


@dataclass(frozen=True)
class FrustumContent:
    """The frustum of a camera: its vertical field of view [rad], its aspect, and the PNG image that it sees, if any."""

    fov: float
    aspect: float
    image: bytes = b""


@dataclass(frozen=True)
class LabelContent:
    """A text at a point."""

    text: str


@dataclass(frozen=True, eq=False)
class SplatContent:
    """Gaussians of a splat, compared by identity because they are large and never change."""

    gaussians: Any


@dataclass(frozen=True, eq=False)
class CloudContent:
    """A cloud of points, compared by its keys. Where only colors or sizes differ, only they are sent.

    Attributes:
        key: What identifies the points.
        paint: What identifies their colors.
        points: Points [m], shape (n, 3).
        rgb: Colors (sRGB, 0 to 255), shape (n, 3).
        size: Size of a point [m].
    """

    key: str
    paint: str
    points: Array
    rgb: NDArray[np.uint8]
    size: float

    def __eq__(self, other: object) -> bool:
        return isinstance(other, CloudContent) and self._identity == other._identity

    def __hash__(self) -> int:
        return hash(self._identity)

    @property
    def _identity(self) -> tuple[str, str, float]:
        return self.key, self.paint, self.size


@dataclass(frozen=True, eq=False)
class PictureContent:
    """A picture (sRGB, shape (h, w, 3)) on a rectangle [m], compared by its key."""

    key: str
    picture: NDArray[np.uint8]
    width: float
    height: float

    def __eq__(self, other: object) -> bool:
        return isinstance(other, PictureContent) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)


@dataclass(frozen=True)
class LightContent:
    """A light. A dome has one color for surfaces that face up and another for those that face down.

    Attributes:
        type: The type of the light.
        rgb: Linear color times intensity; at 1, a white surface that faces the light is fully lit.
        below: The same for what comes from below, if the light is a dome.
        casts_shadows: Whether objects cast shadows in it.
    """

    type: LightType
    rgb: tuple[float, float, float]
    below: tuple[float, float, float] = (0.0, 0.0, 0.0)
    casts_shadows: bool = False


NodeContent = (
    SurfaceContent
    | FrameContent
    | LinesContent
    | FrustumContent
    | LabelContent
    | SplatContent
    | CloudContent
    | PictureContent
    | LightContent
)
