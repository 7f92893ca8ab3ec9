"""The ``capture/1`` document: images of a real scene and the camera that took them."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue

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
# Numbers of coefficients for which OpenCV has a model of a lens.
DISTORTION_COUNTS = (0, 4, 5, 8, 12, 14)

FocalLength = Annotated[float, Field(gt=0, le=MAX_FOCAL, allow_inf_nan=False)]
ImagePoint = Annotated[float, Field(ge=-MAX_FOCAL, le=MAX_FOCAL, allow_inf_nan=False)]


class Intrinsics(Model):
    """The intrinsics of a camera: those of a pinhole [px], and the distortion of its lens, if any."""

    fx: FocalLength = Field(description="Focal length in x [px].")
    fy: FocalLength = Field(description="Focal length in y [px].")
    cx: ImagePoint = Field(description="Principal point in x [px].")
    cy: ImagePoint = Field(description="Principal point in y [px].")
    distortion: Annotated[tuple[Annotated[float, Field(ge=-100, le=100)], ...], Field(max_length=14)] = Field(
        (),
        description="Coefficients of the lens in the order of OpenCV: k1, k2, p1, p2, and then k3 or k3 to k6, and so "
        "on. The images are undistorted with it. Without coefficients, the images are undistorted already.",
    )

    @consistent
    def _known_count(self) -> None:
        if len(self.distortion) not in DISTORTION_COUNTS:
            counts = ", ".join(map(str, DISTORTION_COUNTS))
            raise fault("sf103", f"`distortion` has {len(self.distortion)} values; OpenCV knows {counts}", "distortion")


def _of_matrix(value: Any) -> Any:
    """Return the intrinsics that a matrix `K` contains, given as nine numbers or as three rows, as a mapping."""
    if isinstance(value, dict) and "K" in value and "fx" not in value:
        raise fault("sf103", "a camera matrix is stated without a key: `camera: [fx, 0, cx, 0, fy, cy, 0, 0, 1]`")
    if not isinstance(value, tuple | list):
        return value
    rows = [row if isinstance(row, tuple | list) else (row,) for row in value]
    numbers = [number for row in rows for number in row]
    is_number = all(isinstance(n, int | float) and not isinstance(n, bool) for n in numbers)
    if len(numbers) != 9 or not is_number or {len(row) for row in rows} not in ({1}, {3}):
        raise fault("sf103", "a camera matrix has nine numbers: `[fx, 0, cx, 0, fy, cy, 0, 0, 1]`")
    fx, skew, cx, below, fy, cy, *last = numbers
    if (skew, below, *last) != (0, 0, 0, 0, 1):
        raise fault("sf104", "a camera matrix must be `[fx, 0, cx, 0, fy, cy, 0, 0, 1]`, without skew")
    return {"fx": float(fx), "fy": float(fy), "cx": float(cx), "cy": float(cy)}


class _MatrixSchema:
    """A schema that also accepts a camera matrix, which the model itself stores as intrinsics."""

    def __get_pydantic_json_schema__(self, core: Any, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        own, number = handler(core), {"type": "number"}
        flat = {"type": "array", "items": number, "minItems": 9, "maxItems": 9}
        row = {"type": "array", "items": number, "minItems": 3, "maxItems": 3}
        return {"anyOf": [own, flat, {"type": "array", "items": row, "minItems": 3, "maxItems": 3}]}


# Intrinsics, or a camera matrix as nine numbers or as three rows of three.
CameraIntrinsics = Annotated[Intrinsics, BeforeValidator(_of_matrix), _MatrixSchema()]


class DepthImage(Model):
    """A depth image (16-bit PNG, TIFF or NumPy array) whose values are distances along the optical axis."""

    image: FileName = Field(description="Depth image, relative to this document.")
    scale: Positive = Field(0.001, description="Length of one image unit [m]; 0.001 for millimeters.")
    invalid: tuple[int, ...] = Field((0,), max_length=16, description="Values that mark missing measurements.")
    camera: CameraIntrinsics | None = Field(None, description="The depth camera [px], if it is not the color camera.")
    pose: PoseSpec | None = Field(
        None, description="Pose of the depth camera in the color camera's frame (x right, y down, z forward)."
    )

    @consistent
    def _both(self) -> None:
        if (self.camera is None) != (self.pose is None):
            raise fault("sf107", "`camera` and `pose` of a depth camera must be set together")


class StereoPair(Model):
    """The right image of a rectified stereo pair, whose left image is the color image."""

    right: FileName = Field(description="Color image of the right camera, relative to this document.")
    baseline: Positive = Field(description="Distance between the two cameras [m].")


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
    depth: DepthImage | None = Field(
        None, description="Measured depth. Without it and without `stereo`, a model of the task `depth` is required."
    )
    stereo: StereoPair | None = Field(None, description="The right image of a stereo pair, instead of `depth`.")
    camera: CameraIntrinsics = Field(description="The color camera: intrinsics [px], or their matrix of nine numbers.")
    pose: PoseSpec | None = Field(
        None,
        description="Pose of the color camera (x right, y down, z forward) in a frame in which the scene does not "
        "move, such as that of a tracker; `simfoundry articulate` relates two captures by it, and `simfoundry capture` "
        "fuses the depth of all frames that have one.",
    )
    masks: Masks | None = Field(None, description="Instance masks.")
    support: SupportChoice | None = Field(
        None, description="The surface that supports the objects, if another one was found."
    )
    decomposition: Decomposition | None = Field(
        None, description="Constraints on the division of the image into objects."
    )

    @consistent
    def _one_source(self) -> None:
        if self.depth is not None and self.stereo is not None:
            raise fault("sf107", "`depth` and `stereo` exclude each other: the depth of a pair is computed", "stereo")


class CadFolder(Model):
    """A folder of meshes that objects may be."""

    folder: str = Field(
        min_length=1,
        description="Folder with meshes (OBJ, glTF, STL, PLY) or assets, relative to this document. Objects that they "
        "explain best become these meshes.",
    )
    scale: Positive = Field(1.0, description="Length of one unit of the meshes [m].")


def _of_path(value: Any) -> Any:
    """Return the CAD library that a path alone states."""
    return {"folder": value} if isinstance(value, str) else value


class _PathSchema:
    """A schema that also accepts a path, which the model itself stores as a folder."""

    def __get_pydantic_json_schema__(self, core: Any, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return {"anyOf": [handler(core), {"type": "string", "minLength": 1}]}


class CaptureSpec(DocumentSpec):
    """A capture of a real scene."""

    simfoundry: Literal["capture/1"] = Field(description="The kind and version of this document.")
    frames: dict[Name, Shot] = Field(min_length=1, description="Views by name; the first is reconstructed by default.")
    truth: FileName | None = Field(None, description="A scene document with the ground truth.")
    cad: Annotated[CadFolder, BeforeValidator(_of_path), _PathSchema()] | None = Field(
        None, description="A folder of meshes that objects may be: its path, or a mapping with their units."
    )
