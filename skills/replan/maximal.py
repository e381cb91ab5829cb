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

ROUGH = 1e-6  # [px, px^2] by which a quick look may be off
SPARES = 12  # segments kept for one set of edges: they differ in what else they cut
NEWTON_STEPS = 12
BLOCK = 512  # lines looked at together


@dataclass(frozen=True)
class Cuts:
    """`segments` (S, 2, 2) pixels and which edges each cuts, `covers` (S, E)."""

    segments: Array
    covers: NDArray[np.bool_]


def maximal_cuts(edges: Array, length: float, most: int, known: NDArray[np.bool_] | None = None) -> Cuts | None:
    """All maximal sets of `edges` (E, 2, 2) pixels that one segment of at most `length` [px] can cut; None beyond `most` segments.

    Sets that are part of a set which is `known` (K, E) already are left out, which shortens the search. Some sets occur more than once.
    """
    touching = touch(edges, edges)
    points = np.concatenate([edges.reshape(-1, 2), _crossings(edges, touching)])
    done = np.zeros((0, len(edges)), dtype=bool) if known is None else known[_greatest(known)]
    parts = [_through_two(points, edges, length, most, done), _shortest_through_one(points, edges, touching, length, most, done)]
    found = [part for part in parts if part is not None]
    if len(found) < len(parts):
        return None
    cuts = Cuts(np.concatenate([part.segments for part in found]), np.concatenate([part.covers for part in found]))
    keep = maximal_rows(cuts.covers)
    return Cuts(cuts.segments[keep], cuts.covers[keep])


def _through_two(points: Array, edges: Array, length: float, most: int, done: NDArray[np.bool_]) -> Cuts | None:
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
        beside = words(done[done[:, near].any(axis=1)][:, near])
        within = _within_reach(starts[block], directions[block], reach[block], edges[near], length)
        lines = block[~contained(words(within), beside).any(axis=1)]
        met = meetings(starts[lines], directions[lines], edges[near])
        line, begin, sets = _slid(*met, reach[lines], length)
        new = ~_lesser(words(sets), beside)
        line, begin = lines[line[new]], begin[new]
        segments.append(starts[line, None] + (begin[:, None] + np.array([0.0, length]))[..., None] * directions[line, None])
        covers.append(np.zeros((len(line), len(edges)), dtype=bool))
        covers[-1][:, near] = sets[new]
        if sum(len(cuts) for cuts in segments) > most:
            return None
    return Cuts(np.concatenate(segments), np.concatenate(covers))


def _within_reach(starts: Array, directions: Array, reach: Array, edges: Array, length: float) -> NDArray[np.bool_]:
    """Edges (K, E) that segments on the lines from `starts` (K, 2) along `directions` may meet, if they span 0 to `reach` (K,).

    A quick look, that may count an edge too many, but none too few.
    """
    du, dv = directions.T
    u, v = starts.T
    one = np.ones(2 * len(edges))
    eu, ev = edges.transpose(2, 1, 0).reshape(2, -1)
    aside = np.column_stack([du, dv, dv * u - du * v]) @ np.stack([ev, -eu, one])
    ahead = np.column_stack([du, dv, -du * u - dv * v]) @ np.stack([eu, ev, one])
    (s0, s1), (r0, r1) = np.hsplit(aside, 2), np.hsplit(ahead, 2)
    before, after = np.minimum(r0, r1) <= length + ROUGH, np.maximum(r0, r1) >= (reach - length - ROUGH)[:, None]
    return np.asarray((s0 * s1 <= ROUGH) & before & after)


def _slid(low: Array, high: Array, reach: Array, length: float) -> tuple[NDArray[np.int64], Array, NDArray[np.bool_]]:
    """Line and begin of each segment that spans 0 to `reach` (K,) on lines that meet edges from `low` to `high` (K, E); and its set.

    Each begins where it touches one edge last, unless a segment that begins before it on its line reaches as many edges ahead.
    """
    begins = np.where(low <= TOUCH, np.minimum(high, 0.0), -np.inf)
    line, edge = np.nonzero(begins >= (reach - length - TOUCH)[:, None])
    begin = begins[line, edge]
    order = np.lexsort([begin, line])
    line, begin = line[order], begin[order]
    ahead = low[line] <= begin[:, None] + (length + TOUCH)
    reached = ahead.sum(axis=1)
    first = np.diff(line, prepend=-1) > 0
    keep = np.flatnonzero(first | (np.diff(reached, prepend=0) > 0))
    covers = ahead[keep] & (high[line[keep]] >= begin[keep, None] - TOUCH)
    keep, covers = keep[(kept := distinct(covers)[0])], covers[kept]
    return line[keep], begin[keep], covers


def _shortest_through_one(
    points: Array, edges: Array, touching: NDArray[np.bool_], length: float, most: int, done: NDArray[np.bool_]
) -> Cuts | None:
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
    e, f = np.nonzero(np.triu((_edge_distances(away[: 2 * len(edges)], touching) <= length) & (widest > length), 1))
    rows, at = np.nonzero((away[:, e] + away[:, f] <= length).T & (np.minimum(away[:, e], away[:, f]) > TOUCH).T)
    if len(at) > most:
        return None
    between = _shortest_between(points, at, edges, e[rows], f[rows], length)

    at, toward, behind, ahead = (np.concatenate(pair) for pair in zip(square, between, strict=True))
    begin = -behind - (length - behind - ahead) / 2
    segments = points[at, None] + (begin[:, None] + np.array([0.0, length]))[..., None] * toward[:, None]
    low, high = meetings(points[at], toward, edges)
    covers = _within(low, high, begin, length)
    new = ~_lesser(words(covers), words(done))
    return Cuts(segments[new], covers[new])


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
    theta = (low + high) / 2
    for _ in range(NEWTON_STEPS):
        # The way is a convex function of the angle: where Newton's step leaves the bracket, halve that.
        behind, ahead = ways(theta, k)
        tan_e, tan_f = np.tan(theta - foot_e[k]), np.tan(theta - foot_f[k])
        slope = behind * tan_e + ahead * tan_f
        low, high = np.where(slope > 0, low, theta), np.where(slope > 0, theta, high)
        theta = theta - slope / (behind * (1 + 2 * tan_e**2) + ahead * (1 + 2 * tan_f**2))
        theta = np.where((low <= theta) & (theta <= high), theta, (low + high) / 2)
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


def _edge_distances(away: Array, touching: NDArray[np.bool_]) -> Array:
    """Least distance (E, E) [px] between every two edges, of which the ends lie `away` (2E, E) from them."""
    ends = np.minimum(away[::2], away[1::2])
    return np.where(touching, 0.0, np.minimum(ends, ends.T))


def _crossings(edges: Array, touching: NDArray[np.bool_]) -> Array:
    """Points (X, 2) where two edges cross."""
    i, j = np.nonzero(np.triu(touching, 1))
    r, s = edges[i, 1] - edges[i, 0], edges[j, 1] - edges[j, 0]
    turn = cross(r, s)
    real = np.abs(turn) > 1e-9
    i, j, r, s, turn = i[real], j[real], r[real], s[real], turn[real]
    t = cross(edges[j, 0] - edges[i, 0], s) / turn
    return np.asarray(edges[i, 0] + t[:, None] * r)


def _lesser(sets: Words, done: Words) -> NDArray[np.bool_]:
    """Which of `sets` are part of one of `done`, but none of them."""
    return np.asarray((contained(sets, done) & ~contained(done, sets).T).any(axis=1))


def _greatest(covers: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Indices of the rows of `covers` (S, E) that are part of no other row; of equal rows the first."""
    first = distinct(covers)[0]
    first = first[np.argsort(-covers[first].sum(axis=1), kind="stable")]
    return first[uncontained(covers[first])]


def maximal_rows(covers: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Indices of the rows of `covers` (S, E) that are part of no greater row; of equal rows a few, spread over their order."""
    which = distinct(covers)[1]
    count = np.bincount(which)
    maximal = np.zeros(len(count), dtype=bool)
    maximal[which[_greatest(covers)]] = True
    order = np.argsort(which, kind="stable")
    rank = np.empty(len(which), dtype=np.int64)
    rank[order] = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    spread = -(-count // SPARES)
    return np.flatnonzero(maximal[which] & (rank % spread[which] == 0))
