"""The fewest segments that sever given edges, with a proof that fewer cannot.

The proof needs only some of the edges: whoever cuts all edges cuts those, so the least number of segments for a few edges, over all
the segments there are (`maximal_cuts`), is a lower bound for all. Edges that a cheapest cover of the few leaves uncut join the few,
until the bound meets a cover of all. Among covers of that many segments, the tie-break then picks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array
from skills.replan.candidates import ReplanConfig
from skills.replan.cover import minimum_cover, telling_columns
from skills.replan.maximal import Cuts, maximal_cuts, maximal_rows
from skills.replan.near_goal import goal_chords, tie_costs
from skills.replan.order import along_goal
from skills.replan.room import Room
from skills.replan.sets import distinct
from skills.scene.polyline import at_length
from skills.scene.segments import cross, distances, touch
from skills.tracking.tracks import TrackedGoal

Covers = NDArray[np.bool_]
STRETCH = 20.0  # [px] of the goal, from which the tightest edges are taken
ADDED = 24  # edges that join the few in a round
TIE_STEP = 0.01  # of a segment's length cut outside the goal: less than a pixel
PASSES = 2  # over the chosen segments, in which each is exchanged for a better one


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
    pool = _cutting(room.pieces(goal_chords(edges, tracked.polyline, config.segment_length)), edges)
    missing = int((~pool.covers.any(axis=0)).sum())
    if missing:
        return FewestCuts(pool.segments[:0], pool.covers[:0], 0, missing)
    pool, ties = _nearest_of_each(pool, tie_costs(pool.segments, pool.covers, edges, tracked, config))
    # What is found without a search will often do.
    chosen, bound = _fewest(pool), 1
    place, _ = along_goal(edges.mean(axis=1), tracked.polyline)
    telling = _telling(edges, place, tracked.polyline, config)
    few = telling[telling_columns(pool.covers[:, telling])]
    for _ in range(config.max_rounds):
        answer = _cover_few(few, edges, room, config, pool)
        if answer is None:
            break
        pool, bound = _joined(pool, answer.new), max(bound, answer.bound)
        chosen = min(chosen, _fewest(pool), key=len) if len(chosen) > bound else chosen
        left = np.setdiff1d(np.flatnonzero(~answer.covered), few)
        if len(chosen) <= bound or not len(left):
            break
        few = np.union1d(few, left[np.unique(np.linspace(0, len(left) - 1, ADDED).astype(np.int64))])
    segments, covers = pool.segments[len(ties) :], pool.covers[len(ties) :]
    ties = np.concatenate([ties, tie_costs(segments, covers, edges, tracked, config)])
    chosen = _tie_broken(chosen, pool.covers, ties)
    return FewestCuts(pool.segments[chosen], pool.covers[chosen], bound)


def _cutting(segments: Array, edges: Array) -> Cuts:
    return Cuts(segments, touch(segments, edges))


def _joined(one: Cuts, other: Cuts) -> Cuts:
    return Cuts(np.concatenate([one.segments, other.segments]), np.concatenate([one.covers, other.covers]))


def _nearest_of_each(cuts: Cuts, ties: Array) -> tuple[Cuts, Array]:
    """Of `cuts` that cut the same, only the one with the least of `ties` (S,); and the ties of those."""
    order = np.argsort(ties, kind="stable")
    kept = order[distinct(cuts.covers[order])[0]]
    return Cuts(cuts.segments[kept], cuts.covers[kept]), ties[kept]


def _fewest(pool: Cuts) -> NDArray[np.int64]:
    """Rows of the `pool` that cut every edge, as few as there are."""
    return minimum_cover(pool.covers, np.ones(len(pool.covers)), 0).chosen


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
                away = np.minimum(
                    distances(edges[k], edges).min(axis=0), distances(ends, edges[k : k + 1]).reshape(-1, 2).min(axis=1)
                )
                # An end of an edge that crosses another is no farther from it than half its length.
                free &= away > max(config.segment_length, float(np.linalg.norm(edges[k, 1] - edges[k, 0])) / 2)
    at, direction = along_goal(ends, polyline)
    aside = cross(direction, ends - at_length(polyline, at)).reshape(-1, 2)
    stretch = np.floor(place / STRETCH)
    for limit in (aside.max(axis=1), -aside.min(axis=1)):
        order = np.lexsort([limit, stretch])
        taken += order[np.unique(stretch[order], return_index=True)[1]].tolist()
    return np.unique(taken)


@dataclass(frozen=True)
class FewCovered:
    """Nobody covers the few edges by fewer than `bound` segments. So many did; those in the room cut the edges `covered` (E,).

    `new` are the segments in the room that were found for it, with all edges that they cut.
    """

    bound: int
    new: Cuts
    covered: NDArray[np.bool_]


def _cover_few(few: NDArray[np.int64], edges: Array, room: Room, config: ReplanConfig, pool: Cuts) -> FewCovered | None:
    """Cover the `few` of `edges` (E, 2, 2) by the least number of segments, of the `pool` or any; None if there are too many."""
    cuts = maximal_cuts(edges[few], config.segment_length, config.max_candidates, pool.covers[:, few])
    if cuts is None:
        return None
    free = room.whole(cuts.segments)
    touched = touch(cuts.segments, edges)
    sets = np.concatenate([cuts.covers, pool.covers[:, few]])
    rows = maximal_rows(sets)
    sets, full = sets[rows], np.concatenate([touched & free[:, None], pool.covers])[rows]
    # Of segments for one set of the few, and of sets that do equally well, the one that cuts most else.
    order = np.argsort(-full.sum(axis=1), kind="stable")
    order = order[np.sort(distinct(sets[order])[0])]
    cover = minimum_cover(sets[order], np.ones(len(order)), config.max_nodes)
    chosen = _widened(order[cover.chosen], sets, full)
    new = _joined(Cuts(cuts.segments[free], touched[free]), _cutting(room.pieces(cuts.segments[~free]), edges))
    return FewCovered(int(np.ceil(cover.bound - 1e-6)), new, np.asarray(full[chosen].any(axis=0)))


def _widened(chosen: NDArray[np.int64], few: Covers, full: Covers) -> NDArray[np.int64]:
    """Exchange each of the `chosen` rows for one that cuts most of all edges (S, E) that the others leave, with all of the `few` (S, F)."""
    chosen = chosen.copy()
    often, cut = few[chosen].sum(axis=0), full[chosen].sum(axis=0)
    for k in np.tile(np.arange(len(chosen)), PASSES):
        old = chosen[k]
        able = np.flatnonzero(few[:, often == few[old]].all(axis=1))
        chosen[k] = able[np.argmax(full[np.ix_(able, cut == full[old])].sum(axis=1))]
        often += few[chosen[k]].astype(np.int64) - few[old]
        cut += full[chosen[k]].astype(np.int64) - full[old]
    return chosen


# ------------------------------------------------------------ the tie-break


def _tie_broken(chosen: NDArray[np.int64], covers: Covers, ties: Array) -> NDArray[np.int64]:
    """As few rows of `covers` (S, E) as the `chosen` ones, which reach every edge, that do so at the least sum of `ties` (S,) 0..1."""
    # All the ties of a cover together weigh less than one segment. In steps, more of them are equal and fewer rows matter.
    steps = np.round(ties / TIE_STEP) * TIE_STEP
    cover = minimum_cover(covers, 1.0 + steps / (len(chosen) + 1), 0)
    return _exchanged(cover.chosen if len(cover.chosen) <= len(chosen) else chosen, covers, ties)


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
