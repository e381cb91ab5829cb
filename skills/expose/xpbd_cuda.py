"""Buffers and the captured graph of the solver on a GPU (`xpbd_cuda_kernels`): one launch for each colour, one graph for a rollout."""

import itertools
from typing import Any

import numpy as np
import warp as wp

from hardware.interface import Array
from skills.expose import xpbd_cuda_kernels as kernels
from skills.expose.model import TissueModel
from skills.expose.xpbd_colours import Array32, Schedule
from skills.expose.xpbd_sheet import upload


class ColourForm:
    """One solver on a GPU; on the processor, where its launches are slow, it runs the same kernels without a graph."""

    def __init__(
        self, model: TissueModel, plan: Schedule, samples: int, horizon: int, *, substeps: int, iterations: int, device: str
    ) -> None:
        self._samples, self._horizon, self._vertices = samples, horizon, len(model.rest)
        self._substeps, self._iterations = substeps, iterations
        self._plan, self._floor, self._device = plan, model.floor is not None, device
        self._sheet = upload(model, plan, device)
        self._own = self._buffers()
        self._graph: Any = None
        wp.load_module(kernels, device=device)
        if wp.get_device(device).is_cuda:
            with wp.ScopedCapture(device=device) as capture:
                self._launch_all()
            self._graph = capture.graph

    def _buffers(self) -> Any:
        plan, samples, steps = self._plan, self._samples, self._horizon
        own: Any = kernels.Samples()
        for name, shape, dtype in (
            ("x", (self._vertices, samples), wp.vec3),
            ("controls", (steps, samples), wp.vec3),
            ("adhesion", (len(plan.anchored), samples), wp.float32),
            ("seam", (len(plan.seams), samples), wp.float32),
            ("edge_force", (len(plan.edges), samples), wp.float32),
            ("hinge_force", (len(plan.hinges), samples), wp.vec3),
            ("seam_force", (len(plan.seams), samples), wp.vec3),
            ("bed_force", (len(plan.anchored), samples), wp.vec3),
            ("trajectory", (steps, self._vertices, samples), wp.vec3),
            ("tension", (steps, samples), wp.float32),
            ("strain", (steps, samples), wp.float32),
        ):
            setattr(own, name, wp.zeros(shape, dtype=dtype, device=self._device))
        return own

    def _launch(self, kernel: Any, rows: int, *values: float) -> None:
        if rows:
            wp.launch(kernel, (rows, self._samples), [self._sheet, self._own, *values], device=self._device)

    def _launch_all(self) -> None:
        plan = self._plan
        coloured = (
            (kernels.project_edges, plan.edge_start),
            (kernels.project_hinges, plan.hinge_start),
            (kernels.project_seams, plan.seam_start),
        )
        for step in range(self._horizon):
            for _ in range(self._substeps):
                self._launch(kernels.predict, self._vertices, step, 1.0 / self._substeps)
                for iteration in range(self._iterations):
                    fresh = int(iteration == 0)
                    for kernel, start in coloured:
                        for first, end in itertools.pairwise(start.tolist()):
                            self._launch(kernel, end - first, first, fresh)
                    self._launch(kernels.project_adhesions, len(plan.anchored), fresh)
                    if self._floor:
                        self._launch(kernels.project_floor, self._vertices)
                self._launch(kernels.tear, len(plan.anchored))
            self._launch(kernels.record, self._vertices, step)
            wp.launch(kernels.measure_tension, self._samples, [self._sheet, self._own, step], device=self._device)
            self._launch(kernels.measure_strain, len(plan.watched), step)

    @property
    def trajectory(self) -> wp.array:
        """(h, V, K) of vec3."""
        return self._own.trajectory  # type: ignore[no-any-return]

    def run(self, positions: Array32, adhesion: Array32, seam: Array32, controls: Array32) -> None:
        """Roll out `controls` (K, h, 3) from `positions` (K or 1, V, 3), `adhesion` (K or 1, A) and `seam` (K or 1, S), both [N/m]."""
        for buffer, values in (
            (self._own.x, positions),
            (self._own.controls, controls),
            (self._own.adhesion, adhesion),
            (self._own.seam, seam),
        ):
            if buffer.size:
                rows = np.broadcast_to(values, (self._samples, *values.shape[1:]))
                buffer.assign(np.ascontiguousarray(np.swapaxes(rows, 0, 1)))
        if self._graph is None:
            self._launch_all()
        else:
            wp.capture_launch(self._graph)

    def positions(self) -> Array32:
        """Positions (h, K, V, 3) [m] after each step."""
        return np.ascontiguousarray(self._own.trajectory.numpy().transpose(0, 2, 1, 3))

    def last(self) -> Array32:
        """Positions (K, V, 3) [m] at the end."""
        return np.ascontiguousarray(self._own.x.numpy().transpose(1, 0, 2))

    def adhesion(self) -> Array32:
        """What is left (K, A) [N/m] of the adhesions at the end."""
        return np.ascontiguousarray(self._own.adhesion.numpy().T)

    def tension(self) -> Array:
        """Force (h, K) [N] on the jaws."""
        return self._own.tension.numpy().astype(np.float64)

    def strain(self) -> Array:
        """Largest strain (h, K)."""
        return self._own.strain.numpy().astype(np.float64)
