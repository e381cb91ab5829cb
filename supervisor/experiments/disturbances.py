"""What makes looking hard: a tool before the goal, highlights, a dimmer light, motion blur, a rolled camera.

Those of the image are painted into what the skills get to see, both eyes alike, and drawn once for a case; the truth sees none of them.
The tool is the bench's own scissors; the rolled camera is a scene whose endoscope is turned about its own axis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import cv2
import numpy as np

from hardware.interface import Arm, Array, CameraModel, Endoscope, Frame, Image, StereoFrame
from hardware.stub.bench import StubBench
from hardware.stub.endoscope import FRAME_PERIOD
from hardware.stub.scene import Scene

LEFT, RIGHT = 0, 1  # eyes


class Disturbance(StrEnum):
    """Kinds of disturbances, in the order in which seeds take them."""

    NONE = "none"
    OCCLUSION = "occlusion"
    HIGHLIGHTS = "highlights"
    DIMMER = "dimmer"
    BLUR = "blur"
    ROTATION = "rotation"


class Painted(Protocol):
    """A disturbance of the image."""

    def painted(self, image: Image, eye: int, sequence: int, step: int) -> Image:
        """`image` (H, W, 3) uint8 RGB of `eye` in frame `sequence` as it looks disturbed, `step` steps into the pull."""
        ...


@dataclass(frozen=True)
class Blob:
    """A highlight that swings about `centre` (u, v) by `swing` (u, v) [px], once in `period` [s] from `phase` [rad] on.

    `radius` [px] is that of its soft edge along the image's axes, and `shift` [px] how much farther left the right eye sees it.
    """

    centre: tuple[float, float]
    swing: tuple[float, float]
    period: float
    phase: float
    radius: tuple[float, float]
    shift: float


@dataclass(frozen=True)
class Highlights:
    """A wet surface: what is bright shines `gloss` times stronger, and saturated blobs move about."""

    blobs: tuple[Blob, ...]
    gloss: float
    bright: float = 170.0  # [grey levels] from which a pixel shines

    def painted(self, image: Image, eye: int, sequence: int, step: int) -> Image:
        """Add light and saturate."""
        height, width = image.shape[:2]
        picture = image.astype(np.float32)
        least = picture.min(axis=2)
        light = self.gloss * np.maximum(least - self.bright, 0.0)
        time = sequence * FRAME_PERIOD
        for blob in self.blobs:
            turn = 2.0 * np.pi * time / blob.period + blob.phase
            u = blob.centre[0] + blob.swing[0] * np.sin(turn) - (blob.shift if eye == RIGHT else 0.0)
            v = blob.centre[1] + blob.swing[1] * np.cos(turn)
            across = np.exp(-0.5 * ((np.arange(width) - u) / blob.radius[0]) ** 2)
            down = np.exp(-0.5 * ((np.arange(height) - v) / blob.radius[1]) ** 2)
            # Twice the range of the sensor: saturated in the middle, soft at the edge.
            light += 510.0 * np.outer(down, across).astype(np.float32)
        return np.asarray(np.clip(picture + light[:, :, None], 0.0, 255.0), dtype=np.uint8)


@dataclass(frozen=True)
class Dimmer:
    """The light loses `lost` of its strength at step `from_step` of the pull and stays so."""

    from_step: int
    lost: float = 0.3

    def painted(self, image: Image, eye: int, sequence: int, step: int) -> Image:
        """Darken; the sensor's noise is darkened with it, as the camera's gain stays."""
        return image if step < self.from_step else np.asarray(cv2.convertScaleAbs(image, alpha=1.0 - self.lost), dtype=np.uint8)


@dataclass(frozen=True)
class MotionBlur:
    """A `share` of the frames is blurred along a line of `length` (least, most) [px] in any direction; `seed` says which and how."""

    seed: int
    share: float
    length: tuple[float, float]

    def painted(self, image: Image, eye: int, sequence: int, step: int) -> Image:
        """Blur this frame, or leave it as it is."""
        rng = np.random.default_rng([self.seed, 23, sequence])
        blurred, length, angle = rng.random() < self.share, rng.uniform(*self.length), rng.uniform(0.0, np.pi)
        if not blurred:
            return image
        return np.asarray(cv2.filter2D(image, -1, _line_kernel(length, angle), borderType=cv2.BORDER_REPLICATE), dtype=np.uint8)


@dataclass(frozen=True)
class Occlusion:
    """The scissors come into view above the share `at` of the goal, `height` [m] before it, and leave again or stay (None)."""

    at: float
    height: float
    from_step: int
    until_step: int | None


@dataclass(frozen=True)
class Roll:
    """The camera is turned about its own axis by `degrees` from the start."""

    degrees: float


Effect = Highlights | Dimmer | MotionBlur | Occlusion | Roll | None


@dataclass(frozen=True)
class RolledScene(Scene):
    """A scene whose endoscope, both eyes, is rolled by `roll` [rad] about its viewing direction."""

    roll: float = 0.0

    def camera_from_table(self) -> tuple[Array, Array]:
        """As the scene's own, then turned about the camera's z axis."""
        rotation, translation = super().camera_from_table()
        cos, sin = np.cos(self.roll), np.sin(self.roll)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return turn @ rotation, turn @ translation


class DisturbedEndoscope:
    """Implements `hardware.interface.Endoscope` over another one. A picture is painted once, however often it is asked for."""

    def __init__(self, beneath: Endoscope, painted: Painted | None) -> None:
        self._beneath = beneath
        self._painted = painted
        self._newest: dict[int, tuple[int, Image]] = {}
        self.step = 0  # steps of the pull that are done; whoever pulls keeps it up to date

    @property
    def camera(self) -> CameraModel:
        """As beneath."""
        return self._beneath.camera

    def stamp(self) -> float:
        """As beneath."""
        return self._beneath.stamp()

    def left(self) -> Frame:
        """The newest left frame, disturbed."""
        frame = self._beneath.left()
        return Frame(frame.sequence, frame.stamp, self._picture(frame.image, LEFT, frame.sequence))

    def stereo(self) -> StereoFrame:
        """The newest pair, disturbed."""
        pair = self._beneath.stereo()
        return StereoFrame(self.left(), self._picture(pair.right, RIGHT, pair.left.sequence))

    def _picture(self, image: Image, eye: int, sequence: int) -> Image:
        if self._painted is None:
            return image
        if eye not in self._newest or self._newest[eye][0] != sequence:
            self._newest[eye] = (sequence, self._painted.painted(image, eye, sequence, self.step))
        return self._newest[eye][1]


class DisturbedBench:
    """Implements `hardware.interface.Bench`: the bench beneath, seen through a disturbed endoscope."""

    def __init__(self, beneath: StubBench, effect: Effect) -> None:
        self._beneath = beneath
        painted = effect if isinstance(effect, Highlights | Dimmer | MotionBlur) else None
        self.endoscope = DisturbedEndoscope(beneath.endoscope, painted)

    @property
    def arms(self) -> Mapping[str, Arm]:
        """As beneath."""
        return self._beneath.arms

    def now(self) -> float:
        """As beneath."""
        return self._beneath.now()

    def advance(self, duration: float) -> None:
        """As beneath."""
        self._beneath.advance(duration)

    def observe(self, callback: Callable[[], None]) -> None:
        """As beneath."""
        self._beneath.observe(callback)

    def emergency_stop(self) -> bool:
        """As beneath."""
        return self._beneath.emergency_stop()

    def close(self) -> None:
        """As beneath."""
        self._beneath.close()


def _line_kernel(length: float, angle: float) -> Array:
    """A kernel (K, K) float64, sum 1: a line of `length` [px] through its middle, at `angle` [rad] from the image's u axis."""
    reach = int(np.ceil(length / 2)) + 1
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1))
    for t in np.linspace(-length / 2, length / 2, 8 * reach):
        u, v = reach + t * np.cos(angle), reach + t * np.sin(angle)
        i, j = int(v), int(u)
        a, b = v - i, u - j
        kernel[i : i + 2, j : j + 2] += np.outer([1 - a, a], [1 - b, b])
    return kernel / kernel.sum()
