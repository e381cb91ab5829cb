"""Buffers and threads of the solver on a processor (`xpbd_kernels`): one Python thread for each core, on its own blocks of samples."""

import itertools
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import warp as wp

from hardware.interface import Array
from skills.expose import xpbd_kernels
from skills.expose.model import TissueModel
from skills.expose.xpbd_colours import Array32, Schedule
from skills.expose.xpbd_kernels import LANES, Blocks, lanes, points, rollout
from skills.expose.xpbd_sheet import upload


class BlockForm:
    """One solver on the processor. One caller at a time.

    A launch runs in the calling thread and releases the interpreter's lock, so threads run beside each other. How the blocks are shared
    out changes nothing in the results.
    """

    def __init__(
        self, model: TissueModel, plan: Schedule, samples: int, horizon: int, *, substeps: int, iterations: int, threads: int
    ) -> None:
        _load_kernels()
        self._samples, self._horizon, self._vertices = samples, horizon, len(model.rest)
        self._plan = plan
        self._blocks = -(-samples // LANES)
        self._sheet = upload(model, plan, "cpu")
        self._own = self._buffers()
        threads = max(1, min(threads, self._blocks))
        bounds = [self._blocks * k // threads for k in range(threads + 1)]
        self._parts: list[Any] = [
            wp.launch(rollout, end - first, [self._sheet, self._own, first, substeps, iterations], device="cpu", record_cmd=True)
            for first, end in itertools.pairwise(bounds)
        ]
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="xpbd") if threads > 1 else None

    def _buffers(self) -> Any:
        plan, blocks, steps = self._plan, self._blocks, self._horizon
        own: Any = Blocks()
        for name, shape, dtype in (
            ("x", (blocks, self._vertices), points),
            ("controls", (blocks, steps), points),
            ("adhesion", (blocks, len(plan.anchored)), lanes),
            ("seam", (blocks, len(plan.seams)), lanes),
            ("edge_force", (blocks, len(plan.edges)), lanes),
            ("hinge_force", (blocks, len(plan.hinges)), points),
            ("seam_force", (blocks, len(plan.seams)), points),
            ("bed_force", (blocks, len(plan.anchored)), points),
            ("trajectory", (steps, blocks, self._vertices), points),
            ("tension", (steps, blocks), lanes),
            ("strain", (steps, blocks), lanes),
        ):
            setattr(own, name, wp.zeros(shape, dtype=dtype, device="cpu"))
        return own

    @property
    def trajectory(self) -> wp.array:
        """(h, K / 8, V) of 3x8 matrices: column j of block b is sample 8 b + j."""
        return self._own.trajectory  # type: ignore[no-any-return]

    def run(self, positions: Array32, adhesion: Array32, seam: Array32, controls: Array32) -> None:
        """Roll out `controls` (K, h, 3) from `positions` (K or 1, V, 3), `adhesion` (K or 1, A) and `seam` (K or 1, S), both [N/m]."""
        self._put(self._own.x, positions)
        self._put(self._own.controls, controls)
        self._put(self._own.adhesion, adhesion[..., None])
        self._put(self._own.seam, seam[..., None])
        if self._pool is None:
            self._parts[0].launch()
        else:
            for running in [self._pool.submit(part.launch) for part in self._parts]:
                running.result()

    def _put(self, buffer: wp.array, values: Array32) -> None:
        """Write `values` (K or 1, N, c) to blocks (B, N) of c x 8; copies of the last sample fill the last block."""
        rows = np.minimum(np.arange(self._blocks * LANES), len(values) - 1)
        blocked = values[rows].reshape(self._blocks, LANES, *values.shape[1:]).transpose(0, 2, 3, 1)
        target = buffer.numpy()
        target[...] = blocked.reshape(target.shape)

    def positions(self) -> Array32:
        """Positions (h, K, V, 3) [m] after each step."""
        blocked = self._own.trajectory.numpy().transpose(0, 1, 4, 2, 3)
        return np.ascontiguousarray(blocked.reshape(self._horizon, -1, self._vertices, 3)[:, : self._samples])

    def last(self) -> Array32:
        """Positions (K, V, 3) [m] at the end."""
        blocked = self._own.x.numpy().transpose(0, 3, 1, 2)
        return np.ascontiguousarray(blocked.reshape(-1, self._vertices, 3)[: self._samples])

    def adhesion(self) -> Array32:
        """What is left (K, A) [N/m] of the adhesions at the end."""
        blocked = self._own.adhesion.numpy().transpose(0, 2, 1)
        return np.ascontiguousarray(blocked.reshape(self._blocks * LANES, -1)[: self._samples])

    def tension(self) -> Array:
        """Force (h, K) [N] on the jaws."""
        return self._own.tension.numpy().reshape(self._horizon, -1)[:, : self._samples].astype(np.float64)

    def strain(self) -> Array:
        """Largest strain (h, K)."""
        return self._own.strain.numpy().reshape(self._horizon, -1)[:, : self._samples].astype(np.float64)


def _load_kernels() -> None:
    """Compile, or take from the cache, before threads launch; for a plain processor where this one's own instructions are refused."""
    try:
        wp.load_module(xpbd_kernels, device="cpu")
    except Exception:  # Warp raises no narrower one when a build fails
        wp.set_module_options({"cpu_compiler_flags": ""}, xpbd_kernels)
        wp.load_module(xpbd_kernels, device="cpu")
