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

    def __post_init__(self) -> None:
        if not self.tau > 1:
            raise ValueError(f"tau must be above 1, not {self.tau}")


def estimate_connectivity(
    grid: Grid,
    reference: Array,
    tracks: Tracks,
    config: ElongationConfig | None = None,
) -> ConnectivityGraph:
    """Judge each edge by rho = |k_i(te) - k_j(te)| / |k_i(td) - k_j(td)|; severed if rho >= tau.

    Args:
        grid: the grid made at t_d.
        reference: (N, 2) pixels of the keypoints at t_d.
        tracks: the same keypoints at t_e. Hidden, lost or doubtful ends make an edge unknown, never severed.
        config: threshold and what counts.
    """
    config = config or ElongationConfig()
    rho, known = lengthening(grid, reference, tracks.points, trusted(tracks, config.min_confidence))
    ratio = np.where(known, rho, config.tau)
    severed = known & (ratio >= config.tau)
    # Smooth and monotone in rho, one half at tau and for what is unknown.
    logit = config.steepness * np.log(np.maximum(ratio, 1e-6) / config.tau)
    probability = 1.0 / (1.0 + np.exp(-np.clip(logit, -50.0, 50.0)))
    state = np.where(severed, EdgeState.SEVERED, np.where(known, EdgeState.CONNECTED, EdgeState.UNKNOWN)).astype(np.int64)
    code, message = verdict(state[grid.crosses_goal], config.max_unknown)
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


def trusted(tracks: Tracks, min_confidence: float) -> NDArray[np.bool_]:
    """Which keypoints (N,) are seen, with confidence."""
    return np.asarray(tracks.visible & (tracks.confidence >= min_confidence))


def lengthening(grid: Grid, reference: Array, points: Array, known: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
    """The ratio rho (E,) of each edge since t_d, nan where it is not known, and where (E,) it is: the places of both ends are `known`.

    `reference` (N, 2) are the keypoints at t_d and `points` (N, 2) the same now [px].
    """
    before, after = lengths(reference, grid.edges), lengths(points, grid.edges)
    # A cut that is open already at t_d has been stretched before the reference was taken: its edges count from the closed cut.
    before = np.where(grid.crosses_goal, np.minimum(before, grid.closed_length), before)
    measured = known[grid.edges].all(axis=1) & (before > 1e-6) & np.isfinite(after)
    return np.where(measured, after / np.where(measured, before, 1.0), np.nan), measured


def verdict(crossing: NDArray[np.int64], max_unknown: float) -> tuple[Code, str]:
    """Code and sentence for the states of the edges that cross the goal."""
    total = len(crossing)
    connected, unknown = int((crossing == EdgeState.CONNECTED).sum()), int((crossing == EdgeState.UNKNOWN).sum())
    if not total:
        return Code.TOO_MANY_UNKNOWN, "No edge of the grid crosses the goal, so nothing can be said about it."
    if unknown > max_unknown * total:
        return (
            Code.TOO_MANY_UNKNOWN,
            f"{unknown} of {total} edges across the goal could not be seen well enough; "
            f"at most {max_unknown:.0%} may be unknown.",
        )
    if not connected and not unknown:
        return Code.OK, f"All {total} edges across the goal are severed."
    rest = f", {unknown} unknown" if unknown else ""
    return Code.OK, f"{connected} of {total} edges across the goal are still connected{rest}."
