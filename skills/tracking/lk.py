"""Points followed by pyramidal Lucas-Kanade (Bouguet, 2001), chained from frame to frame: the classical baseline."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from hardware.interface import Array
from skills.tracking.picture import Picture
from skills.tracking.stepwise import TrackerConfig, TrackerStepwise

WINDOW = (21, 21)  # [px]
LEVELS = 3  # of the pyramid, beside the full picture
MIN_SIMILARITY = 0.5  # to the frame before: in any picture a single point finds a place that is somewhat alike
STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.03)


class TrackerLK(TrackerStepwise):
    """Each point by itself, forwards and backwards, on pictures of even contrast; never anchored."""

    def __init__(self, config: TrackerConfig | None = None) -> None:
        config = config or TrackerConfig()
        super().__init__(replace(config, anchor=None, min_similarity=max(config.min_similarity, MIN_SIMILARITY)))

    def _follow(self, new: Picture) -> tuple[Array, Array]:
        if not len(self._points):
            return self._points.copy(), np.zeros(0)
        start = self._points.astype(np.float32)[:, None]
        a, b = self._picture.even, new.even
        there, found, _ = cv2.calcOpticalFlowPyrLK(
            a, b, start, np.empty_like(start), winSize=WINDOW, maxLevel=LEVELS, criteria=STOP
        )
        back, returned, _ = cv2.calcOpticalFlowPyrLK(
            b, a, there, np.empty_like(start), winSize=WINDOW, maxLevel=LEVELS, criteria=STOP
        )
        moved = self._points + (there - start)[:, 0]
        missed = np.linalg.norm((back - start)[:, 0], axis=1).astype(np.float64)
        missed[(found[:, 0] == 0) | (returned[:, 0] == 0) | ~np.isfinite(moved).all(axis=1)] = np.inf
        return np.where(np.isfinite(moved), moved, self._points), missed
