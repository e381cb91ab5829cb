"""The stub's endoscope as two cameras on the graph: rgb8 images and their calibration, at a rate of their own.

Rendering takes longer than telemetry may wait. On a real graph a thread of its own renders what it is given, a frozen view of the bench,
and a picture that comes while it is at work is dropped, as a grabber would. In a test nothing is left to chance: it renders at once.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from hardware.dvrk.config import RobotConfig
from hardware.dvrk.messages import CameraInfo, Picture
from hardware.dvrk.transport import Transport
from hardware.interface import Array, CameraModel, StereoFrame
from hardware.served.faults import Fault, Faults
from hardware.stub.bench import StubBench
from hardware.stub.endoscope import FRAME_PERIOD, StubEndoscope
from hardware.stub.surface import SheetSurface, ToolShape

EYES = ("left", "right")
TOPICS = ("image_raw", "image_rect_color")  # the stub's pictures are rectified and without distortion: both show the same
SKEW = 0.05  # [s]
DISTORTION = "plumb_bob"


@dataclass(frozen=True)
class View:
    """The bench at one instant, as much of it as the renderer asks for; it looks like a `StubBench` to the endoscope."""

    bench: StubBench
    at: float
    tissue: SheetSurface
    instruments: Sequence[ToolShape]

    def now(self) -> float:
        """Bench time [s]."""
        return self.at

    def surface(self) -> SheetSurface:
        """The tissue, left camera frame."""
        return self.tissue

    def tools(self) -> Sequence[ToolShape]:
        """The instruments, left camera frame."""
        return self.instruments

    def to_camera(self, points: Array) -> Array:
        """Points (N, 3) [m] from the table frame."""
        return self.bench.to_camera(points)


class _Window:
    """What the rendering thread's endoscope looks at: the newest view."""

    def __init__(self, view: View) -> None:
        self.view = view

    def now(self) -> float:
        return self.view.now()

    def surface(self) -> SheetSurface:
        return self.view.surface()

    def tools(self) -> Sequence[ToolShape]:
        return self.view.tools()

    def to_camera(self, points: Array) -> Array:
        return self.view.to_camera(points)


class Pictures:
    """Publishes a pair at most `rate` times per second; `threaded`: renders in a thread of its own. `step` is called by one thread."""

    def __init__(
        self, bench: StubBench, transport: Transport, config: RobotConfig, faults: Faults, rate: float, threaded: bool
    ) -> None:
        self._bench, self._transport, self._faults = bench, transport, faults
        self._period = 1.0 / min(rate, 1.0 / FRAME_PERIOD)
        self._sent = 0
        rig = config.topic(config.camera.rig)
        self._frame = f"{config.camera.rig}_camera"
        self._images = {eye: [transport.publisher(f"{rig}/{eye}/{name}", Picture, queue=1) for name in TOPICS] for eye in EYES}
        self._infos = {eye: transport.publisher(f"{rig}/{eye}/camera_info", CameraInfo, queue=1) for eye in EYES}
        self._views: queue.Queue[tuple[View, float] | None] = queue.Queue()
        self._at_work = threading.Event()  # a view that waited its turn would be a late picture
        self._thread: threading.Thread | None = None
        if threaded:
            window = _Window(self._look())
            endoscope = StubEndoscope(bench.scene, bench.seed, cast(StubBench, window))
            endoscope.stereo()  # kernels compile here, before anybody waits
            self._thread = threading.Thread(target=self._render, args=(window, endoscope), name="stub camera", daemon=True)
            self._thread.start()

    def step(self, clock_offset: float) -> None:
        """Take a picture if one is due and somebody looks. `clock_offset` [s] is what the robot's clock is ahead."""
        number = int(self._bench.now() / self._period + 1e-6)
        if number == self._sent or self._faults.on(Fault.CAMERA_STOPPED):
            return
        self._sent = number
        stamp = self._transport.stamp() + clock_offset
        self._publish_infos(stamp)
        if not any(publisher.listeners() for publishers in self._images.values() for publisher in publishers):
            return
        if self._thread is None:
            self._publish(self._bench.endoscope.stereo(), stamp)
        elif not self._at_work.is_set():
            self._at_work.set()
            self._views.put((self._look(), stamp))

    def close(self) -> None:
        """End the thread."""
        if self._thread is not None:
            self._views.put(None)
            self._thread.join()
            self._thread = None

    # ------------------------------------------------------------ inside

    def _look(self) -> View:
        return View(self._bench, self._bench.now(), self._bench.surface(), self._bench.tools())

    def _render(self, window: _Window, endoscope: StubEndoscope) -> None:
        while (item := self._views.get()) is not None:
            window.view, stamp = item
            self._publish(endoscope.stereo(), stamp)
            self._at_work.clear()

    def _publish(self, frame: StereoFrame, stamp: float) -> None:
        skew = SKEW if self._faults.on(Fault.SKEWED_STAMPS) else 0.0
        for eye, image, at in (("left", frame.left.image, stamp), ("right", frame.right, stamp + skew)):
            if eye == "right" and self._faults.on(Fault.EYE_MISSING):
                continue
            for publisher in self._images[eye]:
                if publisher.listeners():
                    publisher.publish(Picture(at, self._frame, image))

    def _publish_infos(self, stamp: float) -> None:
        for eye, publisher in self._infos.items():
            if publisher.listeners() and not (eye == "right" and self._faults.on(Fault.EYE_MISSING)):
                publisher.publish(
                    camera_info(self._bench.endoscope.camera, eye, stamp, self._frame, self._faults.on(Fault.ZERO_K))
                )


def camera_info(camera: CameraModel, eye: str, stamp: float, frame_id: str, empty: bool = False) -> CameraInfo:
    """The calibration of one eye; `empty`: as a camera tells that was never calibrated, all zero."""
    k = np.array([[camera.focal, 0.0, camera.cu], [0.0, camera.focal, camera.cv], [0.0, 0.0, 1.0]])
    p = np.column_stack([k, [-camera.focal * camera.baseline if eye == "right" else 0.0, 0.0, 0.0]])
    d = np.zeros(5)
    if empty:
        k, p, d = np.zeros((3, 3)), np.zeros((3, 4)), np.zeros(0)
    return CameraInfo(stamp, frame_id, camera.width, camera.height, DISTORTION, d, k, np.eye(3), p)
