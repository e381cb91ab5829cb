"""Strands that are left between two edges across the goal: thinner than the grid, and brighter than the bed behind them.

Where nothing holds the lips together, a way leads through the dark from one edge's opening to the next one's. A strand bars every way;
a strip that is torn at one end leaves one free.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array

SAMPLE = 0.5  # [px] between the places looked at, from an edge to the next
ROWS = 24  # places across the opening
CLIMB = 2  # rows by which a way may rise or fall from one place to the next


@dataclass(frozen=True)
class StrandConfig:
    """When something between two openings is a strand.

    Of 3162 pairs of gaping neighbours in the last pictures of 34 development sessions (silicone and the long chicken) whose lips nothing
    holds, 99.4 % had a way that stood out from the bed by at most 0.1 of what tissue does, and 19 of the rest showed strips that lay
    across; past strands that held, the darkest way stood out by 0.44 to 1.03. Compared with the tissue alone the two meet: where a flap
    lies in the shade, its bed is 0.7 as bright, and a thin strand that turns its dark cut side to the camera 0.64.
    """

    wide: float = 3.0  # [px] of both openings; what is narrower is not looked into
    bright: float = 0.3  # of the way from the bed's brightness to the tissue's


def strands_between(
    brightness: NDArray[np.uint8], ends: Array, openings: Array, level: Array, config: StrandConfig | None = None
) -> Array:
    """Whether (C - 1,) a strand lies between each edge and the next: 1, 0, or nan where the two do not both gape.

    `ends` (C, 2, 2) pixels of edges in order along the goal, `openings` (C, 2) where along them they gape, as shares, and `level` (C,)
    how bright tissue is there; nan in any of them where it is not known.
    """
    config = config or StrandConfig()
    along = ends[:, 1] - ends[:, 0]
    width = (openings[:, 1] - openings[:, 0]) * np.linalg.norm(along, axis=1)
    gapes = np.nan_to_num(width) >= config.wide
    found = np.full(max(len(ends) - 1, 0), np.nan)
    both = np.flatnonzero(gapes[:-1] & gapes[1:])
    if not len(both):
        return found
    rows = (np.arange(ROWS) + 0.5) / ROWS
    share = openings[:, :1] + rows * (openings[:, 1:] - openings[:, :1])
    through = (ends[:, None, 0] + share[..., None] * along[:, None]).astype(np.float32)  # (C, ROWS, 2)
    first, step = through[both], through[both + 1] - through[both]
    count = max(2, int(np.ceil(np.linalg.norm(step, axis=2).max() / SAMPLE)))
    t = ((np.arange(count) + 0.5) / count).astype(np.float32)
    u, v = ((first[..., k, None] + t * step[..., k, None]).reshape(len(both), -1) for k in (0, 1))
    seen = cv2.remap(brightness, u, v, cv2.INTER_LINEAR).reshape(len(both), ROWS, count)
    tissue = np.minimum(level[both], level[both + 1])
    bed = np.maximum(np.median(seen[:, :, 0], axis=1), np.median(seen[:, :, -1], axis=1))
    limit = bed + config.bright * np.maximum(tissue - bed, 0.0)
    dark = np.asarray(seen <= limit[:, None, None])
    # Mostly a straight way is free, and no other need be looked for.
    straight: NDArray[np.bool_] = np.asarray(dark.all(axis=2))
    winding = np.flatnonzero(~straight.any(axis=1))
    found[both] = 0.0
    found[both[winding]] = ~_passable(dark[winding])
    return found


def _passable(dark: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether (P,) a way leads through the `dark` (P, R, T) from its first column to its last."""
    reached = np.pad(dark[:, :, 0], ((0, 0), (CLIMB, CLIMB)))
    rows = dark.shape[1]
    for column in range(1, dark.shape[2]):
        ways = [reached[:, shift : shift + rows] for shift in range(2 * CLIMB + 1)]
        reached[:, CLIMB:-CLIMB] = np.logical_or.reduce(ways) & dark[:, :, column]
    return np.asarray(reached.any(axis=1))
