"""Polylines of pixels: arc length, even resampling, directions and normals."""

from __future__ import annotations

import numpy as np

from hardware.interface import Array


def arc_lengths(polyline: Array) -> Array:
    """Length [px] along `polyline` (M, 2) from its first point to each of its points: (M,)."""
    steps = np.linalg.norm(np.diff(polyline, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def resample(polyline: Array, n: int) -> Array:
    """`n` >= 2 points (n, 2), evenly spaced by arc length along `polyline` (M, 2) pixels; the ends are kept.

    Raises:
        ValueError: fewer than two points are asked for, or the polyline has no length.
    """
    s = arc_lengths(polyline)
    if n < 2 or not s[-1] > 0:
        raise ValueError("resampling needs a polyline with a length and at least two points to make")
    return at_length(polyline, np.linspace(0.0, s[-1], n))


def at_length(polyline: Array, lengths: Array) -> Array:
    """Points (K, 2) of `polyline` (M, 2) at arc `lengths` (K,) [px], held at its ends beyond them."""
    s = arc_lengths(polyline)
    return np.column_stack([np.interp(lengths, s, polyline[:, 0]), np.interp(lengths, s, polyline[:, 1])])


def directions(polyline: Array) -> Array:
    """Give the unit direction (M, 2) of `polyline` (M, 2) at each of its points: the mean of the segments that meet there."""
    steps = np.diff(polyline, axis=0)
    units = steps / np.maximum(np.linalg.norm(steps, axis=1, keepdims=True), 1e-12)
    sums = np.vstack([units[:1], units[:-1] + units[1:], units[-1:]])
    norms = np.linalg.norm(sums, axis=1, keepdims=True)
    # Where the line folds back on itself the mean vanishes; the arriving segment's direction stands in.
    arriving = np.vstack([units[:1], units])
    return np.where(norms > 1e-9, sums / np.maximum(norms, 1e-12), arriving)


def left_normals(polyline: Array) -> Array:
    """Give the unit normals (M, 2) of `polyline` (M, 2): its directions turned by +90 degrees in (u, v)."""
    d = directions(polyline)
    return np.column_stack([-d[:, 1], d[:, 0]])


def side_of(polyline: Array, point: Array) -> float:
    """+1 if `point` (2,) lies on the side of `left_normals` of the nearest part of `polyline` (M, 2), else -1."""
    start, along = polyline[:-1], np.diff(polyline, axis=0)
    t = np.clip(((point - start) * along).sum(1) / np.maximum((along**2).sum(1), 1e-300), 0.0, 1.0)
    offset = point - (start + t[:, None] * along)
    k = int(np.argmin((offset**2).sum(1)))
    return 1.0 if along[k, 0] * offset[k, 1] - along[k, 1] * offset[k, 0] >= 0 else -1.0
