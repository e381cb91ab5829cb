"""Where a row of points has gone after a jump that no flow could follow: a snip may let tissue spring by a fifth of the picture at once.

Each point's surroundings on the last picture that showed it are searched for in a wide window of the new one. Single matches may be
wrong, so the row as a whole decides: matches that lie off a smooth row are put aside, and a row that no tissue could have become is none.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array, Image
from skills.tracking.patches import patches_at
from skills.tracking.rows import RowConfig, smooth_row


@dataclass(frozen=True)
class RelocateConfig:
    """What is searched for, how far, and when a row counts as found. Lengths in pixels, likeness as correlation -1..1."""

    radius: int = 14  # of the surroundings
    reach: int = 70  # of the search
    likeness: float = 0.6  # of a match
    least: float = 0.5  # share of the row's points that must be found on one smooth row
    shrunk: float = 0.4  # least and
    stretched: float = 2.5  # most that the distance between neighbours may have become, as a share
    patience: int = 3  # updates that a goal is lost before it is searched for
    rows: RowConfig = field(default_factory=RowConfig)


def relocate(before: Image, now: Image, row: Array, hidden: NDArray[np.bool_], config: RelocateConfig) -> Array | None:
    """Find the `row` (M, 2) of picture `before` (H, W, 3) in picture `now`; None where too little of it is found, or no row.

    `hidden` (H, W) is what hides the tissue now.
    """
    old, seen = (
        np.asarray(cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY), dtype=np.uint8) for image in (before, now)
    )
    new = np.where(hidden, np.uint8(0), seen)
    templates = patches_at(old, row, config.radius)
    windows = patches_at(new, row, config.radius + config.reach)
    found, likeness = row.copy(), np.zeros(len(row))
    for k, (template, window) in enumerate(zip(templates, windows, strict=True)):
        _, best, _, (u, v) = cv2.minMaxLoc(cv2.matchTemplate(window, template, cv2.TM_CCOEFF_NORMED))
        found[k], likeness[k] = row[k] + (u - config.reach, v - config.reach), best
    alike = np.isfinite(likeness) & (likeness >= config.likeness)
    smooth, good = smooth_row(row, found, alike, np.clip(likeness, 0.0, 1.0), config.rows)
    # Matches that are scattered widely all lie within their own scatter, so that they must make a row besides.
    laid, became = (np.linalg.norm(np.diff(points, axis=0), axis=1) for points in (row, smooth))
    likely = (became >= config.shrunk * laid).all() and (became <= config.stretched * laid).all()
    return smooth if good.mean() >= config.least and likely else None
