"""Segments that lose nothing: whatever edges one segment can cut together, one of these cuts together too.

Move a segment that cuts a set of edges sideways: until its line meets an end of one of them (or a crossing of two), the stretch between
the first and the last edge changes evenly, so one of the two ways does not lengthen it. Then turn it about that point: the stretch
is a convex function of the angle, so either the line comes to a second such point before the stretch gets too long, or the stretch
has its minimum in between. All segments through two points, slid along their line from edge to edge, and all of least stretch
through one point are therefore enough.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array
from skills.replan.sets import Words, contained, distinct, uncontained, words
from skills.scene.segments import TOUCH, cross, distances, meetings, touch

SPARES = 12  # segments kept for one set of edges: they differ in what else they cut
BISECTIONS = 50
BLOCK = 256  # lines looked at together


@dataclass(frozen=True)
class Cuts:
    """`segments` (S, 2, 2) pixels and which edges each cuts, `covers` (S, E). No set is part of another; some occur more than once."""

    segments: Array
    covers: NDArray[np.bool_]


def maximal_cuts(edges: Array, length: float, most: int, known: Cuts | None = None) -> Cuts | None:
    """All maximal sets of `edges` (E, 2, 2) pixels that one segment of at most `length` [px] can cut; None beyond `most` segments.

    Segments already `known`, each no longer than `length`, shorten the search: lines that add nothing to them are left out.
    """
    points = np.concatenate([edges.reshape(-1, 2), _crossings(edges)])
    known = known or Cuts(np.zeros((0, 2, 2)), np.zeros((0, len(edges)), dtype=bool))
    parts = [
        known,
        _through_two(points, edges, length, most, words(known.covers[_maximal(known.covers)])),
        _shortest_through_one(points, edges, length, most),
    ]
    found = [part for part in parts if part is not None]
    if len(found) < len(parts):
        return None
    cuts = Cuts(np.concatenate([part.segments for part in found]), np.concatenate([part.covers for part in found]))
    keep = _maximal(cuts.covers)
    return Cuts(cuts.segments[keep], cuts.covers[keep])


def _through_two(points: Array, edges: Array, length: float, most: int, known: Words) -> Cuts | None:
    """Segments of full length on the lines through two points, each from where it last touches one edge on."""
    i, j = np.nonzero(np.triu(_near(points, length)))
    # Each edge's own line too, from both ends, and a line across it, however long the edge.
    along = edges[:, 1] - edges[:, 0]
    starts = np.concatenate([points[i], edges[:, 0], edges[:, 1], edges.mean(axis=1)])
    steps = np.concatenate([points[j] - points[i], along, -along, np.column_stack([-along[:, 1], along[:, 0]])])
    reach = np.linalg.norm(steps, axis=1)
    directions = np.where(reach[:, None] > 0, steps / np.maximum(reach, 1e-300)[:, None], [1.0, 0.0])
    reach[len(i) :] = 0.0
    # Block by block along the longer side of the picture, with the edges that lie near the block.
    axis = int(np.argmax(np.ptp(starts, axis=0)))
    low, high = edges[:, :, axis].min(axis=1), edges[:, :, axis].max(axis=1)
    order = np.argsort(starts[:, axis], kind="stable")
    segments, covers = [], []
    for block in np.split(order, range(BLOCK, len(order), BLOCK)):
        first, last = starts[block[0], axis], starts[block[-1], axis]
        near = np.flatnonzero((high >= first - length - TOUCH) & (low <= last + length + TOUCH))
        where = meetings(starts[block], directions[block], edges[near])
        within = np.zeros((len(block), len(edges)), dtype=bool)
        within[:, near] = (where[0] <= length + TOUCH) & (where[1] >= -length - TOUCH)
        new = np.flatnonzero(~contained(words(within), known).any(axis=1))
        lines = block[new]
        line, begin, sets = _slid(where[0][new], where[1][new], reach[lines], length)
        line = lines[line]
        segments.append(starts[line, None] + (begin[:, None] + np.array([0.0, length]))[..., None] * directions[line, None])
        covers.append(np.zeros((len(line), len(edges)), dtype=bool))
        covers[-1][:, near] = sets
        if sum(len(cuts) for cuts in segments) > most:
            return None
    return Cuts(np.concatenate(segments), np.concatenate(covers))


def _slid(low: Array, high: Array, reach: Array, length: float) -> tuple[NDArray[np.int64], Array, NDArray[np.bool_]]:
    """Line and begin of each segment that spans 0 to `reach` (K,) on lines that meet edges from `low` to `high` (K, E); and its set."""
    line, first = _first_edges(low, high, reach, length)
    begin = np.minimum(high[line, first], 0.0)
    covers = _within(low[line], high[line], begin, length)
    keep = distinct(covers)[0]
    return line[keep], begin[keep], covers[keep]


def _first_edges(low: Array, high: Array, reach: Array, length: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Line and edge at which a segment may begin, so that it spans 0 to `reach` and no earlier start on its line cuts all that it does."""
    begin = np.where((low <= TOUCH) & (high > -np.inf), np.minimum(high, 0.0), np.inf)
    begin = np.where(begin + length >= reach[:, None] - TOUCH, begin, np.inf)
    order = np.argsort(begin, axis=1)
    begin = np.take_along_axis(begin, order, axis=1)
    # One sorted list for all lines: each line's positions lie in a range of their own.
    finite = low[np.isfinite(low)]
    wide = 4.0 * (float(np.abs(finite).max(initial=0.0)) + length + 1.0)
    shelf = wide * np.arange(len(low))[:, None]
    ends = np.sort((np.where(np.isfinite(low), low, wide / 2) + shelf).ravel())
    reached = np.searchsorted(ends, np.where(np.isfinite(begin), begin + length + TOUCH, -wide / 2) + shelf, side="right")
    more = np.diff(reached, axis=1, prepend=-1) > 0
    line, rank = np.nonzero(more & np.isfinite(begin))
    return line, order[line, rank]


def _shortest_through_one(points: Array, edges: Array, length: float, most: int) -> Cuts | None:
    """Segments through a point that meet one edge behind it and one ahead on the shortest way, or one edge squarely.

    Needed only where turning either way to the end of the two edges would make the way too long.
    """
    away = distances(points, edges)
    ends = [np.hypot(points[:, :1] - end[:, 0], points[:, 1:] - end[:, 1]) for end in (edges[:, 0], edges[:, 1])]
    at, f = np.nonzero((away <= length) & (away > TOUCH) & (np.minimum(*ends) > length))
    along = edges[f, 1] - edges[f, 0]
    normal = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)
    toward = np.sign(((edges[f, 0] - points[at]) * normal).sum(1))[:, None] * normal
    square = (at, toward, np.zeros(len(at)), away[at, f])

    from_ends = np.maximum(*ends)[: 2 * len(edges)]
    widest = np.maximum(from_ends[::2], from_ends[1::2])
    e, f = np.nonzero(np.triu((_edge_distances(edges) <= length) & (widest > length), 1))
    rows, at = np.nonzero((away[:, e] + away[:, f] <= length).T & (np.minimum(away[:, e], away[:, f]) > TOUCH).T)
    if len(at) > most:
        return None
    between = _shortest_between(points, at, edges, e[rows], f[rows], length)

    at, toward, behind, ahead = (np.concatenate(pair) for pair in zip(square, between, strict=True))
    begin = -behind - (length - behind - ahead) / 2
    segments = points[at, None] + (begin[:, None] + np.array([0.0, length]))[..., None] * toward[:, None]
    low, high = meetings(points[at], toward, edges)
    return Cuts(segments, _within(low, high, begin, length))


def _shortest_between(
    points: Array, at: NDArray[np.int64], edges: Array, e: NDArray[np.int64], f: NDArray[np.int64], length: float
) -> tuple[NDArray[np.int64], Array, Array, Array]:
    """Point, direction, distance behind (to edge e) and ahead (to edge f) of the shortest ways through `points[at]`."""
    p = points[at]
    # Angles under which f is seen ahead, and e behind, counted near each other.
    f0, f1 = _seen(edges[f] - p[:, None])
    e0, e1 = _seen(p[:, None] - edges[e])
    shift = _wrapped((e0 + e1) / 2 - (f0 + f1) / 2) - ((e0 + e1) / 2 - (f0 + f1) / 2)
    low = np.maximum(np.minimum(f0, f1), np.minimum(e0, e1) + shift)
    high = np.minimum(np.maximum(f0, f1), np.maximum(e0, e1) + shift)

    def line_of(edge: Array) -> tuple[Array, Array]:
        """Distance of a line from the point, and the angle of the foot on it."""
        along = edge[:, 1] - edge[:, 0]
        normal = np.column_stack([-along[:, 1], along[:, 0]]) / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
        d = ((edge[:, 0] - p) * normal).sum(1)
        return np.abs(d), np.arctan2(normal[:, 1], normal[:, 0]) + np.where(d < 0, np.pi, 0.0)

    (de, foot_e), (df, foot_f) = line_of(edges[e]), line_of(edges[f])

    def ways(theta: Array, k: NDArray[np.int64]) -> tuple[Array, Array]:
        with np.errstate(divide="ignore"):
            return de[k] / np.abs(np.cos(theta - foot_e[k])), df[k] / np.abs(np.cos(theta - foot_f[k]))

    every = np.arange(len(at))
    far = (np.add(*ways(low, every)) > length) & (np.add(*ways(high, every)) > length)
    k = np.flatnonzero((low < high) & far & (de > TOUCH) & (df > TOUCH))
    low, high = low[k], high[k]
    for _ in range(BISECTIONS):
        theta = (low + high) / 2
        behind, ahead = ways(theta, k)
        rising = behind * np.tan(theta - foot_e[k]) + ahead * np.tan(theta - foot_f[k]) > 0
        low, high = np.where(rising, low, theta), np.where(rising, theta, high)
    theta = (low + high) / 2
    behind, ahead = ways(theta, k)
    fits = behind + ahead <= length
    toward = np.column_stack([np.cos(theta), np.sin(theta)])
    return at[k][fits], toward[fits], behind[fits], ahead[fits]


def _seen(ends: Array) -> tuple[Array, Array]:
    """Angles of the two `ends` (K, 2, 2) seen from the origin, the second within half a turn of the first."""
    angle = np.arctan2(ends[..., 1], ends[..., 0])
    return angle[:, 0], angle[:, 0] + _wrapped(angle[:, 1] - angle[:, 0])


def _wrapped(angle: Array) -> Array:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def _within(low: Array, high: Array, begin: Array, length: float) -> NDArray[np.bool_]:
    return np.asarray((low <= begin[:, None] + length + TOUCH) & (high >= begin[:, None] - TOUCH))


def _near(points: Array, length: float) -> NDArray[np.bool_]:
    apart = np.hypot(points[:, None, 0] - points[None, :, 0], points[:, None, 1] - points[None, :, 1])
    return np.asarray((apart <= length) & (apart > 0))


def _edge_distances(edges: Array) -> Array:
    """Least distance (E, E) [px] between every two edges."""
    ends = np.minimum(distances(edges[:, 0], edges), distances(edges[:, 1], edges))
    return np.where(touch(edges, edges), 0.0, np.minimum(ends, ends.T))


def _crossings(edges: Array) -> Array:
    """Points (X, 2) where two edges cross."""
    i, j = np.nonzero(np.triu(touch(edges, edges), 1))
    r, s = edges[i, 1] - edges[i, 0], edges[j, 1] - edges[j, 0]
    turn = cross(r, s)
    real = np.abs(turn) > 1e-9
    i, j, r, s, turn = i[real], j[real], r[real], s[real], turn[real]
    t = cross(edges[j, 0] - edges[i, 0], s) / turn
    return np.asarray(edges[i, 0] + t[:, None] * r)


def _maximal(covers: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Indices of the rows of `covers` (S, E) that are part of no greater row; of equal rows a few, spread over their order."""
    first, which = distinct(covers)
    greatest_first = np.argsort(-covers[first].sum(axis=1), kind="stable")
    maximal = np.zeros(len(first), dtype=bool)
    maximal[greatest_first[uncontained(covers[first[greatest_first]])]] = True
    count = np.bincount(which)
    order = np.argsort(which, kind="stable")
    rank = np.empty(len(which), dtype=np.int64)
    rank[order] = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    spread = -(-count // SPARES)
    return np.flatnonzero(maximal[which] & (rank % spread[which] == 0))
