"""Errors in meshes, profiles and outlines. To let checks start quickly, this module does not import numpy."""

from __future__ import annotations

from simfoundry.errors import PicklableError

# Maximum number of triangles in a mesh; decomposing more takes many minutes, and no simulator needs them.
MAX_FACES = 2_000_000

# Maximum mesh file size [bytes]; two million triangles with textures fit, and larger files can exhaust memory.
MAX_BYTES = 256 * 2**20

# Range of plausible sizes [m] for objects on, around or under a table.
SMALLEST, LARGEST = 0.001, 20.0

# Minimum volume of a solid [m^3]: a tenth of a cubic millimeter.
LEAST_VOLUME = 1e-10


class MeshError(PicklableError):
    """Raised if a mesh is unusable. The error has a diagnostic code, a message, and a hint."""

    def __init__(self, code: str, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.code, self.message, self.hint = code, message, hint


# Factor that converts mesh units to meters, or one factor along each axis of the mesh, with z up.
Scale = float | tuple[float, float, float]


def implausible_size(name: str, size: float, scale: Scale) -> MeshError | None:
    """Return an error if the longest side of a mesh (``size`` [m] at ``scale``) is implausible, or None otherwise."""
    shown = f"{name} is {size:.4g} m across"
    if size > LARGEST:
        millimeters = SMALLEST < size / 1000 < LARGEST
        factors = scale if isinstance(scale, tuple) else (scale,)
        shown_scale = ", ".join(f"{0.001 * factor:g}" for factor in factors)
        shown_scale = f"[{shown_scale}]" if isinstance(scale, tuple) else shown_scale
        hint = f"it looks like millimeters: `scale: {shown_scale}`" if millimeters else "set `scale`"
        return MeshError("SF303", f"{shown}, more than {LARGEST:g} m", hint)
    if size < SMALLEST:
        hint = "set `scale` to the length of one mesh unit in meters"
        return MeshError("SF303", f"{shown}, less than a millimeter", hint)
    return None


def not_closed(name: str, gaps: int) -> MeshError:
    """Return the error for a mesh that has edges with a face on only one side."""
    hint = "close the mesh, or write `solid: hull` to use the volume of its convex hull"
    return MeshError("SF302", f"{name} is not closed: {gaps} edges have a face on only one side", hint)


def no_volume(name: str) -> MeshError:
    """Return the error for a surface that encloses no volume."""
    return MeshError("SF301", f"{name} encloses no volume", "add thickness, or write `solid: hull`")


def flat() -> MeshError:
    """Return the error for coplanar points, which have no convex hull."""
    return MeshError("SF301", "the mesh is flat: all of its points are in one plane", "add thickness")


def too_large(name: str, size: int) -> MeshError:
    """Return the error for a file that is too large."""
    most = MAX_BYTES // 2**20
    return MeshError("SF301", f"{name} has {size / 2**20:.0f} MiB; the limit is {most} MiB", "decimate it first")


def shape_crosses_itself(what: str) -> MeshError:
    """Return the error for a profile or an outline that is not a simple polygon."""
    return MeshError("SF301", f"the {what} crosses itself or has no area", "list the corners in order along it")
