"""Dense flow between two pictures, and how it is read: what chained and anchored trackers are built on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array
from skills.scene.stereo import Region, region_around
from skills.tracking.picture import Picture

Field = NDArray[np.float32]  # (H, W, 2) [px]: how far each pixel went, (u, v)
SMALLEST = 64  # [px]: coarse-to-fine flow needs a few levels

PRESETS = {"medium": cv2.DISOPTICAL_FLOW_PRESET_MEDIUM, "fast": cv2.DISOPTICAL_FLOW_PRESET_FAST}


class Flow(Protocol):
    """Flow from one picture to another of the same size; (H, W) grey or (H, W, 3) RGB uint8, as `sees` gives them."""

    def sees(self, picture: Picture) -> NDArray[np.uint8]:
        """The kind of picture that this flow is computed on."""
        ...

    def flow(self, old: NDArray[np.uint8], new: NDArray[np.uint8]) -> Field:
        """How far each pixel of `old` went."""
        ...

    def near(self, old: NDArray[np.uint8], new: NDArray[np.uint8]) -> Field:
        """The same, quicker: far jumps may be missed."""
        ...

    def check(self, old: NDArray[np.uint8], new: NDArray[np.uint8]) -> Field:
        """The same, good to a pixel or so: the way back only checks the way forth."""
        ...


class FlowDIS:
    """OpenCV's DIS flow (Kroeger et al., 2016) on pictures of even contrast."""

    def __init__(self, preset: str) -> None:
        self._flow = cv2.DISOpticalFlow.create(PRESETS[preset])
        self._near = cv2.DISOpticalFlow.create(PRESETS[preset])
        if preset == "medium":
            # Less than the preset does, and no worse on the bench's tissues: the anchor takes out what is left.
            for flow, descents in ((self._flow, 6), (self._near, 4)):
                flow.setGradientDescentIterations(descents)
                flow.setVariationalRefinementIterations(3)
            # Patches so far apart may miss a jump of several pixels, where the picture is small.
            self._near.setPatchStride(4)
        self._check = cv2.DISOpticalFlow.create(PRESETS["fast"])
        self._check.setVariationalRefinementIterations(0)

    def sees(self, picture: Picture) -> NDArray[np.uint8]:
        """Even contrast: flow follows poor texture too."""
        return picture.even

    def flow(self, old: NDArray[np.uint8], new: NDArray[np.uint8]) -> Field:
        """The preset's flow, with fewer iterations."""
        return np.asarray(self._flow.calc(old, new, np.zeros((*old.shape, 2), np.float32)))

    def near(self, old: NDArray[np.uint8], new: NDArray[np.uint8]) -> Field:
        """The same, with fewer patches and fewer iterations."""
        return np.asarray(self._near.calc(old, new, np.zeros((*old.shape, 2), np.float32)))

    def check(self, old: NDArray[np.uint8], new: NDArray[np.uint8]) -> Field:
        """The fast preset's flow."""
        return np.asarray(self._check.calc(old, new, np.zeros((*old.shape, 2), np.float32)))


@dataclass(frozen=True)
class FlowBox:
    """Flow within a box of the picture whose upper left pixel is `corner` (2,)."""

    corner: Array
    field: Field

    def at(self, points: Array) -> Array:
        """Read the flow (N, 2) at `points` (N, 2) pixels of the picture; beyond the box as at its border."""
        return sampled(self.field, points - self.corner)


def box_around(points: Array, margin: float, size: tuple[int, int]) -> Region:
    """The box (u0, v0, u1, v1) of `points` (N, 2) with a margin [px], in a picture of `size` (width, height), never too small."""
    width, height = size
    u0, v0, u1, v1 = region_around(np.clip(points, 0, [width - 1, height - 1]), margin, size)
    u0, v0 = max(0, min(u0, width - SMALLEST)), max(0, min(v0, height - SMALLEST))
    return u0, v0, min(width, max(u1, u0 + SMALLEST)), min(height, max(v1, v0 + SMALLEST))


def cut_out(picture: NDArray[np.uint8], box: Region) -> NDArray[np.uint8]:
    """The part of a picture (H, W, ...) within `box`."""
    u0, v0, u1, v1 = box
    return np.ascontiguousarray(picture[v0:v1, u0:u1])


def sampled(field: NDArray[Any], points: Array) -> Array:
    """Bilinear read-out (N, ...) of a field (H, W, ...) at `points` (N, 2)."""
    if not len(points):
        return np.zeros((0, *field.shape[2:]))
    at = points.astype(np.float32)[None]
    read = cv2.remap(field, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0]
    return np.asarray(read, dtype=np.float64)
