"""Pictures padded to the sizes that networks take."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

MULTIPLE = 8  # [px]: flow networks work on an eighth of the size
LEAST = 128  # [px]: the coarsest of four levels of an eighth must be more than one pixel


def padded(image: NDArray[np.uint8], size: tuple[int, int] | None = None) -> tuple[NDArray[np.uint8], tuple[int, int]]:
    """Pad `image` (H, W, ...) evenly on all sides by its border; give it, and (top, left) of the image in it.

    Without `size` (height, width) to the next multiple of 8, and to 128 at least.
    """
    height, width = image.shape[:2]
    wanted_height, wanted_width = size or (_up(height), _up(width))
    over = max(0, wanted_height - height), max(0, wanted_width - width)
    top, left = over[0] // 2, over[1] // 2
    grown = cv2.copyMakeBorder(image, top, over[0] - top, left, over[1] - left, cv2.BORDER_REPLICATE)
    return np.asarray(grown, dtype=np.uint8), (top, left)


def _up(length: int) -> int:
    return max(LEAST, -(-length // MULTIPLE) * MULTIPLE)
