"""In which order, and which way round, segments are cut: with the least travel between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array
from skills.scene.polyline import arc_lengths
from skills.scene.segments import distances
from skills.tracking.tracks import TrackedGoal

EXACT_UP_TO = 8  # segments whose every order is tried


def least_travel(segments: Array, tracked: TrackedGoal) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Order `segments` (S, 2, 2) for the least travel from each one's end to the next one's start.

    Also says which (S,) of the ordered ones to turn round. Up to `EXACT_UP_TO` segments every order and way is considered; more are
    cut along the goal, each turned for the least travel. Of equal travels the one along the goal is taken.
    """
    order, turned = order_along(segments, tracked)
    if not 2 < len(segments) <= EXACT_UP_TO:
        return order, turned
    best, flips = _shortest(segments[order])
    if travel(segments, order, turned) <= travel(segments, order[best], flips) + 1e-6:
        return order, turned
    if np.argmax(best == 0) > np.argmax(best == len(best) - 1):
        # As short backwards; the first along the goal comes before the last.
        best, flips = best[::-1], ~flips[::-1]
    return order[best], flips


def travel(segments: Array, order: NDArray[np.int64], turned: NDArray[np.bool_]) -> float:
    """Way [px] between `segments` (S, 2, 2) cut in `order`, those `turned` cut from their end."""
    ordered = segments[order]
    ordered = np.where(turned[:, None, None], ordered[:, ::-1], ordered)
    return float(np.linalg.norm(ordered[1:, 0] - ordered[:-1, 1], axis=1).sum())


def along_goal(points: Array, polyline: Array) -> tuple[Array, Array]:
    """Arc length [px] (N,) of the place on `polyline` (M, 2) nearest to each of `points` (N, 2), and its direction (N, 2)."""
    line = np.stack([polyline[:-1], polyline[1:]], axis=1)
    piece = np.argmin(distances(points, line), axis=1)
    start, along = line[piece, 0], line[piece, 1] - line[piece, 0]
    t = np.clip(((points - start) * along).sum(1) / np.maximum((along**2).sum(1), 1e-12), 0.0, 1.0)
    length = np.linalg.norm(along, axis=1)
    return arc_lengths(polyline)[piece] + t * length, along / np.maximum(length, 1e-12)[:, None]


def order_along(segments: Array, tracked: TrackedGoal) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Order `segments` (S, 2, 2) along the goal; also say which (S,) of the ordered ones to turn round for the least travel."""
    place, direction = along_goal(segments.mean(axis=1), tracked.polyline)
    order = np.argsort(place, kind="stable")
    ordered = segments[order]
    # Dynamic programming over the two ways to cut each segment; ties fall to the goal's own direction.
    forwards = ((ordered[:, 1] - ordered[:, 0]) * direction[order]).sum(1) >= 0
    ways = np.stack([ordered, ordered[:, ::-1]], axis=1)
    cost = np.where(np.column_stack([forwards, ~forwards]), 0.0, 1e-6)
    came: list[NDArray[np.int64]] = []
    total = cost[0]
    for k in range(1, len(ordered)):
        steps = np.linalg.norm(ways[k][None, :, 0] - ways[k - 1][:, None, 1], axis=-1)
        sums = total[:, None] + steps
        came.append(np.argmin(sums, axis=0))
        total = sums.min(axis=0) + cost[k]
    turned = [int(np.argmin(total))]
    for back in reversed(came):
        turned.append(int(back[turned[-1]]))
    return order, np.array(turned[::-1], dtype=bool)


def _shortest(segments: Array) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Order (S,) and turns (S,) of the least travel over all orders: dynamic programming over the sets already cut."""
    count = len(segments)
    ways = np.concatenate([segments, segments[:, ::-1]])  # way k: segment k % count, turned from `count` on
    step = np.linalg.norm(ways[:, None, 1] - ways[None, :, 0], axis=-1)
    segment = np.arange(2 * count) % count
    total = np.full((1 << count, 2 * count), np.inf)
    came = np.zeros((1 << count, 2 * count), dtype=np.int64)
    total[1 << segment, np.arange(2 * count)] = 0.0
    for done in range(1, (1 << count) - 1):
        sums = total[done][:, None] + step
        then = np.flatnonzero((done >> segment) & 1 == 0)
        after = done | (1 << segment[then])
        came[after, then] = np.argmin(sums[:, then], axis=0)
        total[after, then] = sums[:, then].min(axis=0)
    done, way = (1 << count) - 1, int(np.argmin(total[-1]))
    path = [way]
    while done & (done - 1):
        before = done & ~(1 << int(segment[way]))
        way = int(came[done, way])
        done = before
        path.append(way)
    ordered = np.array(path[::-1])
    return ordered % count, ordered >= count
