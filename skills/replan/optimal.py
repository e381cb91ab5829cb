"""The fewest segments that sever given edges, with a proof that fewer cannot.

The proof needs only some of the edges: whoever cuts all edges cuts those, so the least number of segments for a few edges, over all
the segments there are (`maximal_cuts`), is a lower bound for all. Edges that a cheapest cover of the few leaves uncut join the few,
until the bound meets a cover of all. Among covers of that many segments, the tie-break then picks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array
from skills.replan.candidates import ReplanConfig
from skills.replan.cover import minimum_cover, telling_columns
from skills.replan.maximal import Cuts, maximal_cuts
from skills.replan.near_goal import goal_chords, tie_costs
from skills.replan.order import along_goal
from skills.replan.room import Room
from skills.replan.sets import distinct
from skills.scene.polyline import at_length
from skills.scene.segments import cross, distances, touch
from skills.tracking.tracks import TrackedGoal

Covers = NDArray[np.bool_]
STRETCH = 20.0  # [px] of the goal, from which the tightest edges are taken
ADDED = 16  # edges that join the few in a round
NEARLY = 8  # edges left, up to which a cover of all is looked for
PASSES = 2  # over the chosen segments, in which each is exchanged for a better one
TIE_GAP = 0.01  # of a segment's length cut outside the goal: less than a pixel
TIE_ROUNDS = 8  # in which edges left are looked at too


@dataclass(frozen=True)
class FewestCuts:
    """`segments` (S, 2, 2) pixels, and which edges each cuts, `covers` (S, E). Nobody can do with fewer segments than `bound`.

    `missing` counts edges that no segment in the room reaches; there are no segments then.
    """

    segments: Array
    covers: Covers
    bound: int
    missing: int = 0

    @property
    def proven(self) -> bool:
        """Whether fewer segments cannot do it."""
        return not self.missing and len(self.segments) <= self.bound


def fewest_cuts(edges: Array, tracked: TrackedGoal, config: ReplanConfig, room: Room) -> FewestCuts:
    """Sever `edges` (E, 2, 2) pixels, at least one, by as few segments in `room` as possible; the bound holds without the room too."""
    chords = room.pieces(goal_chords(edges, tracked.polyline, config.segment_length))
    covers = touch(chords, edges)
    missing = int((~covers.any(axis=0)).sum())
    if missing:
        return FewestCuts(chords[:0], covers[:0], 0, missing)
    place, _ = along_goal(edges.mean(axis=1), tracked.polyline)
    # What is found without a search will often do.
    chosen = min((_walk(covers, np.argsort(way, kind="stable")) for way in (place, -place)), key=len)
    best = FewestCuts(chords[chosen], covers[chosen], 1)
    pool, known = chords, covers
    telling = _telling(edges, place, tracked.polyline, config)
    few = telling[telling_columns(covers[:, telling])]
    for _ in range(config.max_rounds):
        answer = _cover_few(few, edges, room, config, Cuts(pool, known[:, few]))
        if answer is None:
            break
        pool, known = np.concatenate([answer.segments, chords]), np.concatenate([answer.covers, covers])
        left = np.flatnonzero(~known[answer.chosen].any(axis=0))
        best = _improved(best, pool, known, answer, len(left))
        left = np.setdiff1d(left, few)
        if best.proven or not len(left):
            break
        more = left[np.unique(np.linspace(0, len(left) - 1, ADDED).astype(np.int64))]
        few = np.unique(np.concatenate([few, more]))
    pool, known = np.concatenate([best.segments, pool]), np.concatenate([best.covers, known])
    chosen = _tie_broken(len(best.segments), known, tie_costs(pool, known, edges, tracked, config), few)
    return FewestCuts(pool[chosen], known[chosen], best.bound)


def _improved(best: FewestCuts, pool: Array, covers: Covers, answer: FewCovered, left: int) -> FewestCuts:
    """The `best` with a better bound, and fewer segments from the `pool` (S, 2, 2) if the `answer` or a short search finds them.

    The search is made when the answer leaves few edges, else it is seldom worth its time.
    """
    best = replace(best, bound=max(best.bound, answer.bound))
    if best.proven or left > NEARLY:
        return best
    chosen = answer.chosen
    if left:
        chosen = minimum_cover(covers, np.ones(len(covers)), 0).chosen
    return replace(best, segments=pool[chosen], covers=covers[chosen]) if len(chosen) < len(best.segments) else best


def _walk(covers: Covers, order: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows taken one after the other: of those that reach the first column (E,) in `order` that is left, the one that takes most."""
    left = np.ones(len(order), dtype=bool)
    chosen: list[int] = []
    for k in order:
        if left[k]:
            able = np.flatnonzero(covers[:, k])
            chosen.append(int(able[np.argmax((covers[able] & left).sum(axis=1))]))
            left &= ~covers[chosen[-1]]
    return np.array(chosen)


# ------------------------------------------------------------ the proof


def _telling(edges: Array, place: Array, polyline: Array, config: ReplanConfig) -> NDArray[np.int64]:
    """Edges, at `place` (E,) along the goal, that are likely to prove how many segments are needed.

    Going along the goal from either end, edges no two of which one segment can cut. And in each stretch of the goal the edges that
    leave a segment along it least room: the one that ends lowest and the one that ends highest.
    """
    taken: list[int] = []
    ends = edges.reshape(-1, 2)
    for way in (place, -place):
        free = np.ones(len(edges), dtype=bool)
        for k in np.argsort(way, kind="stable"):
            if free[k]:
                taken.append(int(k))
                one = edges[k : k + 1]
                away = np.minimum(distances(one[0], edges).min(axis=0), distances(ends, one).reshape(-1, 2).min(axis=1))
                free &= (away > config.segment_length) & ~touch(one, edges)[0]
    at, direction = along_goal(ends, polyline)
    aside = cross(direction, ends - at_length(polyline, at)).reshape(-1, 2)
    stretch = np.floor(place / STRETCH)
    for limit in (aside.max(axis=1), -aside.min(axis=1)):
        order = np.lexsort([limit, stretch])
        taken += order[np.unique(stretch[order], return_index=True)[1]].tolist()
    return np.unique(taken)


@dataclass(frozen=True)
class FewCovered:
    """Nobody covers the few edges by fewer than `bound` segments.

    `segments` (S, 2, 2) are those in the room that were chosen from, with all edges that they cut, `covers` (S, E). The `chosen` of
    them cut the few edges too, unless some that were chosen lie outside the room.
    """

    bound: int
    segments: Array
    covers: Covers
    chosen: NDArray[np.int64]


def _cover_few(few: NDArray[np.int64], edges: Array, room: Room, config: ReplanConfig, known: Cuts) -> FewCovered | None:
    """Cover the `few` of `edges` (E, 2, 2) by the least number of segments, `known` ones or any; None if there are too many."""
    cuts = maximal_cuts(edges[few], config.segment_length, config.max_candidates, known)
    if cuts is None:
        return None
    free = room.whole(cuts.segments)
    full = touch(cuts.segments, edges) & free[:, None]
    # Of segments for one set of the few, and of sets that do equally well, the one that cuts most else.
    order = np.argsort(-full.sum(axis=1), kind="stable")
    order = order[np.sort(distinct(cuts.covers[order])[0])]
    cover = minimum_cover(cuts.covers[order], np.ones(len(order)), config.max_nodes)
    chosen = _widened(order[cover.chosen], cuts.covers, full)
    pieces = room.pieces(cuts.segments[~free])
    return FewCovered(
        bound=int(np.ceil(cover.bound - 1e-6)),
        segments=np.concatenate([cuts.segments[free], pieces]),
        covers=np.concatenate([full[free], touch(pieces, edges)]),
        chosen=(np.cumsum(free) - 1)[chosen[free[chosen]]],
    )


def _widened(chosen: NDArray[np.int64], few: Covers, full: Covers) -> NDArray[np.int64]:
    """Exchange each of the `chosen` rows for one that cuts most of all edges (S, E) that the others leave, with all of the `few` (S, F)."""
    chosen = chosen.copy()
    for k in np.tile(np.arange(len(chosen)), PASSES):
        others = np.delete(chosen, k)
        able = np.flatnonzero(few[:, ~few[others].any(axis=0)].all(axis=1))
        more = full[np.ix_(able, ~full[others].any(axis=0))].sum(axis=1)
        chosen[k] = able[np.argmax(more)]
    return chosen


# ------------------------------------------------------------ the tie-break


def _tie_broken(count: int, covers: Covers, ties: Array, few: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows of `covers` (S, E) that reach every edge: as few as the first `count`, which do, at the least sum of `ties` (S,) 0..1.

    Only the `few` columns are looked at first, then those that are left. What branching does not settle soon is taken as it is.
    """
    # All the ties of a cover together weigh less than one segment.
    weight = 1.0 / (count + 1)
    chosen = np.arange(count)
    for _ in range(TIE_ROUNDS):
        cover = minimum_cover(covers[:, few], 1.0 + weight * ties, 0, TIE_GAP * weight)
        left = np.flatnonzero(~covers[cover.chosen].any(axis=0))
        if len(cover.chosen) > count:
            break
        if not len(left):
            chosen = cover.chosen
            break
        few = np.concatenate([few, left])
    return _exchanged(chosen, covers, ties)


def _exchanged(chosen: NDArray[np.int64], covers: Covers, ties: Array) -> NDArray[np.int64]:
    """Exchange each of the `chosen` rows for one that does as well with the least tie, until none is better."""
    chosen = chosen.copy()
    while True:
        before = chosen.copy()
        for k in range(len(chosen)):
            alone = covers[chosen[k]] & ~covers[np.delete(chosen, k)].any(axis=0)
            able = np.flatnonzero(covers[:, alone].all(axis=1))
            best = able[np.argmin(ties[able])]
            if ties[best] < ties[chosen[k]] - 1e-9:
                chosen[k] = best
        if (chosen == before).all():
            return chosen
