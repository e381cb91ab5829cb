"""Line segments in the image plane: which touch, where, and how far points lie from them.

Segments are (K, 2, 2) float64 pixels: start and end, each (u, v).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array

TOUCH = 1e-9  # [px] segments nearer than this touch


def cross(a: Array, b: Array) -> Array:
    """Give the z component of the cross product of plane vectors (..., 2)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def distances(points: Array, segments: Array) -> Array:
    """Distance [px] of each of `points` (N, 2) to each of `segments` (K, 2, 2): (N, K)."""
    start, along = segments[None, :, 0], segments[None, :, 1] - segments[None, :, 0]
    offset = points[:, None] - start
    squared = np.maximum((along**2).sum(-1), 1e-300)
    t = np.clip((offset * along).sum(-1) / squared, 0.0, 1.0)
    return np.asarray(np.linalg.norm(offset - t[..., None] * along, axis=-1))


def touch(a: Array, b: Array) -> NDArray[np.bool_]:
    """Which of segments `a` (A, 2, 2) meet which of `b` (B, 2, 2): (A, B) bool.

    A shared end point, an end on the other segment and an overlap along one line all count.
    """
    p, r = a[:, None, 0], a[:, None, 1] - a[:, None, 0]
    q, s = b[None, :, 0], b[None, :, 1] - b[None, :, 0]
    a_splits_b = cross(r, q - p) * cross(r, q + s - p) < 0
    b_splits_a = cross(s, p - q) * cross(s, p + r - q) < 0
    end_on_b = np.minimum(distances(a[:, 0], b), distances(a[:, 1], b)) <= TOUCH
    end_on_a = np.minimum(distances(b[:, 0], a), distances(b[:, 1], a)).T <= TOUCH
    return np.asarray((a_splits_b & b_splits_a) | end_on_b | end_on_a)


def span(segment: Array, others: Array) -> tuple[float, float]:
    """Give the part of `segment` (2, 2), as parameters 0..1 from its start, in which `others` (K, 2, 2) touch it."""
    p, r = segment[0], segment[1] - segment[0]
    q, s = others[:, 0], others[:, 1] - others[:, 0]
    turn = cross(np.broadcast_to(r, s.shape), s)
    lengths = np.linalg.norm(r) * np.linalg.norm(s, axis=1)
    parallel = np.abs(turn) <= 1e-9 * np.maximum(lengths, 1e-300)
    meeting = cross(q - p, s) / np.where(parallel, 1.0, turn)
    ends = ((others - p) @ r) / max(float(r @ r), 1e-300)
    low = np.clip(np.where(parallel, ends.min(axis=1), meeting), 0.0, 1.0)
    high = np.clip(np.where(parallel, ends.max(axis=1), meeting), 0.0, 1.0)
    return float(low.min()), float(high.max())
