"""Where segments may lie: on the tissue, away from the gripper, and off edges that must not be cut."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array
from skills.scene.segments import distances, meetings

STEP = 0.5  # [px] between the points of a segment that are looked at
BERTH = 1.0  # [px] along a segment, between it and a barred edge


@dataclass(frozen=True)
class Room:
    """The tissue's `outline` (H, W) bool, None if everything is tissue, less the circle of `clearance` [px] around `grasp` (2,).

    No segment meets an edge that is `barred` (B, 2, 2): one that must not be cut.
    """

    outline: NDArray[np.bool_] | None
    grasp: Array
    clearance: float
    barred: Array = field(default_factory=lambda: np.zeros((0, 2, 2)))

    def whole(self, segments: Array) -> NDArray[np.bool_]:
        """Which of `segments` (S, 2, 2) are free all along."""
        if self.outline is None and not len(self.barred):
            return ~(distances(self.grasp[None], segments)[0] < self.clearance)
        return np.asarray(self._looked_at(segments)[1].all(axis=1))

    def pieces(self, segments: Array) -> Array:
        """Free parts (K, 2, 2) of `segments` (S, 2, 2): those that are free all along stay as they are."""
        whole = self.whole(segments)
        some = segments[~whole]
        t, free = self._looked_at(some)
        free = np.pad(free, ((0, 0), (1, 1)))
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
        t, free = self._looked_at(np.stack([point, point + longest * direction])[None])
        blocked = np.flatnonzero(~free[0])
        return longest if not len(blocked) else max(0.0, float(t[blocked[0]]) * longest - 2 * STEP)

    def _looked_at(self, segments: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Positions (T,) 0..1 along `segments` (S, 2, 2), and whether each is free there (S, T)."""
        steps = segments[:, 1] - segments[:, 0]
        lengths = np.linalg.norm(steps, axis=1)
        t = np.linspace(0.0, 1.0, int(np.ceil(float(lengths.max(initial=STEP)) / STEP)) + 1)
        points = segments[:, None, 0] + t[:, None] * steps[:, None]
        free = ~np.asarray(((points - self.grasp) ** 2).sum(-1) < self.clearance**2)
        if self.outline is not None:
            free &= on_outline(points, self.outline)
        if len(self.barred):
            at = t * lengths[:, None]
            low, high = meetings(segments[:, 0], steps / np.maximum(lengths[:, None], 1e-12), self.barred)
            for first, last in zip(low.T, high.T, strict=True):
                free &= (at < first[:, None] - BERTH) | (at > last[:, None] + BERTH)
        return t, free


def on_outline(points: Array, outline: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which of `points` (..., 2) pixels lie on `outline` (H, W); none outside the picture does."""
    at = np.rint(points).astype(np.int64)
    height, width = outline.shape
    within = (at >= 0).all(axis=-1) & (at[..., 0] < width) & (at[..., 1] < height)
    return np.asarray(within & outline[np.clip(at[..., 1], 0, height - 1), np.clip(at[..., 0], 0, width - 1)])
