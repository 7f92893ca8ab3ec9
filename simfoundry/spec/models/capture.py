"""The ``capture/1`` document: images of a real scene and the camera that took them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from simfoundry.spec.models.base import (
    DocumentSpec,
    FileName,
    Model,
    Name,
    PoseSpec,
    Positive,
    consistent,
    fault,
)

# Largest focal length and principal point [px]. The widest image then spans 0.05 degrees, as through a telescope.
MAX_FOCAL = 10_000_000
FocalLength = Annotated[float, Field(gt=0, le=MAX_FOCAL, allow_inf_nan=False)]
ImagePoint = Annotated[float, Field(ge=-MAX_FOCAL, le=MAX_FOCAL, allow_inf_nan=False)]


class Intrinsics(Model):
    """The intrinsics of an undistorted pinhole camera [px]."""

    fx: FocalLength = Field(description="Focal length in x [px].")
    fy: FocalLength = Field(description="Focal length in y [px].")
    cx: ImagePoint = Field(description="Principal point in x [px].")
    cy: ImagePoint = Field(description="Principal point in y [px].")


class DepthImage(Model):
    """A depth image (16-bit PNG, TIFF or NumPy array) whose values are distances along the optical axis."""

    image: FileName = Field(description="Depth image, relative to this document.")
    scale: Positive = Field(0.001, description="Length of one image unit [m]; 0.001 for millimeters.")
    invalid: tuple[int, ...] = Field((0,), max_length=16, description="Values that mark missing measurements.")
    camera: Intrinsics | None = Field(None, description="The depth camera, if it is not the color camera.")
    pose: PoseSpec | None = Field(
        None, description="Pose of the depth camera in the color camera's frame (x right, y down, z forward)."
    )

    @consistent
    def _both(self) -> None:
        if (self.camera is None) != (self.pose is None):
            raise fault("sf107", "`camera` and `pose` of a depth camera must be set together")


class Masks(Model):
    """Instance masks: an image whose pixel values identify the objects."""

    image: FileName = Field(
        description="Mask image, relative to this document; must be the same size as the color image."
    )
    background: tuple[int, ...] = Field((0,), max_length=256, description="Pixel values that belong to no object.")
    names: dict[Name, Annotated[int, Field(ge=1)]] = Field({}, description="Pixel value of each object, by name.")


# Column and row of a pixel [px], from the top left; images of more than 100,000 pixels a side are not read.
Pixel = tuple[Annotated[int, Field(ge=0, lt=100_000)], Annotated[int, Field(ge=0, lt=100_000)]]


class Decomposition(Model):
    """Constraints on the segmentation of a view, stated by a person.

    Pixels mark objects, so that the constraints hold however the image is segmented.
    """

    pieces: dict[Name, Annotated[tuple[Pixel, ...], Field(min_length=1, max_length=100)]] = Field(
        {},
        max_length=200,
        description="Objects by name, each as pixels on it (column, row) [px]. What is found at the pixels of one "
        "object is one piece; what is found at the pixels of several objects is divided among them.",
    )
    ignore: tuple[Pixel, ...] = Field(
        (), max_length=1000, description="Pixels (column, row) [px] on regions that are not objects."
    )
    occludes: dict[Name, Annotated[tuple[Name, ...], Field(min_length=1, max_length=200)]] = Field(
        {},
        max_length=200,
        description="Names from `pieces`, each with those that it occludes: its pixels are no evidence that they end "
        "there.",
    )

    @consistent
    def _known_names(self) -> None:
        for name, hidden in self.occludes.items():
            if name in hidden:
                raise fault("sf107", f"`{name}` cannot occlude itself", "occludes")
            for each in (name, *hidden):
                if each not in self.pieces:
                    raise fault("sf107", f"`occludes` names `{each}`, which `pieces` does not define", "occludes")


class SupportChoice(Model):
    """The surface that supports the objects, stated by a person."""

    pixel: Pixel | None = Field(None, description="A pixel (column, row) [px] on the bare surface.")
    plane: tuple[float, float, float, float] | None = Field(
        None,
        description="The plane `a x + b y + c z = d` in the camera frame (x right, y down, z forward) [m].",
    )

    @consistent
    def _one_statement(self) -> None:
        if (self.pixel is None) == (self.plane is None):
            raise fault("sf107", "state either the `pixel` or the `plane` of the support")
        if self.plane is not None and not sum(x * x for x in self.plane[:3]) > 1e-12:
            raise fault("sf107", "the normal of the plane must not be zero", "plane")


class Shot(Model):
    """A view of the scene: color image, depth image, camera, and optional masks."""

    color: FileName = Field(description="Color image, relative to this document.")
    depth: DepthImage
    camera: Intrinsics = Field(description="The color camera.")
    pose: PoseSpec | None = Field(
        None,
        description="Pose of the color camera (x right, y down, z forward) in a frame in which the scene does not "
        "move, such as that of a tracker; `simfoundry articulate` relates two captures by it.",
    )
    masks: Masks | None = Field(None, description="Instance masks.")
    support: SupportChoice | None = Field(
        None, description="The surface that supports the objects, if another one was found."
    )
    decomposition: Decomposition | None = Field(
        None, description="Constraints on the division of the image into objects."
    )


class CaptureSpec(DocumentSpec):
    """A capture of a real scene."""

    simfoundry: Literal["capture/1"] = Field(description="The kind and version of this document.")
    frames: dict[Name, Shot] = Field(min_length=1, description="Views by name; the first is reconstructed by default.")
    truth: FileName | None = Field(None, description="A scene document with the ground truth.")
