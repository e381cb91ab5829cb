"""The PositionBasedDynamics library: XPBD distance and isometric bending constraints, float64, coloured, OpenMP over each colour.

It knows no batches: a few worlds in one model are simulated again and again until the load is done. Its gravity cannot be switched
off from Python; the time step is so short that it moves nothing.
"""

from __future__ import annotations

import numpy as np

from benchmarks.peers.sheet import PULL, SPACING, STIFFNESS, Floats, Load, Sheet

WORLDS = 4  # in one model: enough work for its threads, and still in the cache
PERIOD = 1e-3  # s of a step
HINGE = (
    1e3  # N/m: the bending that `STIFFNESS` gives where the energy is half the square of a vector, about; free of effect on time
)


class PypbdRunner:
    """Sets the grasped particles before each substep; they have no mass."""

    name = "pypbd"
    scheme = "Gauss-Seidel"
    note = (
        "float64; isometric hinges as one scalar; velocities and a little gravity; threads over each colour of 4 worlds at a time"
    )

    def __init__(self, sheet: Sheet, load: Load) -> None:
        import pypbd

        if load.worlds % WORLDS:
            raise ValueError(f"pypbd runs {WORLDS} worlds at a time, {load.worlds} is no multiple of it")
        self._load = load
        self._simulation = pypbd.Simulation.getCurrent()
        self._simulation.initDefault()
        self._model = self._simulation.getModel()
        count = len(sheet.rest)
        self._offset = np.repeat(np.arange(WORLDS) * 40 * SPACING, count)[:, None] * [0.0, 1.0, 0.0]
        self._rest = np.tile(sheet.rest, (WORLDS, 1)) + self._offset
        for world in range(WORLDS):
            points = self._rest[world * count : (world + 1) * count]
            self._model.addTriangleModel(list(points), sheet.triangles.reshape(-1).tolist(), testMesh=False)
        self._particles = self._model.getParticles()
        held = np.tile(sheet.pinned | sheet.grasped, WORLDS)
        for i, still in enumerate(held.tolist()):
            self._particles.setMass(i, 0.0 if still else 1.0)
        substep = PERIOD / load.substeps
        for world in range(WORLDS):
            for i, j in (sheet.edges + world * count).tolist():
                self._model.addDistanceConstraint_XPBD(i, j, STIFFNESS / substep**2)
            for row in (sheet.hinges + world * count).tolist():
                self._model.addIsometricBendingConstraint_XPBD(*row, HINGE / substep**2)
        if len(self._model.getConstraints()) != WORLDS * sheet.constraints:
            raise RuntimeError(f"pypbd took {len(self._model.getConstraints())} constraints for {WORLDS * sheet.constraints}")
        self._model.initConstraintGroups()
        self._stepper = self._simulation.getTimeStep()
        self._stepper.setValueUInt(self._stepper.MAX_ITERATIONS, load.iterations)
        self._stepper.setValueUInt(self._stepper.MAX_ITERATIONS_V, 0)
        self._stepper.setValueUInt(self._stepper.NUM_SUB_STEPS, 1)
        if self._stepper.getValueUInt(self._stepper.MAX_ITERATIONS) != load.iterations:
            raise RuntimeError(f"pypbd did not take {load.iterations} iterations")
        pypbd.TimeManager.getCurrent().setTimeStepSize(substep)
        self._grasped = [int(i) for i in np.flatnonzero(np.tile(sheet.grasped, WORLDS))]

    def reset(self) -> None:
        """Flat and at rest."""
        self._simulation.reset()

    def run(self) -> None:
        """Pull the worlds of the model, and again from the start, until all worlds are done."""
        part = PULL / self._load.substeps
        for _ in range(self._load.worlds // WORLDS):
            self._simulation.reset()
            for substep in range(self._load.steps * self._load.substeps):
                for i in self._grasped:
                    self._particles.setPosition(i, self._rest[i] + (substep + 1) * part)
                self._stepper.step(self._model)

    def positions(self) -> Floats:
        """The worlds of the last repetition."""
        found = np.array([self._particles.getPosition(i) for i in range(len(self._rest))]).reshape(-1, 3)
        return np.asarray((found - self._offset).reshape(WORLDS, -1, 3))
