"""Newton's SolverXPBD, one world for each sample: springs and dihedral hinges, all projected at once (Jacobi, atomic sums)."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from benchmarks.peers.sheet import PULL, STIFFNESS, Floats, Load, PeerError, Sheet

HINGE = 0.01  # stiffness in Newton's own unit, as its hinge gradient is not divided by the triangle's height; 0.05 diverges
LEAST_AREA = 1e-6  # m^2, a hinge beside a triangle whose two edges span less is skipped by Newton


class NewtonRunner:
    """Quasi-static like ours: velocity is put to zero before each substep, which moves the grasped vertices."""

    name = "Newton SolverXPBD"
    scheme = "Jacobi"
    note = "float32; dihedral hinges with an arc tangent; damping terms at zero; one thread, as Warp has on a processor"

    def __init__(self, sheet: Sheet, load: Load, *, stiffness: float = STIFFNESS, hinges: bool = True) -> None:
        import newton

        one = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
        held = sheet.pinned | sheet.grasped
        one.add_particles(
            pos=[wp.vec3(*p) for p in sheet.rest.tolist()],
            vel=[wp.vec3()] * len(sheet.rest),
            mass=np.where(held, 0.0, 1.0).tolist(),
            radius=[0.0] * len(sheet.rest),
        )
        for i, j in sheet.edges.tolist():
            one.add_spring(i, j, stiffness, 0.0, 0.0)
        if hinges:
            columns = [column.tolist() for column in sheet.hinges.T]
            count = len(sheet.hinges)
            one.add_edges(*columns, rest=[0.0] * count, edge_ke=[HINGE] * count, edge_kd=[0.0] * count)
        batch = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
        batch.replicate(one, load.worlds)
        self._sheet, self._load = sheet, load
        self._model: Any = batch.finalize(device="cpu")
        self._model.particle_grid = None  # no contacts between vertices: no other side looks for them
        self._solver = newton.solvers.SolverXPBD(self._model, iterations=load.iterations)
        self._control = self._model.control()
        self._state, self._next = self._model.state(), self._model.state()
        self._start = self._model.particle_q.numpy().copy()
        self._grasped = np.flatnonzero(np.tile(sheet.grasped, load.worlds))

    def reset(self) -> None:
        """Flat and at rest."""
        for state in (self._state, self._next):
            state.particle_q.assign(self._start)
            state.particle_qd.zero_()

    def run(self) -> None:
        """Pull; on the CPU `numpy()` is a view."""
        for _ in range(self._load.steps * self._load.substeps):
            self._state.particle_q.numpy()[self._grasped] += (PULL / self._load.substeps).astype(np.float32)
            self._state.particle_qd.zero_()
            self._solver.step(self._state, self._next, self._control, None, 1.0)
            self._state, self._next = self._next, self._state

    def raw(self) -> Floats:
        """All worlds as they are, (worlds, V, 3) [m]."""
        return np.asarray(self._state.particle_q.numpy().reshape(self._load.worlds, -1, 3), dtype=np.float64)

    def positions(self) -> Floats:
        """All worlds, when no hinge was skipped on the way."""
        found = self.raw()
        a, b, c = np.moveaxis(found[:, self._sheet.triangles], 2, 0)
        least = np.linalg.norm(np.cross(b - a, c - a), axis=-1).min()
        if least < LEAST_AREA:
            raise PeerError(f"{self.name} skipped hinges: two edges of a triangle span {least:.2g} m^2 only.")
        return found
