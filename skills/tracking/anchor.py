"""Where the tissue of a reference frame is now: chained flow with its drift taken out, for each side of a cut by itself.

The reference is moved along with the chained flow, the new frame is warped back by that, and what is left between the two, a small flow,
says how far the chain was off: so errors do not add up from frame to frame (compare subset methods of digital image correlation, which
match a deformed reference). One side of a cut knows nothing of the other, so the jump that opens between them blurs neither. Where the
warped frame does not look like the reference (a tool, a fold, a highlight), the field is filled from around.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hardware.interface import Array, Image
from skills.tracking.flow import Field, Flow, FlowBox, box_around, cut_out, sampled
from skills.tracking.hidden import Mask
from skills.tracking.picture import Picture

SPACING = 2  # [px]: dense flow is no finer, so the field is kept at the middle of every two by two pixels,
COARSE = 4  # [px] and it is smooth, so it is smoothed on every fourth
BESIDE = np.ones((9, 9), np.uint8)  # places around each one that a patch of the flow there may cover


@dataclass(frozen=True)
class AnchorConfig:
    """Settings of an `Anchor`. Lengths in pixels, likeness as correlation -1..1."""

    margin: float = 14.0  # of the reference around the points
    radius: int = 6  # of the patches that are compared
    noise: float = 6.0  # [grey levels] of even pictures: less than this is not texture
    smoothing: float = 4.0  # of the field where it is not fully trusted; if nothing is around, from farther away
    doubtful: float = 0.2  # likeness at which a place has no say in the field
    certain: float = 0.8  # likeness from which it has its full say
    holds: float = 0.5  # likeness at which a point still shows the reference
    least: float = 0.3  # likeness below which a point is not seen: 1 in 200 well tracked ones, a fifth of those astray
    min_holding: float = 0.4  # share of the side's points in view; below it the reference no longer holds
    min_returned: float = 0.7  # the same where the frame before is no witness; on an unrelated picture a third holds by chance
    min_followed: float = 0.4  # share of the seen points, for the frame before to be a witness; a quarter is followed by chance
    min_renewing: float = 0.6  # the same for a new reference to be taken

    def __post_init__(self) -> None:
        if not (self.margin > 0 and self.radius >= 1 and self.smoothing > 0 and self.doubtful < self.certain):
            raise ValueError("an anchor needs a margin, a patch, smoothing and doubtful likeness below certain likeness")


@dataclass(frozen=True)
class _Patched:
    """A picture, and mean and variance of the patch around each of its places: (H, W) each."""

    grey: NDArray[np.float32]
    mean: NDArray[np.float32]
    variance: NDArray[np.float32]


class Anchor:
    """The reference of one side. `follow` is called with each new frame; one thread."""

    def __init__(
        self, picture: Picture, flow: Flow, points: Array, mine: Mask, usable: Mask, tool_mask: Mask | None, config: AnchorConfig
    ) -> None:
        """Take `picture` as the reference for those of `points` (N, 2) that are `mine`, where the `usable` ones are seen."""
        self._flow = flow
        self._config = config
        height, width = picture.even.shape
        u0, v0, u1, v1 = box_around(points[mine & usable], config.margin, (width, height))
        box = u0, v0, u1 - (u1 - u0) % COARSE, v1 - (v1 - v0) % COARSE
        self._pixels = _places(np.arange(box[0], box[2]), np.arange(box[1], box[3]))
        self._middles = self._pixels[::SPACING, ::SPACING] + np.float32((SPACING - 1) / 2)
        rows, columns = self._middles.shape[:2]
        self._grid = _places(np.arange(columns), np.arange(rows))
        known = np.flatnonzero(np.isfinite(points).all(axis=1))
        _, nearest = cKDTree(points[known]).query(self._middles.reshape(-1, 2))
        self._field: Field = np.zeros_like(self._middles)
        self._before = self._field
        self._own = mine[known[nearest]].reshape(rows, columns)
        if tool_mask is not None:
            self._own &= ~self._under(tool_mask, self._field)
        self._seen = self._own  # and not under a tool now
        self._sees = cut_out(flow.sees(picture), box)
        self._patches = _patched(_read(picture.even, self._middles), config.radius)
        self._points = points[mine]
        self._at = (self._points - self._middles[0, 0]) / SPACING

    def follow(self, new: Picture, step: FlowBox, moved: Array, found: Mask, tool_mask: Mask | None) -> tuple[Array, Array]:
        """Follow the reference into `new`: where its points are now (M, 2), and how alike the picture is there (M,) -1..1.

        `step` is the flow from the frame before. If most of the reference is out of sight after it, the side may have sprung away:
        then it is looked for once more from where single points, `found` (M,) among `moved` (M, 2), were found again.
        """
        chained, self._before = self._chained(step, tool_mask), self._field
        field, alike = self._settled(new, chained, tool_mask, self._flow.near)
        if self.holding(alike) < self._config.min_holding:
            field, alike = self._settled(new, chained, tool_mask, self._flow.flow)
        if found.any() and self.holding(alike) < self._config.min_holding:
            jumps = np.zeros_like(chained)
            weights = np.zeros(chained.shape[:2], np.float32)
            at = np.clip(np.rint(self._at[found]).astype(np.int64), 0, [chained.shape[1] - 1, chained.shape[0] - 1])
            jumps[at[:, 1], at[:, 0]] = moved[found] - self._points[found] - sampled(chained, self._at[found])
            weights[at[:, 1], at[:, 0]] = 1.0
            again, alike_again = self._settled(
                new, chained + _filled(jumps, weights, self._config.smoothing), tool_mask, self._flow.flow
            )
            if self.holding(alike_again) > self.holding(alike):
                field, alike = again, alike_again
        self._field = field
        return self._points + sampled(field, self._at), alike

    def let_go(self) -> None:
        """Forget the newest frame, which did not show the reference: go on from where it was before."""
        self._field = self._before

    def holding(self, alike: Array) -> float:
        """The share of points that still show the reference."""
        return float((alike >= self._config.holds).mean())

    def _chained(self, step: FlowBox, tool_mask: Mask | None) -> Field:
        """Move the field on by the flow from the frame before; what a tool hides goes with what is seen around it, not with the tool."""
        before = self._field
        moves = _read(step.field, self._middles + before - step.corner.astype(np.float32))
        seen = self._seen if tool_mask is None else self._seen & ~self._under(tool_mask, before + moves)
        if (seen != self._own).any():
            # Flow is blurred: beside a tool it is partly the tool's.
            seen = self._own & (cv2.dilate((self._own & ~seen).view(np.uint8), BESIDE) == 0)
            trust = np.where(seen, 1.0, 1e-6).astype(np.float32)
            moves = _filled(np.where(seen[..., None], moves, np.float32(0.0)), trust, self._config.smoothing)
        return np.asarray(before + moves)

    def _under(self, tool_mask: Mask, field: Field) -> Mask:
        """Where (H, W) the reference, moved by `field`, lies under a tool."""
        u, v = cv2.split(self._middles + field)
        return np.asarray(cv2.remap(tool_mask.view(np.uint8), u, v, cv2.INTER_NEAREST) != 0)

    def _settled(
        self, new: Picture, field: Field, tool_mask: Mask | None, flow: Callable[[Image, Image], Field]
    ) -> tuple[Field, Array]:
        """Correct `field` (H, W, 2) by `flow` so that the reference fits the new picture; give it, and the points' likeness (M,)."""
        c = self._config
        own = self._seen = self._own if tool_mask is None else self._own & ~self._under(tool_mask, field)
        size = self._pixels.shape[1::-1]
        back = _read(self._flow.sees(new), self._pixels + cv2.resize(field, size, interpolation=cv2.INTER_LINEAR))
        # What is not this side's tissue is shown as the reference has it: there, nothing pulls.
        other = cv2.resize((~own).view(np.uint8), size, interpolation=cv2.INTER_NEAREST)
        rest = flow(self._sees, np.asarray(cv2.copyTo(self._sees, other, back), dtype=np.uint8))
        rest = np.asarray(cv2.resize(rest, field.shape[1::-1], interpolation=cv2.INTER_AREA), dtype=np.float32)
        field = rest + _read(field, self._grid + rest / np.float32(SPACING))
        even = _read(new.even, self._middles + field)
        alike = _likeness(self._patches, even, c.radius, c.noise)
        trust = np.clip((alike - c.doubtful) / (c.certain - c.doubtful), 1e-3, 1.0)
        trust = np.where(own, trust, 1e-6).astype(np.float32)
        return _filled(field, trust, c.smoothing), sampled(np.where(own, alike, 0.0), self._at)


def _places(u: NDArray[np.int64], v: NDArray[np.int64]) -> Field:
    """Every (u, v): (len(v), len(u), 2)."""
    return np.stack(np.meshgrid(u, v), axis=-1).astype(np.float32)


def _read(picture: NDArray[Any], at: Field) -> NDArray[Any]:
    u, v = cv2.split(at)
    return np.asarray(cv2.remap(picture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def _patched(picture: NDArray[np.uint8], radius: int) -> _Patched:
    """The picture, seen at every `SPACING`, with what is asked of the patches of `radius` [px] around each place."""
    x, size = picture.astype(np.float32), _side(radius)
    mean = cv2.blur(x, size)
    return _Patched(x, np.asarray(mean), np.asarray(np.maximum(cv2.blur(x * x, size) - mean * mean, 0.0)))


def _likeness(a: _Patched, picture: NDArray[np.uint8], radius: int, noise: float) -> NDArray[np.float32]:
    """How alike (H, W) the patches around each place of two pictures are: `patches.same`, everywhere at once."""
    b, size = _patched(picture, radius), _side(radius)
    together = cv2.blur(a.grey * b.grey, size) - a.mean * b.mean
    return np.asarray(2.0 * (together + noise**2) / (a.variance + b.variance + 2.0 * noise**2))


def _side(radius: int) -> tuple[int, int]:
    """Places that a patch of `radius` [px] is wide and high."""
    side = 2 * (radius // SPACING) + 1
    return side, side


def _filled(field: Field, trust: NDArray[np.float32], smoothing: float) -> Field:
    """Keep `field` (H, W, 2) as far as it is to be trusted, 0..1 (H, W), and fill it smoothly from around for the rest.

    It is given at every `SPACING`. Where nothing near is trusted it is filled from as far as four times `smoothing` [px].
    """
    height, width = trust.shape
    size = width * SPACING // COARSE, height * SPACING // COARSE
    weights = cv2.resize(trust, size, interpolation=cv2.INTER_AREA)
    both = cv2.merge([trust, trust])
    values = cv2.resize(field * both, size, interpolation=cv2.INTER_AREA)
    near, far = smoothing / COARSE, 4.0 * smoothing / COARSE
    top = cv2.GaussianBlur(values, (0, 0), near) + 1e-3 * cv2.GaussianBlur(values, (0, 0), far)
    bottom = cv2.GaussianBlur(weights, (0, 0), near) + 1e-3 * cv2.GaussianBlur(weights, (0, 0), far)
    smooth = cv2.resize(top / (bottom + 1e-12)[..., None], (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(smooth + both * (field - smooth), dtype=np.float32)
