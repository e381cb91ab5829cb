"""Which keypoints have a known place, though their own patch may not be recognised."""

from __future__ import annotations

import numpy as np
from scipy.spatial.distance import cdist

from hardware.interface import Array
from skills.tracking.hidden import Mask, covered
from skills.tracking.tracks import Tracks

RADIUS = 36.0  # [px] at t_d within which tissue of the same side moves alike
COMPANY = 4  # seen keypoints within it


def neighbours(reference: Array, near_side: Mask) -> Mask:
    """Which keypoints (N, N) lie next to each other on the same side of the goal, `reference` (N, 2) [px] at t_d."""
    distance: Array = np.asarray(cdist(reference, reference))
    np.fill_diagonal(distance, np.inf)
    same = np.equal.outer(near_side, near_side)
    return np.asarray((distance <= RADIUS) & same)


def placed(tracks: Tracks, neighbours: Mask, hidden: Mask, size: tuple[int, int]) -> Mask:
    """Which keypoints (N,) are seen, or stand in plain view among seen ones of their side, which tell where they are.

    On poor texture a patch may look like nothing in particular while everything around it is followed; half of such places are right
    to 3 pixels, five in six to 8. What a tool or a highlight covers now, `hidden` (H, W), has no place.

    Args:
        tracks: of the keypoints.
        neighbours: (N, N) of `neighbours`.
        hidden: (H, W) what covers the tissue.
        size: (width, height) of the picture [px].
    """
    finite = np.asarray(np.isfinite(tracks.points).all(axis=1))
    points = np.where(finite[:, None], tracks.points, -1.0)
    inside = ((points >= 0) & (points <= (size[0] - 1, size[1] - 1))).all(axis=1)
    carried = inside & ~covered(points, hidden) & ((neighbours & tracks.visible).sum(axis=1) >= COMPANY)
    return np.asarray(tracks.visible | carried)
