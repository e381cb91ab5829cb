"""Where a row of points is that was lost from sight, by an older picture that showed it.

A snip may let tissue spring by a fifth of the picture at once: no flow follows that, so each point's surroundings are searched for in a
wide window. Single matches may be wrong, so the row as a whole decides: matches that lie off a smooth row are put aside, and a row that
no tissue could have become is none. Tissue that was hidden for a while and has hardly moved is found by flow straight from the older
picture, also where it is creased and single matches go astray.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array, Image
from skills.tracking.flow import FlowDIS, box_around, cut_out, sampled
from skills.tracking.patches import patches_at, same
from skills.tracking.picture import picture_of
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
    surroundings: int = 5  # within which contrast is made even for the flow
    agreement: float = 2.0  # of the flow's way there and back, for a point to be found,
    patch: int = 6  # and radius of the patches that must look the
    same: float = 0.5  # same (`patches.same`),
    noise: float = 6.0  # [grey levels] of even pictures left aside, as for an anchor
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


def flowed(
    before: Image, now: Image, rows: tuple[Array, Array], tissue: NDArray[np.bool_], config: RelocateConfig
) -> tuple[Array, Array] | None:
    """Follow both `rows` (M, 2) from picture `before` to `now`, whatever was between; None where too little of either is found.

    `tissue` (H, W) is where tissue is seen now: a point is found there, and only if the way back agrees.
    """
    flow, count = FlowDIS("medium"), len(rows[0])
    points = np.vstack(rows)
    box = box_around(points, config.reach, now.shape[1::-1])
    corner = np.array(box[:2], dtype=np.float64)
    old, new = (cut_out(flow.sees(picture_of(image, config.surroundings, box)), box) for image in (before, now))
    there = sampled(flow.flow(old, new), points - corner)
    found = points + there
    error = np.linalg.norm(there + sampled(flow.flow(new, old), found - corner), axis=1)
    # Flow between pictures of different things may agree with its way back; what it leads to does not look alike then.
    before_there, now_there = (patches_at(even, p - corner, config.patch) for even, p in ((old, points), (new, found)))
    alike = same(before_there, now_there, config.noise) >= config.same
    u, v = np.clip(np.rint(found).astype(np.int64), 0, [now.shape[1] - 1, now.shape[0] - 1]).T
    agrees, trust = (error <= config.agreement) & alike & tissue[v, u], 1.0 / (1.0 + error)
    parts = (slice(0, count), slice(count, None))
    (near, near_good), (far, far_good) = (smooth_row(points[p], found[p], agrees[p], trust[p], config.rows) for p in parts)
    return (near, far) if min(near_good.mean(), far_good.mean()) >= config.least else None
