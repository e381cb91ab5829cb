"""Points followed through the pictures by dense optical flow (DIS), chained from frame to frame.

Flow is computed only in the box around the points, forwards and backwards: a point whose way back does not lead home is not
seen. What a tool covers is not seen either. Unseen points go along with their seen neighbours of the same group (the two sides
of a cut are different groups, since they part) until their last seen patch is found again, or they are lost for good. Chained
flow drifts; where a point's template, a patch from some frames ago, still matches, the point is pulled back onto it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array, Frame, Image
from skills.scene.stereo import region_around
from skills.tracking.patches import align, patches_at, same, texture
from skills.tracking.tracks import Tracks

PRESETS = {"medium": cv2.DISOPTICAL_FLOW_PRESET_MEDIUM, "fast": cv2.DISOPTICAL_FLOW_PRESET_FAST}


@dataclass(frozen=True)
class TrackerConfig:
    """Settings of `TrackerDIS`. Lengths in pixels, times in updates, similarity as correlation -1..1."""

    preset: str = "medium"  # or "fast": a fifth of the time, about twice the error
    margin: float = 32.0  # of the box around the points; more than a point moves between updates
    max_disagreement: float = 1.5  # between the way forth and the way back
    patch_radius: int = 6  # less than the distance of the rows from the cut, so that a patch holds one side only
    min_texture: float = 2.5  # [grey levels] standard deviation; below it a patch has no place of its own
    noise: float = 1.0  # [grey levels] of the smoothed picture
    min_similarity: float = 0.2  # of the patch to the same patch one frame before
    refind_similarity: float = 0.6  # of a hidden point's patch, to count as seen again
    min_followed: float = 0.2  # share of the seen points that flow must have followed for the others to be looked for
    refind_reach: int = 12  # around where the neighbours say that it should be
    max_change: float = 0.2  # of the brightness at the point itself, where its surroundings changed
    neighbours: int = 6
    max_hidden: int = 200  # updates before a hidden point is lost for good
    anchor_similarity: float = 0.85  # of a point's template; below it a new one is taken
    anchor_reach: float = 2.0  # largest correction by the template in one update
    anchor_steps: int = 4

    def __post_init__(self) -> None:
        if self.preset not in PRESETS:
            raise ValueError(f"the DIS preset must be one of {', '.join(PRESETS)}, not {self.preset!r}")


class TrackerDIS:
    """Follows points; call `start` once, then `update` with each new frame, from one thread."""

    def __init__(self, config: TrackerConfig | None = None) -> None:
        self.config = config or TrackerConfig()
        self._flow = cv2.DISOpticalFlow.create(PRESETS[self.config.preset])
        # The way back only checks the way forth, to a pixel or so: the quick preset does.
        self._check = cv2.DISOpticalFlow.create(PRESETS["fast"])

    def start(
        self, frame: Frame, points: Array, groups: NDArray[np.int64] | None = None, tool_mask: NDArray[np.bool_] | None = None
    ) -> Tracks:
        """Follow `points` (N, 2) pixels from `frame` on; points of one group (N,) move together. Covered ones start hidden."""
        self._points = np.array(points, dtype=np.float64).reshape(-1, 2)
        n = len(self._points)
        self._groups = np.zeros(n, np.int64) if groups is None else np.array(groups, dtype=np.int64)
        if len(self._groups) != n:
            raise ValueError("each point needs a group")
        self._gray = _gray(frame.image)
        self._frame = (frame.sequence, frame.stamp)
        self._templates = patches_at(self._gray, self._points, self.config.patch_radius)
        self._last_patches = self._templates.copy()
        self._seen = self._inside(self._points) & ~_covered(self._points, tool_mask)
        self._hidden_for = np.where(self._seen, 0, 1)
        self._confidence = np.where(self._seen, 1.0, 0.0)
        return self.tracks()

    def tracks(self) -> Tracks:
        """Give where the points were in the newest frame."""
        return Tracks(self._frame[1], self._points.copy(), self._seen.copy(), self._confidence.copy())

    def update(self, frame: Frame, tool_mask: NDArray[np.bool_] | None = None) -> Tracks:
        """Follow the points into `frame`; `tool_mask` (H, W) is where instruments hide it. A frame seen before changes nothing.

        Raises:
            RuntimeError: `start` was not called.
            ValueError: the frame is of another size.
        """
        if not hasattr(self, "_gray"):
            raise RuntimeError("a tracker must be started before it is updated")
        if frame.image.shape[:2] != self._gray.shape:
            raise ValueError("a tracker must be given frames of one size")
        if frame.sequence == self._frame[0] or not len(self._points):
            self._frame = (frame.sequence, frame.stamp)
            return self.tracks()
        gray = _gray(frame.image)
        c = self.config
        moved, disagreement = self._follow(gray)
        patches = patches_at(gray, moved, c.patch_radius)
        similar = same(self._last_patches, patches, c.noise)
        open_to_view = self._inside(moved) & ~_covered(moved, tool_mask)
        sure = self._seen & open_to_view & (disagreement <= c.max_disagreement)
        seen = sure & (similar >= c.min_similarity)
        # A cut that opens beside a point changes its patch; the point itself still looks the same.
        centre = np.abs(_centres(patches) - _centres(self._last_patches)) <= c.max_change * _centres(self._last_patches)
        seen |= sure & centre & (np.linalg.norm(moved - self._with_neighbours(moved, seen), axis=1) <= c.max_disagreement)
        moved, seen, refound = self._refind(gray, moved, seen, tool_mask)
        moved = self._anchor(gray, moved, seen)
        self._hidden_for = np.where(seen, 0, self._hidden_for + 1)
        self._last_patches[seen] = patches_at(gray, moved[seen], c.patch_radius)
        agreement = np.exp(-0.5 * (disagreement / c.max_disagreement) ** 2) * (0.5 + 0.5 * np.clip(similar, 0.0, 1.0))
        self._confidence = np.where(seen, np.where(refound > 0, refound, agreement), 0.0)
        self._points, self._seen, self._gray, self._frame = moved, seen, gray, (frame.sequence, frame.stamp)
        return self.tracks()

    def _follow(self, gray: Image) -> tuple[Array, Array]:
        """Move every point by the flow into `gray`: new points (N, 2), and how far the way back misses the start (N,) [px]."""
        height, width = gray.shape
        alive = self._points[self._hidden_for <= self.config.max_hidden]
        if not len(alive):
            return self._points.copy(), np.full(len(self._points), np.inf)
        u0, v0, u1, v1 = region_around(np.clip(alive, 0, [width - 1, height - 1]), self.config.margin, (width, height))
        # DIS needs a few coarse levels: never a box smaller than that.
        u0, v0 = max(0, min(u0, width - 64)), max(0, min(v0, height - 64))
        u1, v1 = min(width, max(u1, u0 + 64)), min(height, max(v1, v0 + 64))
        old, new = (np.ascontiguousarray(picture[v0:v1, u0:u1]) for picture in (self._gray, gray))
        forth = self._flow.calc(old, new, np.zeros((*old.shape, 2), np.float32))
        back = self._check.calc(new, old, np.zeros((*old.shape, 2), np.float32))
        origin = np.array([u0, v0], dtype=np.float64)
        step = _sampled(forth, self._points - origin)
        moved = self._points + step
        return moved, np.linalg.norm(step + _sampled(back, moved - origin), axis=1)

    def _with_neighbours(self, moved: Array, seen: NDArray[np.bool_]) -> Array:
        """Let the unseen points go along: the median step of their nearest seen neighbours of the same group."""
        result = moved.copy()
        for k in np.flatnonzero(~seen):
            near = np.flatnonzero(seen & (self._groups == self._groups[k]))
            if not len(near):
                near = np.flatnonzero(seen)
            if not len(near):
                result[k] = self._points[k]
                continue
            order = np.argsort(np.linalg.norm(self._points[near] - self._points[k], axis=1), kind="stable")
            near = near[order[: self.config.neighbours]]
            result[k] = self._points[k] + np.median(moved[near] - self._points[near], axis=0)
        return result

    def _refind(
        self, gray: Image, moved: Array, seen: NDArray[np.bool_], tool_mask: NDArray[np.bool_] | None
    ) -> tuple[Array, NDArray[np.bool_], Array]:
        """Look for the unseen points' last seen patches, from the seen ones outwards; give points, seen, similarity.

        When a cut springs open, its lips move farther at once than flow can follow, but they move smoothly along themselves: each
        point found tells where to look for the next one on its side.
        """
        c = self.config
        moved, seen, found = moved.copy(), seen.copy(), np.zeros(len(moved))
        textured = texture(self._last_patches) >= c.min_texture
        pending = ~seen
        apart = np.linalg.norm(self._points[:, None] - self._points[None], axis=-1)
        # The other side of the cut moves otherwise: it is asked only when nothing is seen on this one.
        apart += 1e4 * (self._groups[:, None] != self._groups[None])
        # A picture of something else would match here and there by chance.
        recognised = seen.sum() >= c.min_followed * self._seen.sum()
        while pending.any() and seen.any() and recognised:
            k = int(np.flatnonzero(pending)[np.argmin(apart[np.ix_(pending, seen)].min(axis=1))])
            near = np.flatnonzero(seen)
            near = near[np.argsort(apart[k, near], kind="stable")[:3]]
            moved[k] = self._points[k] + np.median(moved[near] - self._points[near], axis=0)
            pending[k] = False
            if (
                self._hidden_for[k] > c.max_hidden
                or not self._inside(moved[k : k + 1])[0]
                or _covered(moved[k : k + 1], tool_mask)[0]
            ):
                continue
            place, alike = self._search(gray, moved[k], self._last_patches[k], bool(textured[k]))
            if alike >= c.refind_similarity and self._inside(place[None])[0] and not _covered(place[None], tool_mask)[0]:
                moved[k], seen[k], found[k] = place, True, alike
        moved[pending] = self._points[pending]
        return moved, seen, found

    def _search(self, gray: Image, at: Array, patch: NDArray[np.float32], textured: bool) -> tuple[Array, float]:
        """Where around `at` (2,) `patch` is found again, and how alike; a flat patch can only be compared where it should be."""
        c = self.config
        if not textured:
            # In a flat patch correlation sees noise alone: as flat and about as bright is all that can be asked.
            here = patches_at(gray, at[None], c.patch_radius)
            change = abs(float(here.mean()) / max(float(patch.mean()), 1.0) - 1.0)
            as_flat = float(texture(here)[0]) < 2.0 * c.min_texture
            return at, (1.0 - 0.4 * change / c.max_change if as_flat else 0.0)
        around = patches_at(gray, at[None], c.patch_radius + c.refind_reach)[0]
        _, best, _, (du, dv) = cv2.minMaxLoc(cv2.matchTemplate(around, patch, cv2.TM_CCOEFF_NORMED))
        return at + np.array([du - c.refind_reach, dv - c.refind_reach]), float(best)

    def _anchor(self, gray: Image, moved: Array, seen: NDArray[np.bool_]) -> Array:
        """Pull points back onto their template where it is still recognised; where it no longer is, take a new one here.

        Chained flow drifts by a little in every link, and near a cut it is smoothed across the gap. A template lasts for several
        frames, so there are fewer links, and it holds one side of the cut only.
        """
        c = self.config
        result = moved.copy()
        ask = np.flatnonzero(seen & (texture(self._templates) >= c.min_texture))
        place = align(gray, self._templates[ask], moved[ask], c.anchor_steps, c.anchor_reach)
        there, here = (patches_at(gray, p, c.patch_radius) for p in (place, moved[ask]))
        alike = same(self._templates[ask], there, c.noise)
        take = (alike >= c.anchor_similarity) & (alike >= same(self._templates[ask], here, c.noise))
        result[ask[take]] = place[take]
        worn = seen.copy()
        worn[ask] = alike < c.anchor_similarity
        self._templates[worn] = patches_at(gray, result[worn], c.patch_radius)
        return result

    def _inside(self, points: Array) -> NDArray[np.bool_]:
        height, width = self._gray.shape
        return np.asarray((points >= 1).all(axis=1) & (points[:, 0] <= width - 2) & (points[:, 1] <= height - 2))


def _gray(image: Image) -> Image:
    # Slightly smoothed: on poor texture the noise would otherwise decide how alike two patches are.
    gray = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY)
    return np.asarray(cv2.GaussianBlur(gray, (5, 5), 1.0), dtype=np.uint8)


def _covered(points: Array, mask: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
    """Whether each of `points` (N, 2) lies under the mask (H, W); outside the image nothing is covered."""
    if mask is None:
        return np.zeros(len(points), dtype=bool)
    nearest = np.rint(points).astype(np.int64)
    u, v = np.clip(nearest[:, 0], 0, mask.shape[1] - 1), np.clip(nearest[:, 1], 0, mask.shape[0] - 1)
    return np.asarray(mask[v, u])


def _centres(patches: NDArray[np.float32]) -> Array:
    """Mean brightness (N,) of the middle 3 x 3 pixels of each patch."""
    middle = patches.shape[-1] // 2
    return np.asarray(patches[:, middle - 1 : middle + 2, middle - 1 : middle + 2].mean(axis=(1, 2)), dtype=np.float64)


def _sampled(flow: NDArray[Any], points: Array) -> Array:
    """Bilinear read-out (N, 2) of a flow field (H, W, 2) at `points` (N, 2)."""
    at = points.astype(np.float32)[None]
    return np.asarray(
        cv2.remap(flow, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0], dtype=np.float64
    )
