"""Points that are not seen: they go along with their seen neighbours of the same side, until their patch is found again."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from hardware.interface import Array, Image
from skills.tracking.median import median
from skills.tracking.patches import Patches, patches_at, texture

Mask = NDArray[np.bool_]

ALONG = 3  # neighbours whose median step tells where to look


@dataclass(frozen=True)
class HiddenConfig:
    """When a hidden point counts as seen again. Lengths in pixels, times in updates, similarity as correlation -1..1."""

    neighbours: int = 6
    max_hidden: int = 200  # updates before a hidden point is lost for good
    min_followed: float = 0.4  # share of the seen points that were followed, for others to be looked for; chance: 0.25
    similarity: float = 0.6  # of a hidden point's patch, to count as seen again
    reach: int = 12  # around where the neighbours say that it should be
    min_texture: float = 2.5  # [grey levels] standard deviation; below it a patch has no place of its own
    max_change: float = 0.2  # of the brightness of such a flat patch


def with_neighbours(before: Array, moved: Array, asked: Mask, seen: Mask, groups: NDArray[np.int64], neighbours: int) -> Array:
    """Let those of `moved` (N, 2) that are `asked` (N,) go along: the median step from `before` of their nearest seen neighbours.

    Neighbours are of the same group; the other side of the cut moves otherwise, and is asked only when nothing is seen on this one.
    """
    result, steps = moved.copy(), moved - before
    for group in np.unique(groups[asked]):
        mine, near = np.flatnonzero(asked & (groups == group)), np.flatnonzero(seen & (groups == group))
        if not len(near):
            near = np.flatnonzero(seen)
        if not len(near):
            result[mine] = before[mine]
            continue
        nearest = near[np.argsort(cdist(before[mine], before[near]), axis=1, kind="stable")[:, :neighbours]]
        result[mine] = before[mine] + median(steps[nearest], axis=1)
    return result


def find_again(
    grey: Image,
    before: Array,
    moved: Array,
    seen: Mask,
    lost: Mask,
    groups: NDArray[np.int64],
    patches: Patches,
    tool_mask: Mask | None,
    config: HiddenConfig,
    recognised: bool,
) -> tuple[Array, Mask, Array]:
    """Look for the unseen points' last seen `patches`, from the seen ones outwards; give points, seen, similarity (0: not looked for).

    When a cut springs open, its lips move farther at once than flow can follow, but they move smoothly along themselves: each point
    found tells where to look for the next one on its side. `lost` points go along, but are not looked for.
    """
    moved, seen, found = moved.copy(), seen.copy(), np.zeros(len(moved))
    if not (recognised and seen.any()):
        moved[~seen] = before[~seen]
        return moved, seen, found
    waiting = np.flatnonzero(~seen & ~lost)
    textured = texture(patches[waiting]) >= config.min_texture
    apart = cdist(before[waiting], before)
    # The other side of the cut moves otherwise: it is asked only when nothing is seen on this one.
    apart += 1e4 * (groups[waiting, None] != groups[None])
    from_seen = apart[:, seen].min(axis=1)
    for _ in waiting:
        i = int(np.argmin(from_seen))
        k = waiting[i]
        near = np.flatnonzero(seen)
        near = near[np.argsort(apart[i, near], kind="stable")[:ALONG]]
        moved[k] = before[k] + median(moved[near] - before[near])
        from_seen[i] = np.inf
        if not _open_to_view(grey, moved[k], tool_mask):
            continue
        place, alike = _search(grey, moved[k], patches[k], bool(textured[i]), config)
        if alike >= config.similarity and _open_to_view(grey, place, tool_mask):
            moved[k], seen[k], found[k] = place, True, alike
            from_seen = np.where(np.isinf(from_seen), np.inf, np.minimum(from_seen, apart[:, k]))
    return with_neighbours(before, moved, ~seen, seen, groups, ALONG), seen, found


def inside(points: Array, picture: NDArray[np.uint8]) -> Mask:
    """Whether each of `points` (N, 2) lies within the `picture` (H, W, ...), its border left out."""
    height, width = picture.shape[:2]
    return np.asarray((points >= 1).all(axis=1) & (points[:, 0] <= width - 2) & (points[:, 1] <= height - 2))


def covered(points: Array, mask: Mask | None) -> Mask:
    """Whether each of `points` (N, 2) lies under the mask (H, W); outside the image nothing is covered."""
    if mask is None:
        return np.zeros(len(points), dtype=bool)
    nearest = np.rint(points).astype(np.int64)
    u, v = np.clip(nearest[:, 0], 0, mask.shape[1] - 1), np.clip(nearest[:, 1], 0, mask.shape[0] - 1)
    return np.asarray(mask[v, u])


def _open_to_view(grey: Image, point: Array, tool_mask: Mask | None) -> bool:
    """`inside` and not `covered`, for a single point: asked often."""
    (height, width), (u, v) = grey.shape, point
    if not (1 <= u <= width - 2 and 1 <= v <= height - 2):
        return False
    return tool_mask is None or not tool_mask[round(v), round(u)]


def _search(grey: Image, at: Array, patch: NDArray[np.float32], textured: bool, config: HiddenConfig) -> tuple[Array, float]:
    """Where around `at` (2,) `patch` is found again, and how alike; a flat patch can only be compared where it should be."""
    radius = patch.shape[-1] // 2
    if not textured:
        # In a flat patch correlation sees noise alone: as flat and about as bright is all that can be asked.
        here = patches_at(grey, at[None], radius)
        change = abs(float(here.mean()) / max(float(patch.mean()), 1.0) - 1.0)
        as_flat = float(texture(here)[0]) < 2.0 * config.min_texture
        return at, (1.0 - 0.4 * change / config.max_change if as_flat else 0.0)
    around = patches_at(grey, at[None], radius + config.reach)[0]
    _, best, _, (du, dv) = cv2.minMaxLoc(cv2.matchTemplate(around, patch, cv2.TM_CCOEFF_NORMED))
    return at + np.array([du - config.reach, dv - config.reach]), float(best)
