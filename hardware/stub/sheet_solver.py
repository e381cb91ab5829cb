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

wp.config.log_level = wp.LOG_WARNING
wp.set_module_options({"enable_backward": False})

FloatArray = NDArray[np.float32]


@wp.func
def base_height(x: float, y: float, bump: wp.vec4) -> float:
    """Height [m] of the bed: a smooth bump (centre x, centre y, radius, height)."""
    dx = x - bump[0]
    dy = y - bump[1]
    r2 = (dx * dx + dy * dy) / (bump[2] * bump[2])
    h = float(0.0)
    if r2 < 1.0:
        h = bump[3] * (1.0 - r2) * (1.0 - r2)
    return h


@wp.kernel
def _advance(
    x: wp.array(dtype=wp.vec3),
    velocity: wp.array(dtype=wp.vec3),
    previous: wp.array(dtype=wp.vec3),
    inverse_mass: float,
    gravity: wp.array(dtype=wp.vec3),
    edges: wp.array2d(dtype=wp.int32),
    rest_length: wp.array(dtype=float),
    edge_compliance: wp.array(dtype=float),
    hinges: wp.array2d(dtype=wp.int32),
    hinge_weights: wp.array(dtype=wp.vec4),
    hinge_compliance: wp.array(dtype=float),
    anchor: wp.array(dtype=wp.vec3),
    adhesion: wp.array(dtype=float),
    adhesion_limit: wp.array(dtype=float),
    seams: wp.array2d(dtype=wp.int32),
    seam_stiffness: wp.array(dtype=float),
    grip_vertex: wp.array(dtype=wp.int32),
    grip_from: wp.array(dtype=wp.vec3),
    grip_to: wp.array(dtype=wp.vec3),
    grip_stiffness: float,
    bump: wp.vec4,
    clearance: float,
    friction: float,
    dt: float,
    damping: float,
    substeps: int,
):
    vertices = x.shape[0]
    w = inverse_mass
    dt2 = dt * dt
    for s in range(substeps):
        for i in range(vertices):
            p = x[i]
            v = velocity[i] + dt * gravity[i]
            previous[i] = p
            x[i] = p + dt * v
        fraction = float(s + 1) / float(substeps)
        for g in range(grip_vertex.shape[0]):
            i = grip_vertex[g]
            target = grip_from[g] + fraction * (grip_to[g] - grip_from[g])
            alpha = 1.0 / (grip_stiffness * dt2)
            x[i] = x[i] + (target - x[i]) * (w / (w + alpha))
        for e in range(edges.shape[0]):
            a = edges[e, 0]
            b = edges[e, 1]
            d = x[a] - x[b]
            length = wp.length(d)
            if length > 1.0e-9:
                step = (rest_length[e] - length) / (2.0 * w + edge_compliance[e] / dt2)
                c = d * (w * step / length)
                x[a] = x[a] + c
                x[b] = x[b] - c
        for h in range(hinges.shape[0]):
            i0 = hinges[h, 0]
            i1 = hinges[h, 1]
            i2 = hinges[h, 2]
            i3 = hinges[h, 3]
            k = hinge_weights[h]
            c3 = k[0] * x[i0] + k[1] * x[i1] + k[2] * x[i2] + k[3] * x[i3]
            step3 = c3 * (-w / (w * wp.dot(k, k) + hinge_compliance[h] / dt2))
            x[i0] = x[i0] + k[0] * step3
            x[i1] = x[i1] + k[1] * step3
            x[i2] = x[i2] + k[2] * step3
            x[i3] = x[i3] + k[3] * step3
        for m in range(seams.shape[0]):
            if seam_stiffness[m] > 0.0:
                a = seams[m, 0]
                b = seams[m, 1]
                c = (x[a] - x[b]) * (w / (2.0 * w + 1.0 / (seam_stiffness[m] * dt2)))
                x[a] = x[a] - c
                x[b] = x[b] + c
        for i in range(vertices):
            k1 = adhesion[i]
            if k1 > 0.0:
                d = anchor[i] - x[i]
                if wp.length(d) > adhesion_limit[i]:
                    adhesion[i] = 0.0
                else:
                    x[i] = x[i] + d * (w / (w + 1.0 / (k1 * dt2)))
            p = x[i]
            floor = base_height(p[0], p[1], bump) + clearance
            if p[2] < floor:
                # Contact is a projection; sliding on the bed is damped.
                q = previous[i]
                x[i] = wp.vec3(p[0] + friction * (q[0] - p[0]), p[1] + friction * (q[1] - p[1]), floor)
            velocity[i] = (x[i] - previous[i]) * (damping / dt)


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
        wp.launch(_advance, dim=1, inputs=inputs, device="cpu")


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
