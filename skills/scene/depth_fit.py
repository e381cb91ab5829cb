"""A smooth depth on a lattice from a depth map with holes and wrong values: penalised least squares with robust weights.

The unknown is disparity d = f B / Z at the vertices: there the matcher's noise is even, and a plane is affine in the pixels. What
differs from a robustly fitted plane is bilinear in each cell, with a thin plate's penalty, which carries it across holes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import solveh_banded

from hardware.interface import Array
from skills.scene.tissue import Mask

LEAST_SAMPLES = 12
RIDGE = 1e-6  # keeps the equations regular where all samples lie on one line
CENTRE, SCALE = 256.0, 256.0  # [px] keep the plane's three numbers alike in size


@dataclass(frozen=True)
class FitConfig:
    """How stiff the surface is and which depths count as wrong."""

    samples: int = 4  # per cell and direction
    stiffness: float = 3.0  # weight of squared second differences [px] against one depth sample [px]
    noise: float = (
        0.25  # [px] standard deviation that is always allowed, so that steep lips and folds are not taken for wrong depth
    )
    outlier: float = 4.7  # Tukey's constant: a sample this many standard deviations off has no weight
    steps: int = 3  # of reweighting, to find the surface and again to leave out what is off it

    def __post_init__(self) -> None:
        if not (self.samples >= 1 and self.stiffness > 0 and self.noise > 0 and self.outlier > 0 and self.steps >= 1):
            raise ValueError("the depth fit needs positive samples, stiffness, noise, outlier and steps")


@dataclass(frozen=True)
class DepthFit:
    """A fitted surface: `disparity` (rows, columns) [px] at the vertices.

    `support` (rows, columns) 0..1 is the share of the samples around each vertex that were used, `residual` [px] the robust
    standard deviation of the samples about the surface, `rejected` 0..1 the share of them left out as wrong.
    """

    disparity: Array
    support: Array
    residual: float
    rejected: float


def fit_disparity(disparity: Array, pixels: Array, covered: Mask, config: FitConfig | None = None) -> DepthFit | None:
    """Fit the vertices `pixels` (rows, columns, 2) to `disparity` (H, W) [px], nan where it is unknown or not to be used.

    `covered` (H, W) is where there is a surface at all, seen or hidden; `support` is a share of the samples there. None when
    there are too few samples for a plane.
    """
    config = config or FitConfig()
    rows, columns = pixels.shape[:2]
    matrix = _bilinear(rows, columns, config.samples)
    height, width = disparity.shape
    at = np.rint(matrix @ pixels.reshape(-1, 2)).astype(np.int64)
    within: NDArray[np.bool_] = np.asarray(((at >= 0) & (at < (width, height))).all(axis=1))
    at = np.where(within[:, None], at, 0)
    within &= covered[at[:, 1], at[:, 0]]
    values = np.where(within, disparity[at[:, 1], at[:, 0]], np.nan)
    known = np.flatnonzero(np.isfinite(values))
    if len(known) < LEAST_SAMPLES:
        return None
    places, d = at[known].astype(np.float64), values[known]
    plane = _plane(places, d, config)
    A, rest = matrix[known], d - _affine(places) @ plane
    penalty = config.stiffness * _thin_plate(rows, columns)
    residual, x = rest, np.zeros(rows * columns)
    for step in range(2 * config.steps):
        # Least absolute deviations find the surface; Tukey's weights then leave what is off it out altogether.
        weights = _absolute(residual, config) if step < config.steps else _tukey(residual, config)
        x = _solve(A, weights, rest, penalty, 2 * columns)
        residual = rest - A @ x
    used = _tukey(residual, config) > 0
    support = (A.T @ used) / np.maximum(matrix.T @ within, 1e-9)
    fitted = x + _affine(pixels.reshape(-1, 2)) @ plane
    return DepthFit(fitted.reshape(rows, columns), support.reshape(rows, columns), _scatter(residual), 1.0 - float(used.mean()))


def _bilinear(rows: int, columns: int, samples: int) -> sparse.csr_array:
    """Weights (cells * samples^2, rows * columns) that take values at the vertices to an even grid in every cell."""
    t = (np.arange(samples) + 0.5) / samples

    def line(count: int) -> sparse.csr_array:
        cell, offset = np.repeat(np.arange(count - 1), samples), np.tile(t, count - 1)
        row = np.arange(len(cell))
        entries = (np.concatenate([1.0 - offset, offset]), (np.concatenate([row, row]), np.concatenate([cell, cell + 1])))
        return sparse.csr_array(entries, shape=(len(cell), count))

    return sparse.csr_array(sparse.kron(line(rows), line(columns)))


def _thin_plate(rows: int, columns: int) -> sparse.csr_array:
    """Quadratic form of the squared second differences: those along, those across, and the mixed one twice."""

    def differences(count: int, order: int) -> sparse.csr_array:
        return sparse.csr_array(np.diff(np.eye(count), order, axis=0))

    one, two = sparse.eye_array, differences
    parts = [
        sparse.kron(one(rows), two(columns, 2)),
        sparse.kron(two(rows, 2), one(columns)),
        np.sqrt(2.0) * sparse.kron(two(rows, 1), two(columns, 1)),
    ]
    D = sparse.csr_array(sparse.vstack(parts))
    return sparse.csr_array(D.T @ D)


def _solve(A: sparse.csr_array, weights: Array, values: Array, penalty: sparse.csr_array, reach: int) -> Array:
    """Minimise the weighted squared misfit plus the penalty; no two vertices further apart than `reach` are coupled."""
    normal = sparse.coo_array(A.T @ (A * weights[:, None]) + penalty)
    i, j = normal.coords
    upper = j >= i
    band = np.zeros((reach + 1, A.shape[1]))
    band[reach + i[upper] - j[upper], j[upper]] = normal.data[upper]
    band[reach] += RIDGE
    return np.asarray(solveh_banded(band, A.T @ (weights * values), overwrite_ab=True, check_finite=False))


def _affine(places: Array) -> Array:
    return np.column_stack([np.ones(len(places)), (places - CENTRE) / SCALE])


def _plane(places: Array, d: Array, config: FitConfig) -> Array:
    """Robust coefficients (3,) of the plane nearest to disparities `d` (N,) at `places` (N, 2)."""
    design = _affine(places)
    plane = np.array([np.median(d), 0.0, 0.0])
    for _ in range(3 * config.steps):
        weights = _absolute(d - design @ plane, config)
        normal = design.T @ (design * weights[:, None]) + RIDGE * np.eye(3)
        plane = np.linalg.solve(normal, design.T @ (weights * d))
    return plane


def _scatter(residual: Array) -> float:
    """Robust standard deviation [px] of the residuals."""
    return 1.4826 * float(np.median(np.abs(residual)))


def _spread(residual: Array, config: FitConfig) -> float:
    return max(config.noise, _scatter(residual))


def _absolute(residual: Array, config: FitConfig) -> Array:
    """Weights that turn least squares into least absolute deviations: convex, so that no start can lead it astray."""
    return config.noise / np.maximum(np.abs(residual), config.noise)


def _tukey(residual: Array, config: FitConfig) -> Array:
    return np.asarray(np.clip(1.0 - (residual / (config.outlier * _spread(residual, config))) ** 2, 0.0, None) ** 2)
