"""Small square patches of a grey picture around points, and how alike two are."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array, Image

Patches = NDArray[np.float32]


def patches_at(gray: Image, points: Array, radius: int) -> Patches:
    """Cut the patches (N, S, S) float32, S = 2 `radius` + 1, around `points` (N, 2), bilinear."""
    side = np.arange(-radius, radius + 1, dtype=np.float32)
    size = len(side)
    if not len(points):
        return np.zeros((0, size, size), np.float32)
    u = points[:, 0].astype(np.float32)[:, None, None] + side[None, None, :]
    v = points[:, 1].astype(np.float32)[:, None, None] + side[None, :, None]
    # A patch in each row: OpenCV is slow on many short rows.
    u, v = (np.broadcast_to(x, (len(points), size, size)).reshape(len(points), -1) for x in (u, v))
    # OpenCV's remap takes at most 32767 rows; more points than that go in pieces.
    rows = 32000
    cut = [
        cv2.remap(gray, u[k : k + rows], v[k : k + rows], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for k in range(0, len(u), rows)
    ]
    return np.concatenate(cut).reshape(len(points), size, size).astype(np.float32)


def texture(patches: Patches) -> Array:
    """Give the standard deviation (N,) of each patch [grey levels]."""
    return np.asarray(patches.std(axis=(1, 2)), dtype=np.float64)


def same(a: Patches, b: Patches, noise: float) -> Array:
    """Say how alike patches `a` and `b` (N, S, S) are, whatever their mean brightness: (N,) -1..1, 1 for equal ones.

    One minus the squared difference over the patches' summed variances, those of the picture's `noise` [grey levels] included:
    close to the correlation where there is texture, and 1 for two flat patches, which correlation would call unlike.
    """
    x, y = (p.reshape(len(p), p.shape[1] * p.shape[2]) for p in (a, b))
    x, y = x - x.mean(axis=1, keepdims=True), y - y.mean(axis=1, keepdims=True)
    variances = (x**2).mean(axis=1) + (y**2).mean(axis=1) + 2 * noise**2
    return np.asarray(1.0 - ((x - y) ** 2).mean(axis=1) / variances, dtype=np.float64)
