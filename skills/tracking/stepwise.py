"""Points followed from frame to frame, and which of them are still seen: shared by all trackers that know only two frames at a time.

How a point gets from one frame to the next is the business of a subclass; a point whose way back does not lead home is not seen, nor is
one under a tool or one whose patch has changed. Unseen points go along with their seen neighbours of the same group (the two sides of a
cut are different groups, since they part) until their last seen patch is found again, or they are lost for good.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array, Frame
from skills.tracking.anchor import AnchorConfig
from skills.tracking.flow import PRESETS, box_around
from skills.tracking.hidden import HiddenConfig, Mask, covered, find_again, inside, with_neighbours
from skills.tracking.patches import Patches, patches_at, same
from skills.tracking.picture import Picture, picture_of
from skills.tracking.tracks import Tracks


@dataclass(frozen=True)
class TrackerConfig:
    """Settings of the trackers that go from frame to frame. Lengths in pixels, similarity as correlation -1..1."""

    preset: str = "medium"  # of DIS; or "fast": a fifth of the time, about twice the error
    margin: float = 24.0  # of the box around the points; more than a point moves between updates
    surroundings: int = 5  # within which contrast is made even; little more than the texture's grain
    max_disagreement: float = 1.5  # between the way forth and the way back
    patch_radius: int = 6  # less than the distance of the rows from the cut, so that a patch holds one side only
    noise: float = 1.0  # [grey levels] of the smoothed picture
    min_similarity: float = 0.2  # of the patch to the same patch one frame before
    max_change: float = 0.2  # of the brightness at the point itself, where its surroundings changed
    hidden: HiddenConfig = field(default_factory=HiddenConfig)
    anchor: AnchorConfig | None = field(default_factory=AnchorConfig)  # None: chained only, drift and all

    def __post_init__(self) -> None:
        if self.preset not in PRESETS:
            raise ValueError(f"the DIS preset must be one of {', '.join(PRESETS)}, not {self.preset!r}")
        if self.surroundings < 1:
            raise ValueError("contrast is made even within a pixel at least")


class TrackerStepwise(ABC):
    """A `PointTracker` that goes from frame to frame; call `start` once, then `update` with each new frame, from one thread."""

    def __init__(self, config: TrackerConfig | None = None) -> None:
        self.config = config or TrackerConfig()

    def start(
        self, frame: Frame, points: Array, groups: NDArray[np.int64] | None = None, tool_mask: Mask | None = None
    ) -> Tracks:
        """Follow `points` (N, 2) pixels from `frame` on; points of one group (N,) move together. Covered ones start hidden."""
        self._points = np.array(points, dtype=np.float64).reshape(-1, 2)
        n = len(self._points)
        self._groups = np.zeros(n, np.int64) if groups is None else np.array(groups, dtype=np.int64)
        if len(self._groups) != n:
            raise ValueError("each point needs a group")
        self._picture = self._look(frame)
        self._frame = (frame.sequence, frame.stamp)
        self._patches = patches_at(self._picture.grey, self._points, self.config.patch_radius)
        self._seen = inside(self._points, frame.image) & ~covered(self._points, tool_mask)
        self._hidden_for = np.where(self._seen, 0, 1)
        self._confidence = np.where(self._seen, 1.0, 0.0)
        self._begin(tool_mask)
        return self.tracks()

    def tracks(self) -> Tracks:
        """Give where the points were in the newest frame."""
        return Tracks(self._frame[1], self._points.copy(), self._seen.copy(), self._confidence.copy())

    def update(self, frame: Frame, tool_mask: Mask | None = None) -> Tracks:
        """Follow the points into `frame`; `tool_mask` (H, W) is where instruments hide it. A frame seen before changes nothing.

        Raises:
            RuntimeError: `start` was not called.
            ValueError: the frame is of another size.
        """
        if not hasattr(self, "_picture"):
            raise RuntimeError("a tracker must be started before it is updated")
        if frame.image.shape[:2] != self._picture.grey.shape:
            raise ValueError("a tracker must be given frames of one size")
        if frame.sequence == self._frame[0] or not len(self._points):
            self._frame = (frame.sequence, frame.stamp)
            return self.tracks()
        c, new = self.config, self._look(frame)
        if tool_mask is not None and not tool_mask.any():
            tool_mask = None
        moved, disagreement = self._follow(new)
        seen, similar = self._still_seen(new, moved, disagreement, tool_mask)
        moved, seen, alike = find_again(
            new.grey,
            self._points,
            moved,
            seen,
            (self._hidden_for > c.hidden.max_hidden) | self._looked_after(),
            self._groups,
            self._patches,
            tool_mask,
            c.hidden,
            # A picture of something else would match here and there by chance.
            recognised=bool(seen.sum() >= c.hidden.min_followed * self._seen.sum()),
        )
        moved, agreement = self._settle(new, moved, seen, alike > 0, tool_mask)
        if c.anchor is not None:
            # What shows the reference is seen, whatever hid it before; what shows something else is not, whatever it followed.
            seen |= (agreement >= c.anchor.holds) & (self._hidden_for <= c.hidden.max_hidden)
            seen &= ~(agreement < c.anchor.least)
        seen &= inside(moved, new.grey) & ~covered(moved, tool_mask)
        self._hidden_for = np.where(seen, 0, self._hidden_for + 1)
        self._patches[seen] = patches_at(new.grey, moved[seen], c.patch_radius)
        self._confidence = np.where(seen, _confidence(disagreement / c.max_disagreement, similar, alike, agreement), 0.0)
        self._points, self._seen, self._picture, self._frame = moved, seen, new, (frame.sequence, frame.stamp)
        return self.tracks()

    @abstractmethod
    def _follow(self, new: Picture) -> tuple[Array, Array]:
        """Move every point into `new`: points (N, 2), and how far the way back misses the start (N,) [px]."""

    def _begin(self, tool_mask: Mask | None) -> None:  # noqa: B027 - most trackers have nothing to begin
        """Take what was given to `start` as the reference."""

    def _looked_after(self) -> Mask:
        """Which hidden points (N,) need not be looked for one by one, since `_settle` will find them again."""
        return np.zeros(len(self._points), dtype=bool)

    def _settle(self, new: Picture, moved: Array, seen: Mask, found: Mask, tool_mask: Mask | None) -> tuple[Array, Array]:
        """Give the points' final places (N, 2) and how alike they are to a reference (N,), nan without one."""
        return moved, np.full(len(moved), np.nan)

    def _look(self, frame: Frame) -> Picture:
        """Prepare the frame around where the points were; twice the margin, since next time they are elsewhere."""
        height, width = frame.image.shape[:2]
        near = self._points[inside(self._points, frame.image)]
        box = box_around(near, 2.0 * self.config.margin, (width, height)) if len(near) else (0, 0, width, height)
        return picture_of(frame.image, self.config.surroundings, box)

    def _still_seen(self, new: Picture, moved: Array, disagreement: Array, tool_mask: Mask | None) -> tuple[Mask, Array]:
        """Which points (N,) were followed, and how alike their patches (N,) are to those of the frame before."""
        c = self.config
        patches = patches_at(new.grey, moved, c.patch_radius)
        similar = same(self._patches, patches, c.noise)
        open_to_view = inside(moved, new.grey) & ~covered(moved, tool_mask)
        sure = self._seen & open_to_view & (disagreement <= c.max_disagreement)
        seen = sure & (similar >= c.min_similarity)
        # A cut that opens beside a point changes its patch; the point itself still looks the same.
        centre = np.abs(_centres(patches) - _centres(self._patches)) <= c.max_change * _centres(self._patches)
        doubtful = sure & centre & ~seen
        along = with_neighbours(self._points, moved, doubtful, seen, self._groups, c.hidden.neighbours)
        return seen | (doubtful & (np.linalg.norm(moved - along, axis=1) <= c.max_disagreement)), similar


def _confidence(disagreement: Array, similar: Array, found: Array, agreement: Array) -> Array:
    """How sure (N,) 0..1 the places are, of points followed with `disagreement` (1: the limit) or `found` again, as alike as this.

    Likeness to the reference (`agreement`, nan without one) says more than likeness to the frame before: below 0.45 lie a twentieth of
    the well tracked points on poor texture, and a third of those astray.
    """
    followed = np.where(
        found > 0, found, np.exp(-0.5 * np.minimum(disagreement, 3.0) ** 2) * (0.5 + 0.5 * np.clip(similar, 0.0, 1.0))
    )
    return np.where(np.isfinite(agreement), np.clip((agreement - 0.1) / 0.7, 0.0, 1.0), followed)


def _centres(patches: Patches) -> Array:
    """Mean brightness (N,) of the middle 3 x 3 pixels of each patch."""
    middle = patches.shape[-1] // 2
    return np.asarray(patches[:, middle - 1 : middle + 2, middle - 1 : middle + 2].mean(axis=(1, 2)), dtype=np.float64)
