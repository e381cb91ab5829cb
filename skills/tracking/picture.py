"""A frame as the trackers look at it: in colour, in grey with less noise, and in grey with its contrast made even."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hardware.interface import Image
from skills.scene.stereo import Region

MEAN, DEVIATION = 128.0, 40.0  # [grey levels] of an even picture everywhere


@dataclass(frozen=True)
class Picture:
    """`image` (H, W, 3) uint8 RGB as taken; `grey` (H, W) uint8 smoothed; `even` (H, W) uint8 of one contrast, flat outside its box."""

    image: Image
    grey: Image
    even: Image


def picture_of(image: Image, surroundings: int, box: Region) -> Picture:
    """Prepare `image` (H, W, 3) uint8 RGB; within `box`, contrast is made even as measured within `surroundings` [px] of each pixel."""
    # Slightly smoothed: on poor texture the noise would otherwise decide how alike two patches are.
    rgb = np.ascontiguousarray(image)
    grey = np.asarray(cv2.GaussianBlur(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), (5, 5), 1.0), dtype=np.uint8)
    u0, v0, u1, v1 = box
    even = np.full(grey.shape, int(MEAN), dtype=np.uint8)
    even[v0:v1, u0:u1] = evened(grey[v0:v1, u0:u1], surroundings)
    return Picture(image, grey, even)


def evened(grey: Image, surroundings: int, noise: float = 2.5) -> Image:
    """Give every neighbourhood of `grey` (H, W) uint8 the same mean and contrast; what is no more than `noise` stays faint.

    Light that falls off, tissue that turns to the light and a dimmed lamp change brightness and contrast, but slowly over the picture:
    here they are gone, and pale tissue has as much to follow as printed tissue.
    """
    size = (2 * surroundings + 1, 2 * surroundings + 1)
    mean: NDArray[np.float32] = np.asarray(cv2.boxFilter(grey, cv2.CV_32F, size), dtype=np.float32)
    variance: NDArray[np.float32] = np.asarray(cv2.sqrBoxFilter(grey, cv2.CV_32F, size), dtype=np.float32)
    variance -= mean * mean
    np.maximum(variance, 0.0, out=variance)
    variance += np.float32(noise**2)
    difference = np.asarray(cv2.subtract(grey, mean, dtype=cv2.CV_32F), dtype=np.float32) / np.sqrt(variance)
    return np.asarray(cv2.convertScaleAbs(difference, alpha=DEVIATION, beta=MEAN), dtype=np.uint8)
