"""Uncut edges for tests of replanning: across a goal, jagged, some off it; and anything at all."""

from __future__ import annotations

import numpy as np

from hardware.interface import Array


def across(rng: np.random.Generator, count: int, length: float = 320.0, v: float = 240.0) -> Array:
    """Edges (E, 2, 2) [px] across the goal `tests.skills.goals.straight`, with jittered ends, one in eight beside the line."""
    u = np.sort(rng.uniform(170.0, 150.0 + length, count))
    jitter = rng.normal(0.0, 3.0, (count, 2, 2))
    edges = np.stack([np.column_stack([u, np.full(count, v + side)]) for side in (-14.0, 14.0)], axis=1) + jitter
    beside = (rng.random(count) < 0.125) * rng.choice([-1.0, 1.0], count) * rng.uniform(10.0, 30.0, count)
    edges[:, :, 1] += beside[:, None]
    return edges


def anywhere(rng: np.random.Generator, count: int, size: float = 90.0) -> Array:
    """Edges (E, 2, 2) [px] of any length and direction, some of which cross, share ends or are points."""
    kind = rng.integers(3)
    if kind == 0:
        return rng.uniform(0.0, size, (count, 2, 2))
    if kind == 1:
        return rng.integers(0, 7, (count, 2, 2)) * size / 6
    middle = rng.uniform(0.0, size, (count, 1, 2))
    return middle + rng.normal(0.0, 8.0, (count, 2, 2))


def segments_among(rng: np.random.Generator, edges: Array, length: float, count: int) -> Array:
    """Random segments (S, 2, 2) [px] of `length` near `edges` (E, 2, 2): about random points of them, at any angle."""
    which, t = rng.integers(len(edges), size=count), rng.random((count, 1))
    at = edges[which, 0] + t * (edges[which, 1] - edges[which, 0])
    angle = rng.uniform(0.0, np.pi, count)
    direction = length * np.column_stack([np.cos(angle), np.sin(angle)])
    start = at - rng.random((count, 1)) * direction
    return np.stack([start, start + direction], axis=1)
