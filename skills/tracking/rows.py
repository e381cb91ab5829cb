"""A row of tracked points made whole: wrong ones put aside, hidden ones filled in from their neighbours along the row."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array
from skills.tracking.median import median


@dataclass(frozen=True)
class RowConfig:
    """How stiff a row is and what counts as wrong."""

    stiffness: float = 0.5  # weight of the second differences of the displacement against one point's measurement
    tension: float = 0.01  # weight of the first differences: hidden ends follow, they do not shoot off
    min_tolerance: float = 4.0  # [px] a point may always lie off its neighbours' line
    tolerance: float = 4.0  # beyond that, in robust standard deviations
    window: int = 7  # points of the running median that a point is first compared with


def smooth_row(
    laid: Array, points: Array, visible: NDArray[np.bool_], confidence: Array, config: RowConfig
) -> tuple[Array, NDArray[np.bool_]]:
    """Smooth the displacement of a row from where it was `laid` (M, 2) to its tracked `points` (M, 2).

    Whittaker's smoother with robust weights: minimise the weighted squared distance to the seen points plus penalties
    on its first and second differences along the row. Gives the row (M, 2) and which points (M,) were seen and right.
    With no point seen the tracker's own positions are given back.
    """
    usable = visible & np.isfinite(points).all(axis=1)
    if not usable.any():
        return np.where(np.isfinite(points), points, laid), np.zeros(len(laid), dtype=bool)
    displacement = np.where(usable[:, None], points - laid, 0.0)
    good = usable & (_off(displacement - _running_median(displacement, usable, config.window), usable, config) < 1.0)
    smooth = displacement
    for _ in range(3):
        before, smooth = good, _whittaker(displacement, np.where(good, np.maximum(confidence, 0.05), 0.0), config)
        good = usable & (_off(displacement - smooth, good, config) < 1.0)
        if not good.any() or (good == before).all():
            break
    return laid + smooth, good


def _off(residual: Array, trusted: NDArray[np.bool_], config: RowConfig) -> Array:
    """Residuals (M, 2) as multiples (M,) of what is tolerated; the scale comes from the trusted ones."""
    size = np.linalg.norm(residual, axis=1)
    scale = 1.4826 * float(median(size[trusted])) if trusted.any() else 0.0
    return np.asarray(size / max(config.min_tolerance, config.tolerance * scale))


def _running_median(values: Array, usable: NDArray[np.bool_], window: int) -> Array:
    """Median (M, 2) of the `window` usable values nearest along the row."""
    places = np.flatnonzero(usable)
    away = np.abs(places[None, :] - np.arange(len(values))[:, None])
    near = places[np.argsort(away, axis=1, kind="stable")[:, :window]]
    return median(values[near], axis=1)


def _whittaker(values: Array, weights: Array, config: RowConfig) -> Array:
    """Minimise sum w |z - y|^2 + tension |D z|^2 + stiffness |D^2 z|^2 over z (M, 2)."""
    system = _penalty(len(values), config).copy()
    np.fill_diagonal(system, system.diagonal() + weights)
    return np.asarray(np.linalg.solve(system, weights[:, None] * values))


@lru_cache(maxsize=16)
def _penalty(count: int, config: RowConfig) -> Array:
    """The matrix (M, M) of both penalties, for a row of `count` points."""
    identity = np.eye(count)
    first, second = np.diff(identity, axis=0), np.diff(identity, 2, axis=0)
    return config.tension * first.T @ first + config.stiffness * second.T @ second + 1e-9 * identity
