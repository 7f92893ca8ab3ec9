"""Agreement of a rendered image with a real one: the seven measures of the paper.

None of them needs a network. All are defined on intensities in [0, 1].
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array

# SSIM (Wang et al. 2004): standard deviation [px] of the Gaussian window, and the constants for intensities in [0, 1].
SSIM_SIGMA, SSIM_C1, SSIM_C2 = 1.5, 0.01**2, 0.03**2

# Linear sRGB to CIE XYZ, for the white point D65, and that white point (IEC 61966-2-1).
SRGB_TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
WHITE_D65 = np.array([0.95047, 1.0, 1.08883])

# Luma of R'G'B' (ITU-R BT.601), as most image libraries convert to gray.
LUMA = np.array([0.299, 0.587, 0.114])


@dataclass(frozen=True)
class ImageAgreement:
    """The agreement of two images.

    Attributes:
        psnr: Peak signal-to-noise ratio [dB]; infinite for equal images.
        ssim: Structural similarity over Gaussian windows, in [-1, 1], averaged over the color channels.
        mae: Mean absolute error.
        rmse: Root mean squared error.
        ncc: Normalized cross-correlation of all intensities, in [-1, 1]; NaN for an image of one color.
        delta_e: Mean CIE76 color difference in CIELAB.
        edge_mae: Mean absolute difference of the Sobel gradient magnitudes, which are in [0, 1].
    """

    psnr: float
    ssim: float
    mae: float
    rmse: float
    ncc: float
    delta_e: float
    edge_mae: float

    def to_json(self) -> dict[str, Any]:
        """Return the measures as plain data for JSON, with null for those that are infinite or undefined."""
        return {key: round(value, 6) if math.isfinite(value) else None for key, value in asdict(self).items()}


def image_agreement(
    rendered: NDArray[np.uint8], real: NDArray[np.uint8], mask: NDArray[np.bool_] | None = None
) -> ImageAgreement:
    """Compare a rendered sRGB image with a real one.

    Args:
        rendered: The rendered image, shape (h, w, 3).
        real: The real image, shape (h, w, 3).
        mask: The pixels that count, shape (h, w), or None for all. Windows around them may reach beyond.

    Raises:
        ValueError: The images differ in size, or no pixel counts.
    """
    if rendered.shape != real.shape or real.ndim != 3 or real.shape[2] != 3:
        raise ValueError(f"cannot compare images of shapes {rendered.shape} and {real.shape}")
    where = np.ones(real.shape[:2], dtype=bool) if mask is None else mask
    if not where.any():
        raise ValueError("no pixel of the images counts")
    a, b = rendered.astype(np.float64) / 255.0, real.astype(np.float64) / 255.0
    error = (a - b)[where]
    mse = float((error**2).mean())
    return ImageAgreement(
        psnr=10 * math.log10(1 / mse) if mse > 0 else math.inf,
        ssim=float(_ssim_map(a, b)[where].mean()),
        mae=float(np.abs(error).mean()),
        rmse=math.sqrt(mse),
        ncc=_correlation(a[where], b[where]),
        delta_e=float(np.linalg.norm(lab(a[where]) - lab(b[where]), axis=-1).mean()),
        edge_mae=float(np.abs(_edge_strength(a) - _edge_strength(b))[where].mean()),
    )


def lab(rgb: Array) -> Array:
    """Return CIELAB values of sRGB colors in [0, 1], for the white point D65. The shape is (..., 3)."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    xyz = linear @ SRGB_TO_XYZ.T / WHITE_D65
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    x, y, z = np.moveaxis(f, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def _correlation(a: Array, b: Array) -> float:
    """Return the correlation of zero-mean, unit-variance values, or NaN if one of the two is constant."""
    if np.ptp(a) == 0 or np.ptp(b) == 0:
        return math.nan
    a, b = a.ravel() - a.mean(), b.ravel() - b.mean()
    return float(a @ b) / float(np.linalg.norm(a) * np.linalg.norm(b))


def _ssim_map(a: Array, b: Array) -> Array:
    """Return the structural similarity around each pixel, averaged over the channels, shape (h, w)."""
    from scipy.ndimage import gaussian_filter

    def blurred(values: Array) -> Array:
        return np.asarray(gaussian_filter(values, (SSIM_SIGMA, SSIM_SIGMA, 0), truncate=3.5))

    mean_a, mean_b = blurred(a), blurred(b)
    var_a, var_b = blurred(a * a) - mean_a**2, blurred(b * b) - mean_b**2
    covariance = blurred(a * b) - mean_a * mean_b
    top = (2 * mean_a * mean_b + SSIM_C1) * (2 * covariance + SSIM_C2)
    return np.asarray((top / ((mean_a**2 + mean_b**2 + SSIM_C1) * (var_a + var_b + SSIM_C2))).mean(axis=2))


def _edge_strength(rgb: Array) -> Array:
    """Return the Sobel gradient magnitude of the luma, shape (h, w), normalized to [0, 1]."""
    from scipy.ndimage import sobel

    luma = rgb @ LUMA
    return np.asarray(np.hypot(sobel(luma, axis=0), sobel(luma, axis=1)) / (4 * math.sqrt(2)))
