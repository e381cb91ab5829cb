"""Coordinates that move with the tissue: station along the tracked goal and lateral position across it.

Station runs 0..1 from the goal's first point to its last, lateral is 0 on the mid-line, +1 on the near row and -1 on the far row.
A pixel written in these coordinates on one picture is found again on a later one, as the tissue moved.
"""

from __future__ import annotations

import numpy as np

from hardware.interface import Array
from skills.scene.segments import cross
from skills.tracking.tracks import TrackedGoal

BEYOND = 100.0  # segments by which the goal is thought to go straight on past either end


def from_goal_coordinates(tracked: TrackedGoal, coordinates: Array) -> Array:
    """Find the pixels (N, 2) of `coordinates` (N, 2), (station, lateral), on the tracked goal."""
    nodes, middle, half = _strip(tracked)
    station = coordinates[:, 0]
    centre = np.column_stack([np.interp(station, nodes, middle[:, k]) for k in (0, 1)])
    across = np.column_stack([np.interp(station, nodes, half[:, k]) for k in (0, 1)])
    return np.asarray(centre + coordinates[:, 1:] * across)


def to_goal_coordinates(tracked: TrackedGoal, pixels: Array) -> Array:
    """Write `pixels` (N, 2) as (station, lateral) (N, 2) on the tracked goal: the inverse of `from_goal_coordinates`.

    Between two nodes the map is bilinear: x = m(t) + l h(t), so (x - m(t)) x h(t) = 0, a quadratic in t. Of several solutions (a
    bent goal seen from afar) the nearest to the mid-line is given; nan where there is none.
    """
    nodes, middle, half = _strip(tracked)
    m, dm, h, dh = middle[None, :-1], np.diff(middle, axis=0)[None], half[None, :-1], np.diff(half, axis=0)[None]
    x = pixels[:, None] - m
    t = _roots(-cross(dm, dh), cross(x, dh) - cross(dm, h), cross(x, h))  # (2, N, K)
    valid = np.isfinite(t) & (t >= -1e-9) & (t <= 1.0 + 1e-9)
    t = np.where(valid, t, 0.0)
    across = h + t[..., None] * dh
    lateral = ((x - t[..., None] * dm) * across).sum(-1) / np.maximum((across**2).sum(-1), 1e-12)
    station = nodes[:-1] + t * np.diff(nodes)
    # (N, 2 K): both roots in every segment, side by side.
    flat = [np.moveaxis(q, 0, 1).reshape(len(pixels), -1) for q in (np.where(valid, np.abs(lateral), np.inf), station, lateral)]
    best = np.argmin(flat[0], axis=1)
    rows = np.arange(len(pixels))
    found = np.column_stack([flat[1][rows, best], flat[2][rows, best]])
    return np.where(np.isfinite(flat[0][rows, best])[:, None], found, np.nan)


def _strip(tracked: TrackedGoal) -> tuple[Array, Array, Array]:
    """Stations (M + 2,), mid-line points and half-widths towards the near row (M + 2, 2), with a far node past each end."""
    middle, half = (tracked.near + tracked.far) / 2, (tracked.near - tracked.far) / 2
    count = len(middle) - 1
    first, last = middle[0] - BEYOND * (middle[1] - middle[0]), middle[-1] + BEYOND * (middle[-1] - middle[-2])
    nodes = np.concatenate([[-BEYOND], np.arange(count + 1), [count + BEYOND]]) / count
    return nodes, np.vstack([first, middle, last]), np.vstack([half[:1], half, half[-1:]])


def _roots(a: Array, b: Array, c: Array) -> Array:
    """Both roots (2, ...) of a t^2 + b t + c, free of cancellation and good for a = 0; nan where there is none."""
    a, b, c = np.broadcast_arrays(a, b, c)
    discriminant = b * b - 4 * a * c
    q = -0.5 * (b + np.where(b >= 0, 1.0, -1.0) * np.sqrt(np.maximum(discriminant, 0.0)))
    with np.errstate(divide="ignore", invalid="ignore"):
        roots = np.stack([q / a, c / q])
    return np.where(discriminant >= 0, roots, np.nan)
