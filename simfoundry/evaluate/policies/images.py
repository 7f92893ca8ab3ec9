"""Pictures in the size that a policy takes: without distortion, padded with black, as openpi does it."""

from __future__ import annotations

import numpy as np

from simfoundry.evaluate.policies.base import Image, ImageSize


def resize_with_pad(image: Image, size: ImageSize) -> Image:
    """A picture, shape (h, w, 3), fitted into ``size`` and centred in black, shape (size.height, size.width, 3).

    Bilinear with Pillow's filter, which averages where it shrinks; sides are rounded down. The same pixels as
    ``openpi_client.image_tools.resize_with_pad``, on which the policies were trained.
    """
    height, width = image.shape[:2]
    if (height, width) == (size.height, size.width):
        return image
    from PIL import Image as Pictures

    ratio = max(width / size.width, height / size.height)
    inner = max(1, int(width / ratio)), max(1, int(height / ratio))
    small = np.asarray(Pictures.fromarray(np.ascontiguousarray(image)).resize(inner, Pictures.Resampling.BILINEAR))
    top, left = (size.height - inner[1]) // 2, (size.width - inner[0]) // 2
    out = np.zeros((size.height, size.width, 3), dtype=np.uint8)
    out[top : top + inner[1], left : left + inner[0]] = small
    return out
