"""pytorch-mppi over a tissue written for torch: all samples and all constraints at once (Jacobi, sums as in Newton)."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import scipy.sparse

from benchmarks.peers.sheet import BENDING, PULL, STIFFNESS, Floats, Load, Sheet


class TorchTissue:
    """XPBD with multipliers on float32 tensors (V, 3 K).

    Differences along edges and weighted sums of hinges are one sparse matrix A, their gathering at the vertices its transpose: six
    times as fast as `index_select` and `index_add_` on the same tensors.
    """

    def __init__(self, sheet: Sheet, load: Load) -> None:
        import torch

        self._torch, self._load, self._count, self._split = torch, load, len(sheet.rest), len(sheet.edges)
        free = ~(sheet.pinned | sheet.grasped)
        edges, hinges = np.arange(len(sheet.edges)), np.arange(len(sheet.hinges))
        shape = (len(edges), self._count)
        ends = scipy.sparse.coo_matrix((np.ones(len(edges)), (edges, sheet.edges[:, 0])), shape)
        ends = ends - scipy.sparse.coo_matrix((np.ones(len(edges)), (edges, sheet.edges[:, 1])), shape)
        corners = (np.repeat(hinges, 4), sheet.hinges.ravel())
        bends = scipy.sparse.coo_matrix((sheet.hinge_weights.ravel(), corners), (len(hinges), self._count))
        gather = scipy.sparse.vstack([ends, bends])
        self._gather, self._scatter = self._sparse(gather), self._sparse(scipy.sparse.diags(free.astype(float)) @ gather.T)
        gain = abs(gather).power(2) @ free + np.where(np.arange(sheet.constraints) < len(edges), 1.0 / STIFFNESS, 1.0 / BENDING)
        self._gain = torch.tensor(1.0 / gain, dtype=torch.float32)[:, None, None]
        self._length = torch.tensor(sheet.rest_length, dtype=torch.float32)[:, None, None]
        self._grasped = torch.tensor(np.flatnonzero(sheet.grasped))

    def _sparse(self, matrix: Any) -> Any:
        rows = matrix.tocsr()
        parts: list[Any] = [rows.indptr.astype(np.int64), rows.indices.astype(np.int64), rows.data.astype(np.float32)]
        starts, columns, values = (self._torch.tensor(part) for part in parts)
        with warnings.catch_warnings():  # torch calls its sparse rows a beta
            warnings.simplefilter("ignore")
            return self._torch.sparse_csr_tensor(starts, columns, values, size=list(rows.shape))

    def step(self, state: Any, control: Any) -> Any:
        """One step of the tissue: `state` (K, 3 V), `control` (K, 3)."""
        torch, samples, split = self._torch, len(state), self._split
        x = state.view(samples, self._count, 3).permute(1, 2, 0).reshape(self._count, -1)
        for _ in range(self._load.substeps):
            x.view(self._count, 3, samples)[self._grasped] += control.T / self._load.substeps
            force = torch.zeros(split, 1, samples)
            turning = torch.zeros(len(self._gain) - split, 3, samples)
            for _ in range(self._load.iterations):
                both = (self._gather @ x).view(-1, 3, samples)
                apart, bent = both[:split], both[split:]
                length = (apart * apart).sum(1, keepdim=True).sqrt_()
                change = (self._length - length - force / STIFFNESS) * self._gain[:split]
                force += change
                apart *= change / length
                bent.add_(turning, alpha=1.0 / BENDING).mul_(-self._gain[split:])
                turning += bent
                x = x + self._scatter @ both.view(-1, 3 * samples)
        return x.view(self._count, 3, samples).permute(2, 0, 1).reshape(samples, -1)


class TorchMppiRunner:
    """One command of the controller: sampling, rollouts, a cost of one line, and the update."""

    name = "pytorch-mppi + torch"
    scheme = "Jacobi"
    note = "float32; isometric hinges; also samples, sums costs and averages; threads in every operation"

    def __init__(self, sheet: Sheet, load: Load, *, threads: int, seed: int = 1) -> None:
        import torch
        from pytorch_mppi import MPPI

        torch.set_num_threads(threads)
        self._torch, self._seed = torch, seed
        tissue = TorchTissue(sheet, load)
        self._start = torch.tensor(sheet.rest, dtype=torch.float32).reshape(-1)
        grasp = 3 * int(np.flatnonzero(sheet.grasped)[0])
        self._last: Any = None

        def dynamics(state: Any, control: Any) -> Any:
            self._last = tissue.step(state, control)
            return self._last

        self._controller = MPPI(
            dynamics,
            lambda state, control: -state[:, grasp],
            self._start.numel(),
            torch.eye(3) * (0.1e-3) ** 2,
            num_samples=load.worlds,
            horizon=load.steps,
            device="cpu",
            lambda_=1e-4,
        )
        self._plan = torch.tensor(np.tile(PULL, (load.steps, 1)), dtype=torch.float32)

    def reset(self) -> None:
        """The same plan and the same samples each time."""
        self._torch.manual_seed(self._seed)
        self._controller.U = self._plan.clone()

    def run(self) -> None:
        """One update around the pull."""
        with self._torch.inference_mode():
            self._controller.command(self._start, shift_nominal_trajectory=False)

    def positions(self) -> Floats:
        """Where the samples ended."""
        return np.asarray(self._last.numpy().reshape(len(self._last), -1, 3).astype(np.float64))
