"""The stereo endoscope over ROS: two eyes with separate grabbers, paired by their stamps, rectified here where the graph does not.

An image is shown as it comes; only pairs whose skew is small count as a frame, and only images of the calibration's size are taken: with
others, the newest pair grows old. An uncalibrated camera publishes intrinsics of zero and is refused. Images arrive on the transport's
threads; rectification is done where somebody looks. Thread-safe.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np

from hardware.codes import InputError
from hardware.dvrk.config import CameraConfig
from hardware.dvrk.messages import CameraInfo, Picture
from hardware.dvrk.telemetry import Received, Stream, TopicFigures
from hardware.dvrk.transport import Transport
from hardware.interface import Array, CameraModel, Frame, Image, StereoFrame

EYES = ("left", "right")
WAITING = 6  # images of one eye that wait for their partner
SQUARE = 0.01  # by how much fx and fy may differ, as a share
SOME = 9  # images of one eye by which its delay is judged
ROWS = 0.5  # [px] by which the eyes' principal points may differ in v


@dataclass(frozen=True)
class Pair:
    """Two images that belong together; `taken` [s] is the older one's instant."""

    sequence: int
    taken: float
    left: Picture
    right: Picture


class EndoscopeDVRK:
    """Implements `hardware.interface.Endoscope`. Without a good pair `left` and `stereo` raise RuntimeError; `stamp` is then -inf."""

    def __init__(self, transport: Transport, config: CameraConfig, prefix: str, epoch: float) -> None:
        self._config, self._epoch = config, epoch
        self._lock = threading.Lock()
        self._waiting: dict[str, deque[Received[Picture]]] = {eye: deque(maxlen=WAITING) for eye in EYES}
        self._pair: Pair | None = None
        self._unpaired = 0
        self._unfit = {eye: "" for eye in EYES}
        self._delays: dict[str, deque[float]] = {eye: deque(maxlen=SOME) for eye in EYES}  # [s], of receipt to stamp
        self._used: dict[str, CameraInfo] = {}  # what the model was made of
        self._shown: tuple[int, dict[str, Image]] = (-1, {})
        self._model: CameraModel | None = None
        self._maps: dict[str, tuple[Array, Array]] = {}
        name = "image_rect_color" if config.rectified else "image_raw"
        rig = f"{prefix}/{config.rig}"
        self._infos = {eye: Stream(transport, f"{rig}/{eye}/camera_info", CameraInfo, epoch) for eye in EYES}
        self._images = {eye: _Pictures(transport, f"{rig}/{eye}/{name}", epoch, partial(self._take, eye)) for eye in EYES}

    @property
    def camera(self) -> CameraModel:
        """Rectified intrinsics and baseline.

        Raises:
            InputError: the camera has not told its calibration, or is not calibrated.
        """
        if self._model is None:
            left, right = (self._info(eye) for eye in EYES)
            model = camera_model(left, right)
            if not self._config.rectified:
                self._maps = {"left": rectification(left), "right": rectification(right)}
            self._used = {"left": left, "right": right}
            self._model = model  # last: another thread that finds it finds the maps too
        return self._model

    def stamp(self) -> float:
        """Bench time [s] of the newest pair."""
        pair = self._pair
        return -np.inf if pair is None else pair.taken

    def left(self) -> Frame:
        """The left image of the newest pair, rectified."""
        pair = self._newest()
        return Frame(pair.sequence, pair.taken, self._rectified(pair, "left"))

    def stereo(self) -> StereoFrame:
        """The newest pair, rectified."""
        pair = self._newest()
        return StereoFrame(Frame(pair.sequence, pair.taken, self._rectified(pair, "left")), self._rectified(pair, "right"))

    def missing(self) -> list[str]:
        """Topics of the endoscope that nobody publishes."""
        topics: list[Stream[Any]] = [*self._images.values(), *self._infos.values()]
        return [topic.topic for topic in topics if topic.sources() == 0]

    def unfit(self) -> list[str]:
        """Why images are not used: their size is not that of the calibration. One sentence for each such eye."""
        return [said for said in self._unfit.values() if said]

    def changed(self) -> str:
        """Why what the cameras say of their calibration is not what this session sees by; "" while it is, and before the first look."""
        for eye, used in self._used.items():
            good = self._infos[eye].sample().good
            if good is None or good.message is used or _same_calibration(good.message, used):
                continue
            zero = not good.message.K.any()
            return f"the {eye} camera's calibration {'is gone (its K is zero)' if zero else 'is another one'} since the session began"
        return ""

    def apart(self) -> float:
        """By how much [s] the eyes' stamps differ where their images arrive together: then they are paired with the wrong ones."""
        with self._lock:
            delays = [list(self._delays[eye]) for eye in EYES]
        if min(map(len, delays)) < SOME:
            return 0.0
        return abs(float(np.median(delays[0])) - float(np.median(delays[1])))

    def figures(self) -> list[TopicFigures]:
        """How the images came in."""
        return [stream.figures() for stream in self._images.values()]

    @property
    def unpaired(self) -> int:
        """Images that found no partner within the skew allowed."""
        return self._unpaired

    # ------------------------------------------------------------ inside

    def _info(self, eye: str) -> CameraInfo:
        stream = self._infos[eye]
        good = stream.sample().good
        if good is None:
            raise InputError(f"the {eye} camera has not told its calibration on {stream.topic}; start the camera's node")
        return good.message

    def _take(self, eye: str, picture: Received[Picture]) -> None:
        """Pair an image with the other eye's nearest one; only what fits the calibration is a picture of anything."""
        with self._lock:
            self._delays[eye].append(picture.received - picture.message.stamp)
        try:
            model = self.camera
        except InputError:
            return  # whoever asks for the camera is told why
        height, width = picture.message.image.shape[:2]
        fits = (width, height) == (model.width, model.height)
        self._unfit[eye] = (
            ""
            if fits
            else f"the {eye} image is {width} x {height} pixels where its calibration says {model.width} x {model.height}"
        )
        if not fits:
            return
        other = "right" if eye == "left" else "left"
        stamp = picture.message.stamp
        with self._lock:
            waiting = self._waiting[other]
            partner = min(waiting, key=lambda one: abs(one.message.stamp - stamp), default=None)
            if partner is None or abs(partner.message.stamp - stamp) > self._config.max_skew:
                mine = self._waiting[eye]
                self._unpaired += len(mine) == mine.maxlen
                mine.append(picture)
                return
            newest = max(stamp, partner.message.stamp)
            for name, queue in self._waiting.items():  # what is older will find no partner any more
                kept = [one for one in queue if one.message.stamp > newest]
                self._unpaired += len(queue) - len(kept) - (name == other)
                self._waiting[name] = deque(kept, maxlen=WAITING)
            both = {eye: picture, other: partner}
            sequence = 0 if self._pair is None else self._pair.sequence + 1
            taken = min(picture.taken, partner.taken)
            self._pair = Pair(sequence, taken, both["left"].message, both["right"].message)

    def _newest(self) -> Pair:
        pair = self._pair
        if pair is None:
            raise RuntimeError("the endoscope has given no pair of images yet")
        return pair

    def _rectified(self, pair: Pair, eye: str) -> Image:
        with self._lock:
            sequence, images = self._shown
            if sequence != pair.sequence:
                images = {}
                self._shown = (pair.sequence, images)
            if eye not in images:
                image = pair.left.image if eye == "left" else pair.right.image
                if eye in self._maps:
                    image = np.asarray(cv2.remap(image, *self._maps[eye], cv2.INTER_LINEAR), dtype=np.uint8)
                images[eye] = image
            return images[eye]


class _Pictures(Stream[Picture]):
    """A stream of images that hands each good one on."""

    def __init__(self, transport: Transport, topic: str, epoch: float, give: Callable[[Received[Picture]], None]) -> None:
        self._give = give
        super().__init__(transport, topic, Picture, epoch, _picture_problem)

    def _take(self, message: Picture, received: float) -> None:
        super()._take(message, received)
        good = self.sample().good
        if good is not None and good.message is message:
            self._give(good)


def _picture_problem(message: Picture) -> str:
    image = message.image
    return "" if image.ndim == 3 and image.shape[2] == 3 and image.size else "it is no colour image"


def camera_model(left: CameraInfo, right: CameraInfo) -> CameraModel:
    """The rectified pair that two calibrations describe.

    Raises:
        InputError: an eye is not calibrated, or the two do not form a rectified pair; the sentence says what is wrong.
    """
    for eye, info in (("left", left), ("right", right)):
        if not (np.isfinite(info.K).all() and np.isfinite(info.P).all() and info.K[0, 0] > 0 and info.P[0, 0] > 0):
            raise InputError(f"the {eye} camera is not calibrated (its K or P is zero); calibrate the endoscope first")
        if abs(info.P[0, 0] - info.P[1, 1]) > SQUARE * info.P[0, 0]:
            raise InputError(
                f"the {eye} camera's pixels are not square after rectification: fx {info.P[0, 0]}, fy {info.P[1, 1]}"
            )
    focal, cu, cv = (float(left.P[0, 0]), float(left.P[0, 2]), float(left.P[1, 2]))
    if (
        abs(right.P[0, 0] - focal) > SQUARE * focal
        or abs(right.P[1, 2] - cv) > ROWS
        or (left.width, left.height)
        != (
            right.width,
            right.height,
        )
    ):
        raise InputError("the two cameras are not calibrated as one stereo pair: their P or sizes differ")
    if abs(right.P[0, 2] - cu) > ROWS:
        raise InputError("the eyes' principal points differ in u; calibrate the pair with zero disparity at infinity")
    baseline = -float(right.P[0, 3]) / focal
    if not 1e-3 < baseline < 0.05:
        raise InputError(
            f"the baseline by the right camera's P is {baseline * 1e3:.2f} mm; a stereo endoscope's lies from 1 to 50 mm"
        )
    return CameraModel(left.width, left.height, focal, cu, cv, baseline)


def _same_calibration(a: CameraInfo, b: CameraInfo) -> bool:
    return (a.width, a.height) == (b.width, b.height) and all(
        np.array_equal(getattr(a, name), getattr(b, name)) for name in ("D", "K", "R", "P")
    )


def rectification(info: CameraInfo) -> tuple[Array, Array]:
    """Maps (H, W) by which `cv2.remap` turns a raw image into a rectified one."""
    size = (info.width, info.height)
    distortion = info.D if info.D.size else np.zeros(5)
    first, second = cv2.initUndistortRectifyMap(info.K, distortion, info.R, info.P[:, :3], size, cv2.CV_32FC1)
    return np.asarray(first), np.asarray(second)
