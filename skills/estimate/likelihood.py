"""How likely each edge is severed, from everything seen while the tissue was pulled, against what the tissue model expected of it.

A fixed threshold on length calls a stretched attachment severed, and a severed edge that opened little connected. Here three things are
weighed. What opened along the edge: an attachment opens nothing, a half cut only a groove, which what is left of the tissue holds narrower
than the cut that the model expected, and the bed shows through a full cut alone. Its length after every step of the pull, against the
length that the model expected of a severed edge and of a strand left alone in its place. And whether the two agree: what became long
without opening has been mistracked.

The weights are those of a logistic regression on the stub bench, so the probabilities are calibrated there (docs/experiments.md says on
which seeds). An edge whose ends are hidden for long is unknown, unless it was seen to part before: what has parted does not heal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array
from skills.estimate.elongation import lengthening, trusted, verdict
from skills.estimate.graph import ConnectivityGraph, EdgeState
from skills.estimate.grid import Grid, lengths
from skills.estimate.look import Look
from skills.expose.outcome import Forecast


@dataclass(frozen=True)
class Weights:
    """Of the evidence, in nats; what is not known adds nothing."""

    bias: float = 0.6
    parted: float = 1.3  # of an opening of `wide` pixels or more, in proportion below; less where a cut would have opened more.
    # What was open at t_d already counts as much, but neither as wider than expected nor for good: it may be an old groove
    excess: float = 2.4  # of an opening that is wider than a cut's, where no bed is seen: what holds together opens less
    bed: float = 3.2  # of the bed seen through it, `wide` pixels or more, in proportion below
    shorter: float = 0.75  # per nat of the lengths' log-likelihood ratio where it speaks for connected, and no bed is seen
    longer: float = 0.8  # and where it speaks for severed, if an opening is seen;
    longer_whole: float = 0.45  # if none is, a keypoint has rather been mistracked
    elsewhere: float = -6.0  # edges that do not cross the goal are seldom cut


@dataclass(frozen=True)
class LikelihoodConfig:
    """When an edge is called severed or connected, and how well lengths are measured and expected."""

    weights: Weights = Weights()
    severed: float = 0.95  # probability from which an edge is called severed
    connected: float = 0.35  # up to which it is called connected; between the two it is unknown
    min_confidence: float = 0.2  # of both ends' tracks
    max_unknown: float = 0.5  # share of the edges across the goal
    pixel_error: float = 1.5  # [px], standard deviation of a tracked edge's length
    model_error: float = 0.3  # of an expected lengthening, relative
    steepness: float = 5.0  # nats per log of the elongation, where nothing was expected of the length,
    even: float = 2.0  # and the elongation that speaks for neither there
    most: float = 3.0  # nats that lengths may speak for either; beyond it the model, not the tissue, is wrong
    wide: float = 2.0  # [px] of an opening that is no noise
    slight: float = 1.0  # [px] of an opening, seen or expected, that is compared with none narrower
    lately: float = 0.3  # share of the looks, the last ones: an edge whose ends were not seen together since is unknown,
    often: float = 0.6  # and so is one that was seen in fewer looks than this share;
    beside: float = 0.4  # share of the looks, whichever, that is enough beside the goal, where a pull cuts nothing
    healed: float = 2.0  # [px] of bed, or of an opening wide enough by itself, after which an edge that is hidden stays severed

    def __post_init__(self) -> None:
        if not 0 <= self.connected < 0.5 < self.severed <= 1:
            raise ValueError("an edge must be called connected below one half and severed above it")
        positive = (self.pixel_error, self.even, self.steepness, self.most, self.wide, self.slight, self.healed)
        if not (all(value > 0 for value in positive) and self.model_error >= 0):
            raise ValueError("errors, widths and what lengths may say must be positive")
        if not all(0 <= share <= 1 for share in (self.min_confidence, self.max_unknown, self.lately, self.often, self.beside)):
            raise ValueError("confidence and shares must lie between 0 and 1")
        if not (self.weights.parted >= 0 and 0 <= self.weights.excess <= self.weights.bed):
            raise ValueError("an opening may speak no more for connected than none, and none more for severed than the bed")


@dataclass(frozen=True)
class Evidence:
    """What was seen and expected of each edge, (E,) each; nan where it is not known.

    `parted` and `bed` [px] are the widest opening seen along it since t_d and the bed seen through it, `excess` how much wider it opened
    there than a severed edge would have by now, as a log ratio between -1 and 1 (0 where nothing opened or was expected); `slit` and
    `slit_excess` are the same of the widest opening since the goal was drawn; `length` the mean over the looks of the log-likelihood
    ratio of its length (above 0: severed), each weighing as many as its step, `ratio` the elongation when both ends were last seen,
    `seen` whether that was lately (across the goal), and often enough.
    """

    parted: Array
    bed: Array
    excess: Array
    slit: Array
    slit_excess: Array
    length: Array
    ratio: Array
    seen: NDArray[np.bool_]


def evidence(
    grid: Grid, reference: Array, looks: Sequence[Look], forecast: Forecast | None, config: LikelihoodConfig | None = None
) -> Evidence:
    """Gather the evidence from `looks`, in order, the last of which is now; see `estimate_connectivity`."""
    config = config or LikelihoodConfig()
    measured = [_measured(grid, reference, look, config) for look in looks]
    ratio, seen = _lately(measured, grid.crosses_goal, config)
    expected, length = np.full(len(grid.edges), np.nan), np.full(len(grid.edges), np.nan)
    if forecast is not None and len(forecast.gap):
        e = forecast.edges
        expected[e] = np.fmax.reduce(forecast.gap, axis=0)
        before = np.minimum(lengths(reference, grid.edges[e]), grid.closed_length)
        last = len(forecast.gap) - 1
        terms, steps = [], [look.step for look in looks if look.step >= 1]
        for look, (rho, _) in zip(looks, measured, strict=True):
            if look.step >= 1:
                row = min(look.step - 1, last)
                terms.append(_log_ratio(rho[e], before, forecast.severed[row], forecast.connected[row], config))
        length[e] = _mean(np.array(terms).reshape(-1, len(e)), np.array(steps, dtype=float))
    now = looks[-1]
    excess, slit_excess = (_excess(grid, opened, expected, config) for opened in (now.parted, now.slit))
    return Evidence(now.parted, now.bed, excess, now.slit, slit_excess, length, ratio, seen)


def log_odds(found: Evidence, crosses_goal: NDArray[np.bool_], config: LikelihoodConfig | None = None) -> Array:
    """Of each edge (E,) being severed."""
    config = config or LikelihoodConfig()
    w = config.weights
    parted, bed, slit = (np.clip(np.nan_to_num(width) / config.wide, 0.0, 1.0) for width in (found.parted, found.bed, found.slit))
    unexpected = config.steepness * np.log(np.maximum(np.nan_to_num(found.ratio, nan=config.even), 1e-3) / config.even)
    length = np.clip(np.where(np.isfinite(found.length), found.length, unexpected), -config.most, config.most)
    longer = np.where(2.0 * np.maximum(parted, slit) >= 1.0, w.longer, w.longer_whole)
    # Through what shows the bed it was cut, however wide; an opening far narrower than a cut's speaks as little as none.
    wider = np.maximum(found.excess, 0.0) * (1.0 - bed)
    since_t_d, since_drawn = (
        share * (1.0 + np.minimum(excess, 0.0) * (1.0 - bed))
        for share, excess in ((parted, found.excess), (slit, found.slit_excess))
    )
    opened = w.parted * np.maximum(since_t_d, since_drawn) + w.excess * parted * wider + w.bed * bed
    # A keypoint beside a wide opening may be mistracked; what shows the bed was severed, whatever its length seems to be.
    shorter = w.shorter * (1.0 - bed)
    odds = w.bias + opened + np.where(length < 0, shorter, longer) * length
    return np.asarray(odds + np.where(crosses_goal, 0.0, w.elsewhere))


def estimate_connectivity(
    grid: Grid, reference: Array, looks: Sequence[Look], forecast: Forecast | None, config: LikelihoodConfig | None = None
) -> ConnectivityGraph:
    """Judge each edge by the evidence of the whole pull.

    Args:
        grid: the grid made at t_d.
        reference: (N, 2) pixels of the keypoints at t_d.
        looks: what was seen on the way, in order; the last one is of t_e.
        forecast: what the tissue model expected after each step; without it openings and the elongation decide alone.
        config: weights and thresholds.
    """
    config = config or LikelihoodConfig()
    found = evidence(grid, reference, looks, forecast, config)
    known = found.seen | (np.nan_to_num(found.bed) >= config.healed)
    odds = np.clip(log_odds(found, grid.crosses_goal, config), -30.0, 30.0)
    # Beside a strand an opening says nothing: the edge may run in and out of it, and what lies next to it is held by it.
    odds = np.where(looks[-1].stranded, np.minimum(odds, config.weights.bias), odds)
    # What is hidden now is unknown, and nothing is done on it; what is believed of it is still told by what was seen before.
    probability = 1.0 / (1.0 + np.exp(-odds))
    severed = (probability >= config.severed) & (known | _parted_for_good(found, grid.crosses_goal, config))
    connected = (probability <= config.connected) & known
    state = np.where(severed, EdgeState.SEVERED, np.where(connected, EdgeState.CONNECTED, EdgeState.UNKNOWN)).astype(np.int64)
    code, message = verdict(state[grid.crosses_goal], config.max_unknown)
    return ConnectivityGraph(
        code=code,
        message=message,
        reference=np.array(reference),
        points=looks[-1].tracks.points.copy(),
        edges=grid.edges,
        elongation=found.ratio,
        state=state,
        probability=probability,
        crosses_goal=grid.crosses_goal,
        station=grid.station,
    )


def _parted_for_good(found: Evidence, crosses_goal: NDArray[np.bool_], config: LikelihoodConfig) -> NDArray[np.bool_]:
    """Which edges (E,) stay severed when they are hidden, though no bed was seen: by how wide they opened, which does not heal.

    A length seen before they were hidden, or a sliver of the bed, adds nothing.
    """
    nothing = np.zeros_like(found.bed)
    opening = replace(found, bed=nothing, slit=nothing, length=np.minimum(found.length, 0.0))
    enough = log_odds(opening, crosses_goal, config) >= np.log(config.severed / (1.0 - config.severed))
    return np.asarray((np.nan_to_num(found.parted) >= config.healed) & enough)


def _excess(grid: Grid, parted: Array, expected: Array, config: LikelihoodConfig) -> Array:
    """How much wider (E,) each edge across the goal opened than a severed one would have, as a log ratio between -1 and 1.

    The lesser of its own and of all that opened around it, its neighbours along the goal with it: one edge alone is measured badly, and
    a groove may begin beside tissue that gapes. `parted` and `expected` (E,) [px], nan where not known.
    """
    crossing = np.flatnonzero(grid.crosses_goal)
    order = crossing[np.argsort(grid.station[crossing], kind="stable")]
    opened = np.clip(np.nan_to_num(parted[order]) / config.wide, 0.0, 1.0)
    seen, due = (np.maximum(np.nan_to_num(width[order]), config.slight) for width in (parted, expected))
    around = _with_neighbours(opened * seen) / np.maximum(_with_neighbours(opened * due), 1e-9)
    compared = (opened > 0.0) & np.isfinite(expected[order])
    excess = np.zeros(len(parted))
    excess[order] = np.clip(np.log(np.where(compared, np.minimum(seen / due, around), 1.0)), -1.0, 1.0)
    return excess


def _with_neighbours(values: Array) -> Array:
    """Sums (C,) of each of the `values` (C,) and those next to it."""
    padded = np.pad(values, 1)
    return np.asarray(padded[:-2] + padded[1:-1] + padded[2:])


def _measured(grid: Grid, reference: Array, look: Look, config: LikelihoodConfig) -> tuple[Array, NDArray[np.bool_]]:
    """The elongation (E,) of each edge at one look, nan where it is not known, and where (E,) it is.

    Across the goal both ends must be seen. An edge beside it lies on one side, whose tissue takes along what is not recognised; there
    it is enough that both ends have a place and that the line between them was looked along for an opening.
    """
    seen, placed = (
        lengthening(grid, reference, look.tracks.points, known)
        for known in (trusted(look.tracks, config.min_confidence), look.placed)
    )
    across = grid.crosses_goal
    return np.where(across, seen[0], placed[0]), np.where(across, seen[1], placed[1] & np.isfinite(look.parted))


def _lately(
    measured: Sequence[tuple[Array, NDArray[np.bool_]]], across: NDArray[np.bool_], config: LikelihoodConfig
) -> tuple[Array, NDArray[np.bool_]]:
    """The newest known elongation (E,) of each edge, and which edges (E,) are seen now, or were until lately and in most looks.

    A highlight that passes over a keypoint at the last moment takes nothing back of what was seen of it before. Those that are not
    `across` (E,) the goal may be hidden for longer: a tool that comes before them later severs nothing.
    """
    seen = np.array([known for _, known in measured])
    newest = len(seen) - 1 - np.argmax(seen[::-1], axis=0)
    ratio = np.array([rho for rho, _ in measured])[newest, np.arange(seen.shape[1])]
    recent = len(seen) - 1 - newest <= config.lately * len(seen)
    share = seen.mean(axis=0)
    lately = np.asarray(
        seen[-1] | (seen.any(axis=0) & np.where(across, recent & (share >= config.often), share >= config.beside))
    )
    return np.where(lately, ratio, np.nan), lately


def _log_ratio(rho: Array, before: Array, severed: Array, connected: Array, config: LikelihoodConfig) -> Array:
    """Log p(length | severed) - log p(length | connected), (C,), normal; all lengths are given as multiples of `before` (C,) [px]."""
    now, if_severed, if_connected = rho * before, severed * before, connected * before
    variance = config.pixel_error**2 + config.model_error**2 * ((if_severed - before) ** 2 + (if_connected - before) ** 2)
    return np.asarray(np.clip(((now - if_connected) ** 2 - (now - if_severed) ** 2) / (2.0 * variance), -10.0, 10.0))


def _mean(rows: Array, weights: Array) -> Array:
    """Mean over the rows (R, C), of `weights` (R,), of what is known; nan where nothing is."""
    known = np.isfinite(rows)
    weight = (known * weights[:, None]).sum(axis=0)
    total = (np.where(known, rows, 0.0) * weights[:, None]).sum(axis=0)
    return np.where(weight > 0, total / np.maximum(weight, 1.0), np.nan)
