"""Batched quasi-static XPBD: many samples of the tissue, each pulled its own way, in one call (x_{t+1} = f_xpbd(x_t, u_t)).

There is no velocity. In each horizon step the grasped patch moves by its control in `substeps` equal parts. In each substep the
multipliers start at 0, external forces move the vertices that are free (x + f / inertia), `iterations` Gauss-Seidel sweeps go over
edges, hinges, seams, adhesions and the floor, and then adhesions beyond their limit break for good. Grasped and pinned vertices are
not moved by any constraint, the floor included: keeping the jaws out of the bed is the caller's part.

A substep, swept to its end, minimises potential energy + inertia / 2 |x - x before|^2: a step of implicit gradient flow.
"""

import os
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from hardware.codes import InputError
from hardware.interface import Array
from skills.expose.model import TissueModel
from skills.expose.xpbd_blocks import BlockForm
from skills.expose.xpbd_colours import Array32, schedule
from skills.expose.xpbd_cuda import ColourForm
from skills.expose.xpbd_kernels import LANES

BLOCK = LANES


@dataclass(frozen=True)
class XpbdConfig:
    """How hard the solver tries.

    `inertia` trades two errors. Where it is large, free tissue lags behind the jaws, and the springs in between overstate the force;
    where it is small, ten sweeps do not bring a substep to its end, and edges beside the jaws stay overstretched. Against static
    equilibrium (13 to 31 vertices a side, goal severed, one strand or joined, 4 to 15 mm in steps of 0.5 mm, 2 x 10 sweeps) positions
    are best at 0.1 to 0.3: 0.1 to 0.3 mm root mean square, the force 0 to 40 % too high, most of it in the first steps. At 1 the error
    is 2 to 4 times that, at 4 the force is up to 4 times too large. In units of the edges' stiffness, so that motion does not depend
    on how stiff the tissue is.
    """

    substeps: int = 2
    iterations: int = 10
    inertia: float = 0.2  # m / dt^2 of a vertex, in stiffnesses of the median edge

    def __post_init__(self) -> None:
        """Refuse what cannot run."""
        if self.substeps < 1 or self.iterations < 1:
            raise InputError(f"substeps ({self.substeps}) and iterations ({self.iterations}) must be at least 1")
        if not (np.isfinite(self.inertia) and self.inertia > 0.0):
            raise InputError(f"inertia is {self.inertia}, but must be finite and above 0")

    def newtons_per_metre(self, model: TissueModel) -> float:
        """The inertia [N/m] of a vertex of `model`."""
        return self.inertia / float(np.median(model.edge_compliance))


@dataclass(frozen=True)
class State:
    """Where the tissue is and what still holds it, float32; one row for each sample, or one for all."""

    positions: Array32  # (K or 1, V, 3) [m]
    adhesion: Array32  # (K or 1, V) [N/m] what is left of each adhesion
    joined: Array32  # (K or 1, S) 0..1, share of each seam that holds


def rest_state(model: TissueModel, joined: ArrayLike = 1.0) -> State:
    """The model at rest, with `joined` (S,) or one share for all seams."""
    share = np.broadcast_to(np.asarray(joined, dtype=np.float32), (len(model.seams),))
    return State(model.rest[None].astype(np.float32), model.adhesion[None].astype(np.float32), share[None].copy())


class XpbdSolver:
    """Rolls out one model for `samples` control sequences of `horizon` steps. Everything is made once; not for two threads at once."""

    def __init__(
        self,
        model: TissueModel,
        samples: int,
        horizon: int,
        config: XpbdConfig | None = None,
        device: str = "cpu",
        threads: int | None = None,
    ) -> None:
        if samples < 1 or horizon < 1:
            raise InputError(f"samples ({samples}) and horizon ({horizon}) must be at least 1")
        if threads is not None and threads < 1:
            raise InputError(f"threads is {threads}, but must be at least 1")
        self.model = model
        self.samples = samples
        self.horizon = horizon
        self.config = config or XpbdConfig()
        self.device = choose_device(device)
        self._runs = 0
        plan = schedule(model, self.config.newtons_per_metre(model))
        self._plan = plan
        substeps, iterations = self.config.substeps, self.config.iterations
        self._form: BlockForm | ColourForm
        if self.device == "cpu":
            threads = threads or os.cpu_count() or 1
            self._form = BlockForm(model, plan, samples, horizon, substeps=substeps, iterations=iterations, threads=threads)
        else:
            self._form = ColourForm(model, plan, samples, horizon, substeps=substeps, iterations=iterations, device=self.device)

    def rollout(self, state: State, controls: ArrayLike) -> "Rollout":
        """Move the grasped patch by `controls` (K, h, 3) [m], left camera frame, from `state`."""
        u = np.asarray(controls, dtype=np.float32)
        if u.shape != (self.samples, self.horizon, 3):
            raise ValueError(f"controls have shape {u.shape}, but this solver takes {(self.samples, self.horizon, 3)}")
        if not np.isfinite(u).all():
            raise ValueError("controls hold numbers that are not finite")
        vertices, seams = len(self.model.rest), len(self.model.seams)
        for name, rows in (("positions", (vertices, 3)), ("adhesion", (vertices,)), ("joined", (seams,))):
            array = getattr(state, name)
            if array.shape[1:] != rows or len(array) not in (1, self.samples):
                raise ValueError(f"the state's {name} have shape {array.shape}, but {(self.samples, *rows)} or {(1, *rows)} fits")
            if not np.isfinite(array).all():
                raise ValueError(f"the state's {name} hold numbers that are not finite")
        if (state.joined < 0.0).any() or (state.joined > 1.0).any():
            raise ValueError("the state's joined must lie in 0..1")
        if (state.adhesion < 0.0).any():
            raise ValueError("the state's adhesion must be at least 0")
        self._runs += 1
        seam = (state.joined[:, self._plan.seam_of] * self._plan.seam_stiffness).astype(np.float32)
        self._form.run(state.positions, state.adhesion[:, self._plan.anchored], seam, u)
        return Rollout(self._form.trajectory, self._form.tension(), self._form.strain(), state.joined, self, self._runs)

    def _positions(self, run: int) -> Array32:
        self._fresh(run)
        return self._form.positions()

    def _final(self, run: int, joined: Array32) -> State:
        self._fresh(run)
        adhesion = np.tile(self.model.adhesion.astype(np.float32), (self.samples, 1))
        adhesion[:, self._plan.anchored] = self._form.adhesion()
        return State(self._form.last(), adhesion, np.array(np.broadcast_to(joined, (self.samples, joined.shape[1]))))

    def _fresh(self, run: int) -> None:
        if run != self._runs:
            raise RuntimeError("a later rollout of the same solver has overwritten this one: read what you need before it")


@dataclass(frozen=True)
class Rollout:
    """What a rollout gives. The trajectory lies in the solver's buffer: it is gone once the solver rolls out again."""

    trajectory: wp.array  # cpu: (h, K / 8, V) of 3x8 float32, column j of block b is sample 8 b + j; cuda: (h, V, K) of vec3
    # What edges, hinges and seams between grasped and other vertices exert as they are stretched, stiffness x distance, summed: in
    # equilibrium the slope of the potential energy. The multipliers give 3 to 8 % less, as ten sweeps do not bring them to their end;
    # a limit on tension is better met early than late.
    tension: Array  # (h, K) [N] force on the grasped patch
    strain: Array  # (h, K) largest relative lengthening of an edge that does not touch the grasped patch
    joined: Array32  # (K or 1, S)
    solver: XpbdSolver
    run: int

    def positions(self) -> Array32:
        """Every vertex after every step, (h, K, V, 3) [m]."""
        return self.solver._positions(self.run)

    def final(self) -> State:
        """The state after the last step, K samples."""
        return self.solver._final(self.run, self.joined)


def choose_device(name: str) -> str:
    """The Warp device for `name`: "auto" is the first GPU if there is one, else the processor."""
    present = ["cpu", *(device.alias for device in wp.get_cuda_devices())]
    if name == "auto":
        return present[min(1, len(present) - 1)]
    if name == "cuda" and len(present) > 1:
        return present[1]
    if name not in present:
        raise InputError(f"there is no device {name!r} here; there is {', '.join(present)} (or auto)")
    return name
