"""Strands that are left between two edges across the goal: thinner than the grid, and lit as the tissue is, over a dark bed.

Whatever still holds the lips together crosses every line that runs through the opening from one edge to the next.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array

SAMPLE = 0.5  # [px] between the places looked at


@dataclass(frozen=True)
class StrandConfig:
    """When something between two openings is a strand.

    Of 3785 pairs of gaping neighbours in the last looks of 48 development sessions (silicone) 12 showed more than 0.65 of the tissue's
    brightness on all four lines: 0.80 and 0.83 a strand that held, 0.80 to 0.84 torn strips that lay across, 0.69 to 0.74 others. Of the
    rest 99.5 % showed at most 0.53, and none more than 0.62.
    """

    wide: float = 8.0  # [px] of both openings; what is narrower is not looked into
    bright: float = 0.75  # of the tissue's brightness
    lines: tuple[float, ...] = (0.25, 0.4, 0.55, 0.7)  # of the way through the opening, that it must cross


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
    share = openings[:, :1] + np.array(config.lines) * (openings[:, 1:] - openings[:, :1])
    through = ends[:, None, 0] + share[..., None] * along[:, None]  # (C, L, 2)
    first, last = through[both], through[both + 1]
    count = max(2, int(np.ceil(np.linalg.norm(last - first, axis=2).max() / SAMPLE)))
    t = (np.arange(count) + 0.5) / count
    at = (first[:, :, None] + t[:, None] * (last - first)[:, :, None]).astype(np.float32).reshape(len(both), -1, 2)
    seen = np.asarray(cv2.remap(brightness, at[..., 0], at[..., 1], cv2.INTER_LINEAR), dtype=np.float64)
    brightest = seen.reshape(len(both), len(config.lines), count).max(axis=2)
    tissue = np.minimum(level[both], level[both + 1])
    found[both] = (brightest >= config.bright * tissue[:, None]).all(axis=1)
    return found
