"""Greedy set cover over sampled candidates (paper, Algorithm 1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array
from skills.replan.candidates import Candidates, ReplanConfig, candidates_around
from skills.tracking.tracks import TrackedGoal


@dataclass(frozen=True)
class GreedyCuts:
    """`segments` (S, 2, 2) pixels of full length, in the order chosen; `first[i]` the edges that segment i is first to cut.

    `missing` counts edges that no candidate reaches; there are no segments then. `near_grasp`: not all keep clear of the grasp.
    """

    segments: Array
    first: tuple[NDArray[np.int64], ...]
    missing: int
    near_grasp: bool


def greedy_cuts(
    edges: Array,
    tracked: TrackedGoal,
    config: ReplanConfig,
    rng: np.random.Generator,
    outline: NDArray[np.bool_] | None,
    barred: Array,
) -> GreedyCuts:
    """Cover `edges` (E, 2, 2) pixels by candidates sampled around them, clear of the grasp if that reaches every edge.

    None meets a `barred` edge (B, 2, 2).
    """
    candidates, covers = candidates_around(edges, tracked, config, rng, outline, barred)
    missing = int((~covers.any(axis=0)).sum())
    if missing:
        return GreedyCuts(np.zeros((0, 2, 2)), (), missing, False)
    clear = candidates.clear_of_grasp
    near_grasp = not covers[clear].any(axis=0).all()
    allowed = np.ones_like(clear) if near_grasp else clear
    chosen = greedy_cover(covers[allowed], _only(candidates, allowed))
    segments = candidates.segments[allowed][[k for k, _ in chosen]]
    return GreedyCuts(segments, tuple(first for _, first in chosen), 0, near_grasp)


def greedy_cover(covers: NDArray[np.bool_], candidates: Candidates) -> list[tuple[int, NDArray[np.int64]]]:
    """Choose candidates until every column of `covers` (S, E) that any of them covers is covered (Algorithm 1).

    Each choice is a candidate's index and the edges that it is first to cover. The most newly covered edges win; then the
    smaller angle to the goal; then the nearer to the goal; then the lower index.
    """
    left: NDArray[np.bool_] = np.array(covers.any(axis=0))
    chosen: list[tuple[int, NDArray[np.int64]]] = []
    # Ranked once; the first best of equals is then the tie-break's choice.
    rank = np.lexsort([np.round(candidates.distance, 6), np.round(candidates.angle, 6)])
    by_edge = np.ascontiguousarray(covers.T)
    gain = by_edge.sum(axis=0)
    while left.any():
        best = int(rank[np.argmax(gain[rank])])
        first = np.flatnonzero(covers[best] & left)
        chosen.append((best, first))
        left[first] = False
        gain -= by_edge[first].sum(axis=0)
    return chosen


def _only(candidates: Candidates, keep: NDArray[np.bool_]) -> Candidates:
    return Candidates(
        candidates.segments[keep], candidates.angle[keep], candidates.distance[keep], candidates.clear_of_grasp[keep]
    )
