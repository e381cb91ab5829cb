"""Small square patches of a grey picture around points: how alike two are, and where one is found again below the pixel."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array, Image

Patches = NDArray[np.float32]


def patches_at(gray: Image, points: Array, radius: int) -> Patches:
    """Cut the patches (N, S, S) float32, S = 2 `radius` + 1, around `points` (N, 2), bilinear."""
    side = np.arange(-radius, radius + 1, dtype=np.float32)
    u = points[:, 0].astype(np.float32)[:, None, None] + side[None, None, :]
    v = points[:, 1].astype(np.float32)[:, None, None] + side[None, :, None]
    size = len(side)
    u, v = (np.ascontiguousarray(np.broadcast_to(x, (len(points), size, size)).reshape(-1, size)) for x in (u, v))
    if not len(points):
        return np.zeros((0, size, size), np.float32)
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
    x, y = (p.reshape(len(p), p.shape[1] * p.shape[2]).astype(np.float64) for p in (a, b))
    x, y = x - x.mean(axis=1, keepdims=True), y - y.mean(axis=1, keepdims=True)
    variances = (x**2).mean(axis=1) + (y**2).mean(axis=1) + 2 * noise**2
    return np.asarray(1.0 - ((x - y) ** 2).mean(axis=1) / variances)


def align(gray: Image, templates: Patches, points: Array, steps: int, reach: float) -> Array:
    """Shift each of `points` (N, 2) so that the picture fits its template (N, S, S) there, by at most `reach` [px].

    Gauss-Newton on the brightness difference of the mean-free patches (Lucas and Kanade, inverse compositional: the gradients are
    the template's, so all points of one step share a single read-out of the picture).
    """
    if not len(points):
        return points.copy()
    size = templates.shape[-1]
    inner = slice(1, size - 1)
    gu = (templates[:, inner, 2:] - templates[:, inner, :-2]) / 2
    gv = (templates[:, 2:, inner] - templates[:, :-2, inner]) / 2
    core = templates[:, inner, inner]
    core = core - core.mean(axis=(1, 2), keepdims=True)
    # A little damping keeps flat directions (an edge seen along itself) where the flow put them.
    damping = 4.0 * core[0].size
    uu, vv, uv = (gu * gu).sum((1, 2)) + damping, (gv * gv).sum((1, 2)) + damping, (gu * gv).sum((1, 2))
    determinant = uu * vv - uv * uv
    place = points.copy()
    for _ in range(steps):
        now = patches_at(gray, place, size // 2 - 1)
        error = now - now.mean(axis=(1, 2), keepdims=True) - core
        eu, ev = (error * gu).sum((1, 2)), (error * gv).sum((1, 2))
        place = place - np.column_stack([(vv * eu - uv * ev) / determinant, (uu * ev - uv * eu) / determinant])
        offset = place - points
        length = np.linalg.norm(offset, axis=1, keepdims=True)
        place = points + offset * np.minimum(1.0, reach / np.maximum(length, 1e-12))
    return place
