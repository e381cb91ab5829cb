"""How wide an opening lies along each edge of the keypoint grid: what is dark between two lips is no tissue.

Seen at full resolution, a slit of two pixels counts; a mask of the whole picture is made coarser and loses it. A slit is shallow at first
and its cut faces are lit, so it is only a little darker than the tissue; vessels and prints are that dark too, but they were there at
t_d already. So the reference picture tells how dark an edge may be.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array, Image


@dataclass(frozen=True)
class GapConfig:
    """What counts as an opening in the brightness profile along an edge. Brightness as a share of that at the edge's ends.

    The shares are where connected edges ended on the bench's three tissues: none fell below 0.98 (chicken) or 0.70 (beef, vessels), none
    lost more than 0.055 of its darkest place while it was stretched.
    """

    sample: float = 0.5  # [px] between samples
    least_samples: int = 16
    end: float = 0.15  # share of the edge at each end that tells the tissue's brightness,
    longest_end: float = 4.0  # [px] and no more than this, where the lips of a wide opening may end
    dark: float = 0.65  # below this it is an opening whatever was there before
    faint: float = 0.94  # below this it is one where the tissue was evenly bright before
    fainter: float = 0.92  # of the darkest place that was there before


def gap_along(
    image: Image,
    points: Array,
    edges: NDArray[np.int64],
    config: GapConfig | None = None,
    darkest_before: Array | None = None,
) -> Array:
    """Width (E,) [px] of the longest dark run along each edge between `points` (N, 2) on `image` (H, W, 3) uint8 RGB.

    nan where an end is not on the image. `darkest_before` (E,) from `darkest_along` at t_d lets faint slits count too.
    """
    config = config or GapConfig()
    inside, rows, length = _profiles(image, points, edges, config)
    limit = np.full(len(edges), config.dark)
    if darkest_before is not None:
        known = np.nan_to_num(darkest_before, nan=0.0)
        limit = np.maximum(limit, np.minimum(config.faint, config.fainter * known))
    widths = np.full(len(edges), np.nan)
    if inside.any():
        widths[inside] = _longest_run(rows < limit[inside, None]) / rows.shape[1] * length[inside]
    return widths


def darkest_along(image: Image, points: Array, edges: NDArray[np.int64], config: GapConfig | None = None) -> Array:
    """Brightness (E,) of the darkest place along each edge, as a share of that at its ends; nan where an end is not on the image."""
    inside, rows, _ = _profiles(image, points, edges, config or GapConfig())
    darkest = np.full(len(edges), np.nan)
    if inside.any():
        darkest[inside] = rows.min(axis=1)
    return darkest


class GapWatch:
    """The widest opening seen along each edge across the goal since t_d, in two looks in a row: what has parted does not heal.

    A slit may be open at t_d and close again while the tissue beside it is pulled; only somebody who looked all the time knows.
    """

    def __init__(
        self,
        image: Image,
        points: Array,
        edges: NDArray[np.int64],
        crosses_goal: NDArray[np.bool_],
        between: tuple[float, ...] = (),
    ) -> None:
        """`between` are places beside each edge, in spacings towards the next one, that must be open too: strands are thinner than that."""
        self._edges = edges
        self._between = between
        self._crossing = np.flatnonzero(crosses_goal)
        self._config = GapConfig()
        self._darkest = darkest_along(image, points, edges[self._crossing], self._config)
        self._last = np.full(len(self._crossing), np.nan)
        self._widest = np.full(len(self._crossing), np.nan)
        self.look(image, points, np.ones(len(points), dtype=bool))

    def look(self, image: Image, points: Array, seen: NDArray[np.bool_]) -> None:
        """Look at a new picture; edges with an end that is not `seen` (N,) are left out."""
        edges = self._edges[self._crossing]
        now = gap_along(image, points, edges, self._config, self._darkest)
        for part in self._between:
            now = np.minimum(now, self._beside(image, points, part))
        now = np.where(seen[edges].all(axis=1), now, np.nan)
        self._widest = np.fmax(self._widest, np.minimum(now, self._last))
        self._last = now

    def _beside(self, image: Image, points: Array, part: float) -> Array:
        """The opening (C,) on a line beside each edge, `part` of the way to the next one (below 0: to the one before)."""
        edges = self._edges[self._crossing]
        ends = points[edges]
        other = np.roll(ends, -1 if part > 0 else 1, axis=0)
        other[-1 if part > 0 else 0] = ends[-1 if part > 0 else 0]
        lines = ends + abs(part) * (other - ends)
        pairs = np.arange(2 * len(lines)).reshape(-1, 2)
        return gap_along(image, lines.reshape(-1, 2), pairs, self._config, self._darkest)

    def widest(self) -> Array:
        """Width (E,) [px] of the widest opening so far; nan where none could be looked for, and on edges that do not cross the goal."""
        widths = np.full(len(self._edges), np.nan)
        widths[self._crossing] = self._widest
        return widths


def _profiles(image: Image, points: Array, edges: NDArray[np.int64], config: GapConfig) -> tuple[NDArray[np.bool_], Array, Array]:
    """Which edges (E,) lie on the image, their brightness (E', T) relative to their own ends, since light falls off, and lengths (E,)."""
    height, width = image.shape[:2]
    a, b = points[edges[:, 0]], points[edges[:, 1]]
    inside: NDArray[np.bool_] = np.ones(len(edges), dtype=bool)
    for end in (a, b):
        with np.errstate(invalid="ignore"):
            inside &= np.asarray(((end >= 0) & (end <= (width - 1, height - 1))).all(axis=1))
    length = np.linalg.norm(b - a, axis=1)
    if not inside.any():
        return inside, np.zeros((0, 0)), length
    # The largest channel: cut faces are coloured, but not as bright as the outer surface in any channel.
    brightness = cv2.GaussianBlur(image.max(axis=2), (3, 3), 0)
    count = max(config.least_samples, int(np.ceil(length[inside].max() / config.sample)))
    t = (np.arange(count) + 0.5) / count
    at = (a[inside][:, None] + t[None, :, None] * (b - a)[inside][:, None]).astype(np.float32)
    rows = cv2.remap(brightness.astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR).astype(np.float64)
    reach = np.minimum(config.end, config.longest_end / np.maximum(length[inside], 1e-9))[:, None]
    tissue = [np.where(near <= np.maximum(reach, t[0]), rows, np.nan) for near in (t[None], 1.0 - t[None])]
    level = np.minimum(*(np.nanmedian(part, axis=1) for part in tissue))
    return inside, rows / np.maximum(level, 1.0)[:, None], length


def _longest_run(dark: NDArray[np.bool_]) -> Array:
    """Length (E,) of the longest run of True in each row (E, T)."""
    run = np.zeros(len(dark))
    longest = np.zeros(len(dark))
    for column in dark.T:
        run = np.where(column, run + 1.0, 0.0)
        longest = np.maximum(longest, run)
    return longest
