"""The sheet's physics: XPBD (Macklin et al. 2016) with one Gauss-Seidel sweep per substep, one Warp launch per physics step.

Masses are numerical, not real: with real ones, one sweep per substep caps the stiffness at about m/dt^2, far below the tissue's, and the
forces come out wrong by an order of magnitude. The mass of each vertex is chosen so that m/dt^2 exceeds the stretch stiffness, and
gravity acts with the real weight. What is simulated is therefore quasi-static, which is what slow retraction is.
"""

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from hardware.interface import Array
from hardware.stub.sheet_kernels import advance_sheet

FloatArray = NDArray[np.float32]


@dataclass
class SolverState:
    """What changes while the sheet moves: `x`, `velocity` (V, 3) float32 [m], [m/s]; `adhesion` (V,) float32 [N/m], 0 once broken."""

    x: FloatArray
    velocity: FloatArray
    adhesion: FloatArray


@dataclass(frozen=True)
class SolverModel:
    """What stays until the next cut, all float32/int32: constraints, compliances, anchors and gravity accelerations."""

    edges: NDArray[np.int32]
    rest_length: FloatArray
    edge_compliance: FloatArray
    hinges: NDArray[np.int32]
    hinge_weights: FloatArray
    hinge_compliance: FloatArray
    anchor: FloatArray
    adhesion_limit: FloatArray
    seams: NDArray[np.int32]
    seam_stiffness: FloatArray
    gravity: FloatArray
    mass: float
    grip_stiffness: float
    bump: tuple[float, float, float, float]
    clearance: float


class SheetSolver:
    """Advances one sheet. The arrays given are shared with Warp, not copied: the state changes in place."""

    def __init__(self, model: SolverModel, state: SolverState) -> None:
        self.model = model
        self.state = state
        self._previous = np.zeros_like(state.x)
        vec3, vec4 = wp.vec3, wp.vec4
        self._arrays = [
            _shared(state.x, vec3),
            _shared(state.velocity, vec3),
            _shared(self._previous, vec3),
            1.0 / model.mass,
            _shared(model.gravity, vec3),
            _shared(model.edges, wp.int32),
            _shared(model.rest_length, wp.float32),
            _shared(model.edge_compliance, wp.float32),
            _shared(model.hinges, wp.int32),
            _shared(model.hinge_weights, vec4),
            _shared(model.hinge_compliance, wp.float32),
            _shared(model.anchor, vec3),
            _shared(state.adhesion, wp.float32),
            _shared(model.adhesion_limit, wp.float32),
            _shared(model.seams, wp.int32),
            _shared(model.seam_stiffness, wp.float32),
        ]

    def advance(
        self, grip_vertex: NDArray[np.int32], grip_from: FloatArray, grip_to: FloatArray, dt: float, substeps: int, damping: float
    ) -> None:
        """One physics step of `substeps` x `dt` [s]; gripped vertices follow targets that go from `grip_from` to `grip_to` (G, 3)."""
        model = self.model
        inputs = [
            *self._arrays,
            _shared(grip_vertex, wp.int32),
            _shared(np.ascontiguousarray(grip_from, np.float32), wp.vec3),
            _shared(np.ascontiguousarray(grip_to, np.float32), wp.vec3),
            model.grip_stiffness,
            wp.vec4(*model.bump),
            model.clearance,
            0.2,
            dt,
            damping,
            substeps,
        ]
        wp.launch(advance_sheet, dim=1, inputs=inputs, device="cpu")


def bed_height(xy: Array, bump: tuple[float, float, float, float]) -> Array:
    """Height (N,) [m] of the bed at `xy` (N, 2) [m], table frame; the same formula as the kernel's."""
    r2 = ((np.asarray(xy) - np.array(bump[:2])) ** 2).sum(axis=-1) / bump[2] ** 2
    return np.asarray(np.where(r2 < 1.0, bump[3] * (1.0 - r2) ** 2, 0.0))


def _shared(values: NDArray, dtype: type) -> wp.array:
    """A Warp view on a numpy array (empty arrays get one unused row where Warp needs a pointer)."""
    if values.size == 0:
        shape = (0, *values.shape[1:]) if dtype in (wp.int32, wp.float32) else (0,)
        return wp.zeros(shape, dtype=dtype, device="cpu")
    return wp.array(values, dtype=dtype, device="cpu", copy=False)
