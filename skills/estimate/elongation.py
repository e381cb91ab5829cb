"""Which edges of the keypoint grid are severed, from how much longer they became (paper, Sec. Tissue Connectivity Estimation)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.codes import Code
from hardware.interface import Array
from skills.estimate.graph import ConnectivityGraph, EdgeState
from skills.estimate.grid import Grid, lengths
from skills.tracking.tracks import Tracks


@dataclass(frozen=True)
class ElongationConfig:
    """The rule's threshold, and when a measurement counts."""

    tau: float = 2.0  # ratio rho from which an edge is severed; counted from the closed cut, strands reach 1.5 soon
    min_confidence: float = 0.2  # of both ends' tracks
    max_unknown: float = 0.25  # share of the edges across the goal
    steepness: float = 8.0  # of the probability around tau, per unit of log rho
    min_gap: float = 1.0  # [px] of an opening seen along a severed edge, where that was looked at
    # Ratio that an edge with a gap must have reached as well, since what is left of a half cut lets its lips part too; the same in the
    # end zones of the goal, where even a complete cut opens little (below 1 a dark line is a fold); and their length, a share of the goal.
    min_lengthening: float = 2.0
    end_lengthening: float = 0.9
    end_zone: float = 0.1

    def __post_init__(self) -> None:
        if not self.tau > 1:
            raise ValueError(f"tau must be above 1, not {self.tau}")


def estimate_connectivity(
    grid: Grid,
    reference: Array,
    tracks: Tracks,
    config: ElongationConfig | None = None,
    gap: Array | None = None,
) -> ConnectivityGraph:
    """Judge each edge by rho = |k_i(te) - k_j(te)| / |k_i(td) - k_j(td)|; severed if rho >= tau.

    Args:
        grid: the grid made at t_d.
        reference: (N, 2) pixels of the keypoints at t_d.
        tracks: the same keypoints at t_e. Hidden, lost or doubtful ends make an edge unknown, never severed.
        config: threshold and what counts.
        gap: (E,) width [px] of the opening seen along each edge (`GapWatch`), or None. With it, an edge across the goal is severed
            if and only if an opening was seen along it: what became long but shows tissue all along is a stretched attachment, and a
            slit at the goal's end, where even a complete cut opens little, is severed below tau.
    """
    config = config or ElongationConfig()
    before, after = lengths(reference, grid.edges), lengths(tracks.points, grid.edges)
    # A cut that is open already at t_d has been stretched before the reference was taken: its edges count from the closed cut.
    before = np.where(grid.crosses_goal, np.minimum(before, grid.closed_length), before)
    trusted = tracks.visible & (tracks.confidence >= config.min_confidence) & np.isfinite(tracks.points).all(axis=1)
    known = trusted[grid.edges].all(axis=1) & (before > 1e-6) & np.isfinite(after)
    rho = np.where(known, after / np.where(known, before, 1.0), np.nan)
    ratio = np.where(known, rho, config.tau)
    severed = known & (ratio >= config.tau)
    # Smooth and monotone in rho, one half at tau and for what is unknown.
    logit = config.steepness * np.log(np.maximum(ratio, 1e-6) / config.tau)
    if gap is not None:
        # What was seen to part does not heal, so its ends may be hidden by now.
        seen_parted = grid.crosses_goal & (np.nan_to_num(gap) >= config.min_gap)
        inner = np.abs(np.nan_to_num(grid.station, nan=0.5) - 0.5) <= 0.5 - config.end_zone
        needed = np.where(inner, config.min_lengthening, config.end_lengthening)
        reached = np.where(known, ratio, 1.0 + np.nan_to_num(gap) / grid.closed_length)
        parted = seen_parted & (reached >= needed)
        looked = grid.crosses_goal & ((known & np.isfinite(gap)) | parted)
        severed = np.where(grid.crosses_goal, parted, severed)
        known = np.where(grid.crosses_goal, looked, known)
        # One e-fold for each half pixel beyond the least gap; what is too short to have parted is connected all the same.
        seen = 2.0 * (np.nan_to_num(gap) - config.min_gap)
        logit = np.where(looked, np.where(parted, np.abs(seen), -np.abs(seen)), logit)
    probability = 1.0 / (1.0 + np.exp(-np.clip(logit, -50.0, 50.0)))
    state = np.where(severed, EdgeState.SEVERED, np.where(known, EdgeState.CONNECTED, EdgeState.UNKNOWN)).astype(np.int64)
    code, message = _verdict(state[grid.crosses_goal], config)
    return ConnectivityGraph(
        code=code,
        message=message,
        reference=np.array(reference),
        points=tracks.points.copy(),
        edges=grid.edges,
        elongation=rho,
        state=state,
        probability=np.where(known, probability, 0.5),
        crosses_goal=grid.crosses_goal,
        station=grid.station,
    )


def attachments(graph: ConnectivityGraph) -> list[tuple[float, float]]:
    """Stretches (start, end) of the goal, 0..1, over which tissue still bridges it: runs of connected edges that cross the goal.

    Each reaches half an edge's spacing to either side. An unknown edge between connected ones belongs to their run; unknown edges
    alone are no attachment, though they keep the goal from being complete.
    """
    crossing = np.flatnonzero(graph.crosses_goal)
    if not len(crossing):
        return []
    order = crossing[np.argsort(graph.station[crossing], kind="stable")]
    station, state = graph.station[order], graph.state[order]
    half = float(np.median(np.diff(station))) / 2 if len(station) > 1 else 0.0
    severed = state == EdgeState.SEVERED
    run_of = np.cumsum(severed)
    runs = []
    for run in np.unique(run_of[~severed]):
        connected = station[(run_of == run) & (state == EdgeState.CONNECTED)]
        if len(connected):
            runs.append((float(max(connected[0] - half, 0.0)), float(min(connected[-1] + half, 1.0))))
    return runs


def _verdict(crossing: NDArray[np.int64], config: ElongationConfig) -> tuple[Code, str]:
    """Code and sentence for the states of the edges that cross the goal."""
    total = len(crossing)
    connected, unknown = int((crossing == EdgeState.CONNECTED).sum()), int((crossing == EdgeState.UNKNOWN).sum())
    if not total:
        return Code.TOO_MANY_UNKNOWN, "No edge of the grid crosses the goal, so nothing can be said about it."
    if unknown > config.max_unknown * total:
        return (
            Code.TOO_MANY_UNKNOWN,
            f"{unknown} of {total} edges across the goal could not be seen well enough; "
            f"at most {config.max_unknown:.0%} may be unknown.",
        )
    if not connected and not unknown:
        return Code.OK, f"All {total} edges across the goal are severed."
    rest = f", {unknown} unknown" if unknown else ""
    return Code.OK, f"{connected} of {total} edges across the goal are still connected{rest}."
