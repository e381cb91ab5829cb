"""The simulated stereo endoscope: a new frame every 1/30 s of bench time, rendered only when somebody looks."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hardware.codes import InputError
from hardware.interface import Frame, StereoFrame
from hardware.stub.renderer import Look, Renderer, Rendering
from hardware.stub.scene import Scene
from hardware.stub.sheet_solver import bed_height
from hardware.stub.surface import BaseSurface

if TYPE_CHECKING:
    from hardware.stub.bench import StubBench

FRAME_PERIOD = 1.0 / 30.0  # [s]
BED_CELL = 2e-3  # [m]


class StubEndoscope:
    """Looks at a `StubBench`. A picture is fixed once per frame period, however often it is asked for."""

    def __init__(self, scene: Scene, seed: int, bench: StubBench) -> None:
        self.camera = scene.camera_model()
        self._bench = bench
        tissue = scene.tissue
        look = Look(material=tissue.material, seed=seed, size=(tissue.width, tissue.height), noise=scene.camera.noise)
        self._renderer = Renderer(look, self.camera, _bed(scene, bench))
        self._left: tuple[int, Rendering] | None = None
        self._right: tuple[int, Rendering] | None = None
        self._fault = ""
        self._stopped_at = 0

    def stamp(self) -> float:
        """Bench time [s] of the newest frame."""
        return self._sequence() * FRAME_PERIOD

    def left(self) -> Frame:
        """The newest left frame."""
        rendering = self.rendering()
        return Frame(self._sequence(), self.stamp(), rendering.image)

    def stereo(self) -> StereoFrame:
        """The newest pair."""
        sequence = self._sequence()
        if self._right is None or self._right[0] != sequence:
            if self._left is None or self._left[0] != sequence:
                left, right = self._renderer.render_pair(self._bench.surface(), self._bench.tools(), sequence)
                self._left = (sequence, left)
            else:
                right = self._renderer.render(self._bench.surface(), self._bench.tools(), sequence, eye=1)
            self._right = (sequence, right)
        return StereoFrame(self.left(), self._right[1].image)

    def rendering(self) -> Rendering:
        """The newest left frame with depth, labels and triangles: truth, for experiments and tests only."""
        sequence = self._sequence()
        if self._left is None or self._left[0] != sequence:
            self._left = (sequence, self._renderer.render(self._bench.surface(), self._bench.tools(), sequence))
        return self._left[1]

    def inject(self, fault: str) -> None:
        """Command `stale` (no new frames), or `clear`."""
        if fault not in ("stale", "clear"):
            raise InputError(f"the endoscope knows the faults stale and clear, not {fault!r}")
        self._stopped_at = self._sequence()
        self._fault = "" if fault == "clear" else fault

    def _sequence(self) -> int:
        if self._fault == "stale":
            return self._stopped_at
        return int(self._bench.now() / FRAME_PERIOD + 1e-6)


def _bed(scene: Scene, bench: StubBench) -> BaseSurface:
    """The bed as a regular grid, half as large again as the sheet."""
    half = 0.75 * np.array([scene.tissue.width, scene.tissue.height])
    nu, nv = (np.ceil(2 * half / BED_CELL)).astype(int) + 1
    u, v = np.meshgrid(np.linspace(-half[0], half[0], nu), np.linspace(-half[1], half[1], nv))
    xy = np.column_stack([u.ravel(), v.ravel()])
    points = bench.to_camera(np.column_stack([xy, bed_height(xy, scene.bump)]))
    corner = (np.arange(nv - 1)[:, None] * nu + np.arange(nu - 1)[None]).ravel()
    triangles = np.concatenate(
        [np.column_stack([corner, corner + 1, corner + nu + 1]), np.column_stack([corner, corner + nu + 1, corner + nu])]
    )
    return BaseSurface(points.astype(np.float32), triangles.astype(np.int32), xy.astype(np.float32))
