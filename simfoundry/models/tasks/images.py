"""Images and videos with filled holes, and images edited as a prompt says (V_image, V_inpaint^video)."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from simfoundry.models.client import Members, ModelClient
from simfoundry.models.contract import ConventionError, Member, ModelError, ModelTask, plain
from simfoundry.models.provenance import ModelIdentity
from simfoundry.models.tasks.depth import IMAGE, Mask, Pixels
from simfoundry.models.wire import MAX_PIXELS, Bundle, BundleImage

# Largest median difference of pixels that were to be kept [gray levels of 0 to 255]. Generative models change colors by
# a few levels; another image, or another order of the channels, differs by more.
KEPT_LEVELS = 40.0


class ImagePrompt(BaseModel):
    """The words that describe the wanted image."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    prompt: str = Field("", max_length=20_000)


@dataclass(frozen=True, eq=False)
class ImageEstimate:
    """An image, shape (H, W, 3), or (H, W, 4) with a transparent background."""

    image: Pixels
    made_by: ModelIdentity


@dataclass(frozen=True, eq=False)
class VideoEstimate:
    """The frames of a video, each of shape (H, W, 3)."""

    frames: tuple[Pixels, ...]
    made_by: ModelIdentity


class InpaintingModel(Protocol):
    """Fills a region of an image with what is behind it."""

    def inpaint(self, image: Pixels, mask: Mask, prompt: str = "") -> ImageEstimate:
        """Fill the pixels of a mask. All other pixels of the result equal those of the image.

        Args:
            image: RGB image, shape (H, W, 3).
            mask: Pixels to fill, shape (H, W).
            prompt: Words that describe what should be there, such as `an empty table`.
        """


class VideoInpaintingModel(Protocol):
    """Removes objects from a video (V_inpaint^video)."""

    def inpaint_video(self, frames: Sequence[Pixels], masks: Mask, prompt: str = "") -> VideoEstimate:
        """Fill the pixels of masks, shape (T, H, W), in the frames of a video."""


class ImageEditingModel(Protocol):
    """Draws a new image from images and words (V_image)."""

    def edit_image(self, prompt: str, images: Sequence[Pixels], seed: int = 0) -> ImageEstimate:
        """Edit the first of ``images`` (RGB or RGBA; the others are for reference). The size may change."""


def _check_kept(request: Bundle, answer: Bundle) -> None:
    before, after, mask = request.members["image"], answer.members["image"], request.members["mask"]
    assert isinstance(before, BundleImage) and isinstance(after, BundleImage) and isinstance(mask, np.ndarray)
    _compare(before.pixels, after.pixels, mask)


def _compare(before: Pixels, after: Pixels, mask: Mask) -> None:
    """Compare the pixels outside of a mask, and recognize swapped channels and inverted masks."""
    if mask.all() or not mask.any():
        return
    outside = _difference(before, after, ~mask)
    if _difference(before, after[..., ::-1], ~mask) < 0.5 * outside and outside > 4:
        raise ConventionError("has an `image` whose pixels outside of the mask fit as BGR; images are RGB")
    if outside > 4 and _difference(before, after, mask) < 1:
        raise ConventionError(
            "has an `image` that changed outside of the mask and not inside; the mask is 1 where to fill"
        )
    if outside > KEPT_LEVELS:
        raise ConventionError(f"has an `image` that differs by {outside:.0f} of 255 levels outside of the mask")


def _difference(a: Pixels, b: Pixels, where: Mask) -> float:
    return float(np.median(np.abs(a[where].astype(np.int16) - b[where]).mean(axis=1)))


def _check_video(request: Bundle, answer: Bundle) -> None:
    before, after, masks = request.members["frames"], answer.members["frames"], request.members["masks"]
    assert isinstance(before, tuple) and isinstance(after, tuple) and isinstance(masks, np.ndarray)
    for one, other, mask in zip(before, after, masks, strict=True):
        _compare(one.pixels, other.pixels, mask)


FRAMES = Member("frames", "images", "RGB frames of one size", ("T", "H", "W"))

INPAINT = ModelTask(
    "inpaint", "V_image", "an image without what a mask covers",
    (IMAGE, Member("mask", "array", "pixels to fill", ("H", "W"), "bool")), (IMAGE,),
    parameters=ImagePrompt, checks=(_check_kept,),
)  # fmt: skip

INPAINT_VIDEO = ModelTask(
    "inpaint_video", "V_inpaint^video", "a video without what masks cover",
    (FRAMES, Member("masks", "array", "pixels to fill", ("T", "H", "W"), "bool")), (FRAMES,),
    parameters=ImagePrompt, checks=(_check_video,),
)  # fmt: skip

EDIT = ModelTask(
    "edit", "V_image", "an image drawn from images and words",
    (
        Member("image", "rgba", "image to edit", ("h", "w")),
        Member("references", "images", "images for reference", ("n", "H", "W"), is_optional=True),
    ),
    (Member("image", "rgba", "edited image, with a transparent background", ("A", "B")),),
    parameters=ImagePrompt,
)  # fmt: skip


def decoded_image(data: bytes) -> Pixels:
    """Return a PNG or JPEG as RGB, shape (H, W, 3), or as RGBA, shape (H, W, 4), if it has transparent pixels.

    Raises:
        ModelError: If it cannot be decoded or has too many pixels.
    """
    from PIL import Image

    try:
        with Image.open(io.BytesIO(data), formats=("PNG", "JPEG")) as image:
            if image.width * image.height > MAX_PIXELS:
                raise ModelError(f"an image of {image.width} x {image.height} pixels is too large")
            is_transparent = image.has_transparency_data
            return np.asarray(image.convert("RGBA" if is_transparent else "RGB"), dtype=np.uint8)
    except ModelError:
        raise
    except Exception as error:  # Pillow's parsers raise many kinds
        raise ModelError(f"an image cannot be decoded: {plain(error)}") from None


def encoded_image(image: Pixels) -> bytes:
    """Return an RGB or RGBA image as PNG."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(stream, format="PNG")
    return stream.getvalue()


def with_alpha(image: Pixels) -> Pixels:
    """Return an RGBA image, shape (H, W, 4). An RGB image becomes opaque."""
    if image.shape[2] == 4:
        return image
    return np.dstack([image, np.full(image.shape[:2], 255, np.uint8)])


def over_white(image: Pixels) -> Pixels:
    """Return an RGB image, shape (H, W, 3). An RGBA image is placed on white."""
    if image.shape[2] == 3:
        return image
    alpha = image[..., 3:].astype(np.float64) / 255
    return np.asarray(np.rint(image[..., :3] * alpha + 255 * (1 - alpha)), dtype=np.uint8)


@dataclass(frozen=True)
class BundleImages:
    """The tasks about images, solved by servers that speak ``bundle/1``."""

    client: ModelClient

    def inpaint(self, image: Pixels, mask: Mask, prompt: str = "") -> ImageEstimate:
        """Fill the pixels of a mask; see :class:`InpaintingModel`."""
        members: Members = {"image": BundleImage(image), "mask": mask.astype(np.bool_)}
        got = self.client.ask(INPAINT, members, ImagePrompt(prompt=prompt))
        filled = got.array("image").pixels
        return ImageEstimate(np.where(mask[..., None], filled, image), got.made_by)

    def inpaint_video(self, frames: Sequence[Pixels], masks: Mask, prompt: str = "") -> VideoEstimate:
        """Fill the pixels of masks; see :class:`VideoInpaintingModel`."""
        members: Members = {"frames": tuple(map(BundleImage, frames)), "masks": masks.astype(np.bool_)}
        got = self.client.ask(INPAINT_VIDEO, members, ImagePrompt(prompt=prompt))
        filled = zip(frames, got.array("frames"), masks, strict=True)
        return VideoEstimate(tuple(np.where(m[..., None], new.pixels, old) for old, new, m in filled), got.made_by)

    def edit_image(self, prompt: str, images: Sequence[Pixels], seed: int = 0) -> ImageEstimate:
        """Edit an image; see :class:`ImageEditingModel`. All references are resized to the size of the first one."""
        first, *others = images
        members: Members = {"image": BundleImage(with_alpha(first)), "references": _references(others) or None}
        got = self.client.ask(EDIT, members, ImagePrompt(prompt=prompt), seed)
        return ImageEstimate(got.array("image").pixels, got.made_by)


def _references(images: Sequence[Pixels]) -> tuple[BundleImage, ...]:
    from PIL import Image

    if not images:
        return ()
    height, width = images[0].shape[:2]
    resized = (Image.fromarray(over_white(image)).resize((width, height)) for image in images)
    return tuple(BundleImage(np.asarray(one, dtype=np.uint8)) for one in resized)
