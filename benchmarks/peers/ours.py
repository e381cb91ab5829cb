"""Our solver under the same load."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.peers.sheet import BENDING, PULL, STIFFNESS, Floats, Load, Sheet
from skills.expose.model import ModelConfig, TissueModel, model_from_mesh
from skills.expose.xpbd import Rollout, XpbdConfig, XpbdSolver, rest_state


def model_of(sheet: Sheet, stiffness: float = STIFFNESS, *, hinges: bool = True) -> TissueModel:
    """The sheet as the controller's model: even stiffness, nothing but edges and hinges."""
    config = ModelConfig() if hinges else ModelConfig(bending=0.0)
    made = model_from_mesh(sheet.rest, sheet.triangles, config, pinned=sheet.pinned, grasped=sheet.grasped)
    return replace(
        made,
        edge_compliance=np.full(len(made.edges), 1.0 / stiffness),
        hinge_compliance=np.full(len(made.hinges), 1.0 / BENDING),
    )


class OurRunner:
    """One rollout; every sample is pulled the same way."""

    scheme = "Gauss-Seidel"
    note = "float32; isometric hinges; also tension and strain of every step"

    def __init__(self, sheet: Sheet, load: Load, *, threads: int) -> None:
        self.name = f"ours, {threads} thread{'s' if threads > 1 else ''}"
        model = model_of(sheet)
        if len(model.edges) + len(model.hinges) != sheet.constraints:
            raise RuntimeError(f"the model has {len(model.edges) + len(model.hinges)} constraints, the sheet {sheet.constraints}")
        config = XpbdConfig(load.substeps, load.iterations, inertia=1.0 / STIFFNESS)
        self._solver = XpbdSolver(model, load.worlds, load.steps, config, threads=threads)
        self._state = rest_state(model)
        self._controls = np.tile(PULL, (load.worlds, load.steps, 1))
        self._rollout: Rollout | None = None

    def reset(self) -> None:
        """A rollout starts from its state anyway."""

    def run(self) -> None:
        """Roll out."""
        self._rollout = self._solver.rollout(self._state, self._controls)

    def positions(self) -> Floats:
        """Where the samples ended."""
        assert self._rollout is not None
        return np.asarray(self._rollout.final().positions, dtype=np.float64)
