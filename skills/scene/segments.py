"""Line segments in the image plane: which touch, where, and how far points lie from them.

Segments are (K, 2, 2) float64 pixels: start and end, each (u, v).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array

TOUCH = 1e-9  # [px] segments nearer than this touch
BLOCK = 256  # segments compared at a time: their pairs stay in the cache


def cross(a: Array, b: Array) -> Array:
    """Give the z component of the cross product of plane vectors (..., 2)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def distances(points: Array, segments: Array) -> Array:
    """Distance [px] of each of `points` (N, 2) to each of `segments` (K, 2, 2): (N, K)."""
    u, v = segments[:, 0].T
    du, dv = (segments[:, 1] - segments[:, 0]).T
    off_u, off_v = points[:, :1] - u, points[:, 1:] - v
    t = np.clip((off_u * du + off_v * dv) / np.maximum(du * du + dv * dv, 1e-300), 0.0, 1.0)
    return np.asarray(np.sqrt((off_u - t * du) ** 2 + (off_v - t * dv) ** 2))


def touch(a: Array, b: Array) -> NDArray[np.bool_]:
    """Which of segments `a` (A, 2, 2) meet which of `b` (B, 2, 2): (A, B) bool.

    A shared end point, an end on the other segment and an overlap along one line all count. Only pairs whose extents overlap along
    the longer side of the picture are compared, so the cost grows with the number of neighbours, not with A times B.
    """
    met: NDArray[np.bool_] = np.zeros((len(a), len(b)), dtype=bool)
    if not met.size:
        return met
    axis = int(np.argmax(np.ptp(b.reshape(-1, 2), axis=0)))
    a_order, b_order = np.argsort(a[:, :, axis].min(axis=1)), np.argsort(b[:, :, axis].min(axis=1))
    b_sorted = b[b_order]
    b_low, b_high = b_sorted[:, :, axis].min(axis=1), np.maximum.accumulate(b_sorted[:, :, axis].max(axis=1))
    for start in range(0, len(a), BLOCK):
        rows = a_order[start : start + BLOCK]
        block = a[rows]
        low, high = block[:, :, axis].min() - 2 * TOUCH, block[:, :, axis].max() + 2 * TOUCH
        first, last = np.searchsorted(b_high, low), np.searchsorted(b_low, high, side="right")
        if first < last:
            met[np.ix_(rows, b_order[first:last])] = _touch_all(block, b_sorted[first:last])
    return met


def _touch_all(a: Array, b: Array) -> NDArray[np.bool_]:
    """Compare every pair: (A, B) bool."""
    middle = b.mean(axis=(0, 1))
    a, b = a - middle, b - middle  # small numbers: the products below stay exact enough
    splits_b, splits_a = _sides(a, b), _sides(b, a).T
    # Where an end lies on the other's line, up to rounding, a closer look decides.
    extent = float(max(np.abs(a).max(), np.abs(b).max()))
    near_b, near_a = (1e-7 * extent * (np.abs(x[:, 1] - x[:, 0]).sum(-1) + 1e-3) ** 2 for x in (a, b))
    met = np.asarray((splits_b < -near_b[:, None]) & (splits_a < -near_a))
    i, j = np.nonzero((splits_b <= near_b[:, None]) & (splits_a <= near_a) & ~met)
    if len(i):
        met[i, j] = _touch_each(a[i], b[j])
    return met


def _touch_each(a: Array, b: Array) -> NDArray[np.bool_]:
    """Whether each of `a` (K, 2, 2) meets its own of `b` (K, 2, 2): (K,) bool."""
    p, r = a[:, 0], a[:, 1] - a[:, 0]
    q, s = b[:, 0], b[:, 1] - b[:, 0]
    a_splits_b = cross(r, q - p) * cross(r, q + s - p) < 0
    b_splits_a = cross(s, p - q) * cross(s, p + r - q) < 0
    apart = np.minimum.reduce([_distance(a[:, k], b) for k in (0, 1)] + [_distance(b[:, k], a) for k in (0, 1)])
    return np.asarray((a_splits_b & b_splits_a) | (apart <= TOUCH))


def _sides(a: Array, b: Array) -> Array:
    """Product (A, B) of the distances of both ends of b from a's line, times a's length squared: negative where the line splits b."""
    p, r = a[:, 0], a[:, 1] - a[:, 0]
    line = np.column_stack([r, -cross(r, p)])

    def beyond(ends: Array) -> Array:
        return np.asarray(line @ np.stack([ends[:, 1], -ends[:, 0], np.ones(len(ends))]))

    return np.asarray(beyond(b[:, 0]) * beyond(b[:, 1]))


def _distance(points: Array, segments: Array) -> Array:
    """Distance [px] (K,) of each of `points` (K, 2) to its own of `segments` (K, 2, 2)."""
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    offset = points - start
    t = np.clip((offset * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-300), 0.0, 1.0)
    return np.asarray(np.linalg.norm(offset - t[:, None] * along, axis=-1))


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


def meetings(points: Array, directions: Array, segments: Array) -> tuple[Array, Array]:
    """Where the lines through `points` (K, 2) along unit `directions` (K, 2) meet each of `segments` (S, 2, 2).

    Gives the lowest and the highest position (K, S) [px] along each line, counted from its point; they differ only where a segment
    lies along the line. Where they do not meet it is (inf, -inf). Ends nearer to the line than `TOUCH` lie on it.
    """
    ends = segments.reshape(-1, 2)
    u, v = points[:, :1], points[:, 1:]
    du, dv = directions[:, :1], directions[:, 1:]
    aside = du * (ends[:, 1] - v) - dv * (ends[:, 0] - u)
    ahead = du * (ends[:, 0] - u) + dv * (ends[:, 1] - v)
    aside = np.where(np.abs(aside) <= TOUCH, 0.0, aside)
    s0, s1, r0, r1 = aside[:, ::2], aside[:, 1::2], ahead[:, ::2], ahead[:, 1::2]
    apart = s0 - s1
    along = apart == 0.0
    where = r0 + (r1 - r0) * s0 / np.where(along, 1.0, apart)
    met = s0 * s1 <= 0.0
    low = np.where(met, np.where(along, np.minimum(r0, r1), where), np.inf)
    high = np.where(met, np.where(along, np.maximum(r0, r1), where), -np.inf)
    return low, high
