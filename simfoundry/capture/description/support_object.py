"""The support as an object.

It is a slab that has the visible outline, its measured thickness, and a texture from the image.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.solids import prism_mesh
from simfoundry.capture.frame import Frame, SupportSurface
from simfoundry.capture.frames.reduced import reduced_frame, reduction
from simfoundry.capture.segment.masks import Labels, simplified
from simfoundry.capture.shapes.texture import encode_png
from simfoundry.geometry.frames import Array, frozen_array
from simfoundry.geometry.shapes import Mesh

DEFAULT_THICKNESS = 0.03  # Thickness [m] of a tabletop whose edge is not visible; common tops are 18 to 40 mm thick

THINNEST = 0.012  # Minimum thickness of a tabletop [m]; anything thinner is noise at its rim
EDGE = 0.015  # Maximum distance [m] from the outline of points on the edge of the support, which are below its top

# Size of a texture pixel on the top [m], unless this would exceed the size limit of the texture.
TEXTURE_STEP = 0.002
# Maximum length of the longer side of the texture [px]: at most 3 MB, and more detail than a camera sees from 1 m away.
TEXTURE_LIMIT = 1024

IN_FRONT = 0.02  # Minimum distance [m] in front of the top of a reading that hides it, even if it is not on an object

BLUR_PX = 4.0  # Standard deviation of the blur of hidden colors [px], which is doubled until all of them are filled in

MARGIN = 0.01  # Distance [m] by which a support extends past the objects on it if its own edge is not visible there


def beneath(outline: Array, footprints: list[Array]) -> Array:
    """Extend the outline of the support so that it contains the footprint of every object on the support.

    The outline [m] has shape (n, 2).
    """
    import shapely

    whole = shapely.Polygon(outline)
    for footprint in footprints:
        ground = shapely.MultiPoint(footprint).convex_hull.buffer(MARGIN, quad_segs=2)
        if not whole.contains(ground):
            joined = whole.union(ground)
            # Connect a footprint that is separate from the visible surface by the shortest path.
            bridge = shapely.shortest_line(whole, ground).buffer(MARGIN, quad_segs=2)
            whole = joined if joined.geom_type == "Polygon" else joined.union(bridge)
    simple = simplified(shapely.Polygon(whole.exterior), 0.002, growth=1.5)
    return frozen_array(np.array(shapely.geometry.polygon.orient(simple).exterior.coords)[:-1])


def measured_thickness(frame: Frame, support: SupportSurface) -> float | None:
    """Return the thickness of the support [m], or None if too few points on its edge are visible."""
    import shapely

    small = reduced_frame(frame, reduction(frame.depth.shape))
    points = support.X_WC.apply(small.points_of(np.isfinite(small.depth)))
    below = points[(points[:, 2] < -0.004) & (points[:, 2] > -0.12)]
    ring = shapely.Polygon(support.outline).exterior
    near = below[shapely.distance(ring, shapely.points(below[:, :2])) < EDGE] if len(below) else below
    if len(near) < 300:
        return None
    counts, edges = np.histogram(-near[:, 2], bins=np.arange(0.004, 0.124, 0.004))
    dense = counts > 0.02 * len(near)
    end = int(np.argmin(dense))  # the edge is a single band that starts at the top
    return None if not dense[0] or dense.all() or edges[end] < THINNEST else float(edges[end])


def painted_support(frame: Frame, support: SupportSurface, labels: Labels) -> tuple[float | None, Mesh]:
    """Return the measured thickness of the support [m], or None, and its textured mesh. See :func:`support_mesh`."""
    thickness = measured_thickness(frame, support)
    return thickness, support_mesh(frame, support, labels, thickness or DEFAULT_THICKNESS)


def support_mesh(frame: Frame, support: SupportSurface, labels: Labels, height: float) -> Mesh:
    """Return the slab as a mesh whose top is at z = 0, with the image projected onto it.

    Texture coordinates are positions in the bounding rectangle of the outline, so the sides get the color of the
    adjacent rim. Areas that are outside the image or hidden by objects get the color of the nearest visible area.
    Objects are the pixels at which ``labels``, an array of shape (h, w), is above 0.
    """
    vertices, faces = prism_mesh(support.outline, height)
    vertices = vertices - np.array([0.0, 0.0, height / 2])
    low, high = support.outline.min(axis=0), support.outline.max(axis=0)
    uv = (vertices[:, :2] - low) / (high - low)
    return Mesh(frozen_array(vertices), faces, frozen_array(uv), _texture(frame, support, labels, low, high))


def _texture(frame: Frame, support: SupportSurface, labels: Labels, low: Array, high: Array) -> bytes:
    """Return a PNG image of the top as seen from above, with +x to the right and +y up."""
    import cv2

    extent = high - low
    step = max(TEXTURE_STEP, float(extent.max()) / TEXTURE_LIMIT)
    width, height = (max(8, round(float(e) / step)) for e in extent)
    x = low[0] + (np.arange(width) + 0.5) / width * extent[0]
    y = high[1] - (np.arange(height) + 0.5) / height * extent[1]
    grid = np.stack([*np.meshgrid(x, y), np.zeros((height, width))], axis=-1)
    in_camera = support.X_WC.inverse().apply(grid)
    depth = np.maximum(in_camera[..., 2], 1e-6)
    u = (in_camera[..., 0] / depth * frame.K[0, 0] + frame.K[0, 2]).astype(np.float32)
    v = (in_camera[..., 1] / depth * frame.K[1, 1] + frame.K[1, 2]).astype(np.float32)
    color = cv2.remap(frame.color, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    bare = cv2.erode((labels == 0).astype(np.uint8), np.ones((7, 7), np.uint8))
    seen = cv2.remap(bare, u, v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0) > 0
    measured = cv2.remap(frame.depth, u, v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan)
    with np.errstate(invalid="ignore"):
        seen &= ~(measured < depth - IN_FRONT)  # if depth is missing, assume that the surface is visible
    return encode_png(filled_colors(color, seen & (in_camera[..., 2] > 0)))


def filled_colors(color: NDArray[np.uint8], seen: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Fill pixels that were not visible with a blurred copy of nearby visible pixels.

    Each pixel gets the colors within the smallest of the distances 4, 8, 16 ... px at which there are any. They are
    blurred in images of half the size of the one before, which takes a tenth of the time for the largest distances.
    """
    import cv2

    weight = seen.astype(np.float32)
    values = color.astype(np.float32) * weight[..., None]
    mean = values.sum(axis=(0, 1)) / max(float(weight.sum()), 1.0)
    out, missing, size = color.copy(), ~seen, seen.shape[::-1]
    while missing.any() and max(weight.shape) > BLUR_PX / 2:
        blurred, mass = cv2.GaussianBlur(values, (0, 0), BLUR_PX), cv2.GaussianBlur(weight, (0, 0), BLUR_PX)
        if mass.shape != seen.shape:
            blurred = cv2.resize(blurred, size, interpolation=cv2.INTER_LINEAR)
            mass = cv2.resize(mass, size, interpolation=cv2.INTER_LINEAR)
        fill = missing & (mass > 1e-2)
        out[fill] = np.clip(blurred[fill] / mass[fill][:, None] + 0.5, 0, 255).astype(np.uint8)
        missing = missing & ~fill
        half = max(1, weight.shape[1] // 2), max(1, weight.shape[0] // 2)
        values = cv2.resize(values, half, interpolation=cv2.INTER_AREA)
        weight = cv2.resize(weight, half, interpolation=cv2.INTER_AREA)
    if missing.any():
        out[missing] = mean.astype(np.uint8)
    return out
