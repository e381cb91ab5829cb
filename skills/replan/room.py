"""Where segments may lie: on the tissue, and away from the gripper."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array

STEP = 0.5  # [px] between the points of a segment that are looked at


@dataclass(frozen=True)
class Room:
    """The tissue's `outline` (H, W) bool, None if everything is tissue, less the circle of `clearance` [px] around `grasp` (2,)."""

    outline: NDArray[np.bool_] | None
    grasp: Array
    clearance: float

    def free(self, points: Array) -> NDArray[np.bool_]:
        """Which of `points` (..., 2) pixels lie where may be cut."""
        clear = np.asarray(((points - self.grasp) ** 2).sum(-1) >= self.clearance**2)
        if not np.isfinite(self.grasp).all():
            clear = np.ones(points.shape[:-1], dtype=bool)
        return clear if self.outline is None else clear & on_outline(points, self.outline)

    def whole(self, segments: Array) -> NDArray[np.bool_]:
        """Which of `segments` (S, 2, 2) are free all along."""
        return np.asarray(self._looked_at(segments)[1].all(axis=1))

    def pieces(self, segments: Array) -> Array:
        """Free parts (K, 2, 2) of `segments` (S, 2, 2): those that are free all along stay as they are."""
        t, free = self._looked_at(segments)
        whole = free.all(axis=1)
        some, free = segments[~whole], np.pad(free[~whole], ((0, 0), (1, 1)))
        row, first = np.nonzero(free[:, 1:-1] & ~free[:, :-2])
        _, last = np.nonzero(free[:, 1:-1] & ~free[:, 2:])
        # Not quite up to the border, where a look at other points of the same part could find it blocked.
        first, last = first + 2 * (first > 0), last - 2 * (last < len(t) - 1)
        long = last > first
        row, ends = row[long], t[np.column_stack([first[long], last[long]])]
        parts = some[row, None, 0] + ends[..., None] * (some[row, None, 1] - some[row, None, 0])
        return np.concatenate([segments[whole], parts])

    def reach(self, point: Array, direction: Array, longest: float) -> float:
        """How far [px], up to `longest`, everything is free from `point` (2,) along the unit `direction` (2,)."""
        ahead = np.arange(0.0, longest + STEP, STEP)
        blocked = np.flatnonzero(~self.free(point + ahead[:, None] * direction))
        return longest if not len(blocked) else max(0.0, float(ahead[blocked[0]]) - 2 * STEP)

    def _looked_at(self, segments: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Positions (T,) 0..1 along `segments`, and whether each is free there (S, T)."""
        longest = float(np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).max(initial=STEP))
        t = np.linspace(0.0, 1.0, int(np.ceil(longest / STEP)) + 1)
        return t, self.free(segments[:, None, 0] + t[None, :, None] * (segments[:, None, 1] - segments[:, None, 0]))


def on_outline(points: Array, outline: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which of `points` (..., 2) pixels lie on `outline` (H, W); none outside the picture does."""
    at = np.rint(points).astype(np.int64)
    height, width = outline.shape
    within = (at >= 0).all(axis=-1) & (at[..., 0] < width) & (at[..., 1] < height)
    return np.asarray(within & outline[np.clip(at[..., 1], 0, height - 1), np.clip(at[..., 0], 0, width - 1)])
