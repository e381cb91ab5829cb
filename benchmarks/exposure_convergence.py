"""How well the solvers solve, which a time per projection does not say: what is left of a pull's forces against iterations.

One sheet, edges only (the two bending models differ, the springs do not), one substep from flat with the grasp moved by one step. Both
then minimise the same function,

    1/2 m |x - x_0|^2 + 1/2 k sum (|x_i - x_j| - l_ij)^2          (m = inertia of a vertex, k = stiffness of an edge)

so that its gradient on the free vertices, as a share of the one before the first iteration, is a fair measure for either. XPBD ends
near the minimum, not at it, as it takes each constraint's direction where the vertices are and keeps what it did before in another.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from scipy.optimize import minimize

from benchmarks.peers import missing
from benchmarks.peers.newton_xpbd import NewtonRunner
from benchmarks.peers.ours import model_of
from benchmarks.peers.sheet import PULL, STIFFNESS, Floats, Load, Sheet, sheet
from skills.expose.xpbd import XpbdConfig, XpbdSolver, rest_state

ITERATIONS = (1, 2, 5, 10, 20, 50)
MM = 1e3  # the minimum is searched in mm


def convergence(stiffnesses: Iterable[float] = (STIFFNESS, 1.0 / XpbdConfig().inertia)) -> dict[str, Any]:
    """Residuals of our Gauss-Seidel and of Newton's Jacobi at edges of so many times a vertex's inertia.

    The second stiffness is the controller's. `distance_m` is the root mean square of the free vertices' distances from the solution.
    """
    flat = sheet()
    cases = []
    for stiffness in stiffnesses:
        exact = _exact(flat, stiffness)
        curves: dict[str, Any] = {"ours (Gauss-Seidel)": [_ours(flat, stiffness, n) for n in ITERATIONS]}
        if missing("newton") is None:
            curves["Newton (Jacobi)"] = [_newton(flat, stiffness, n) for n in ITERATIONS]
        cases.append(
            {
                "stiffness_over_inertia": stiffness,
                "residual": {name: [_residual(flat, stiffness, x) for x in found] for name, found in curves.items()},
                "distance_m": {name: [_distance(flat, x, exact) for x in found] for name, found in curves.items()},
            }
        )
    return {"iterations": list(ITERATIONS), "cases": cases}


def _ours(flat: Sheet, stiffness: float, iterations: int) -> Floats:
    model = model_of(flat, stiffness, hinges=False)
    solver = XpbdSolver(model, 1, 1, XpbdConfig(1, iterations, inertia=1.0 / stiffness), threads=1)
    return solver.rollout(rest_state(model), PULL[None, None]).positions()[0, 0].astype(np.float64)


def _newton(flat: Sheet, stiffness: float, iterations: int) -> Floats:
    runner = NewtonRunner(flat, Load(1, 1, 1, iterations), stiffness=stiffness, hinges=False)
    runner.run()
    return runner.raw()[0]


def _exact(flat: Sheet, stiffness: float) -> Floats:
    """The minimum, found by neither of the schemes."""
    free = ~(flat.pinned | flat.grasped)
    start = flat.rest + flat.grasped[:, None] * PULL

    def placed(variables: Floats) -> Floats:
        x = start.copy()
        x[free] = variables.reshape(-1, 3) / MM
        return x

    def energy(variables: Floats) -> tuple[float, Floats]:
        x = placed(variables)
        stretch = np.linalg.norm(x[flat.edges[:, 0]] - x[flat.edges[:, 1]], axis=1) - flat.rest_length
        value = 0.5 * ((x - flat.rest)[free] ** 2).sum() + 0.5 * stiffness * (stretch**2).sum()
        return float(value * MM**2), (_gradient(flat, stiffness, x) * MM).ravel()

    found = minimize(
        energy, (start[free] * MM).ravel(), jac=True, method="L-BFGS-B", options={"maxiter": 5000, "ftol": 0.0, "gtol": 1e-9}
    )
    return placed(found.x)


def _gradient(flat: Sheet, stiffness: float, x: Floats) -> Floats:
    """Of the function above with m = 1 N/m, on the free vertices [N]."""
    i, j = flat.edges.T
    apart = x[i] - x[j]
    length = np.linalg.norm(apart, axis=1)
    force = stiffness * ((length - flat.rest_length) / length)[:, None] * apart
    gradient = x - flat.rest
    np.add.at(gradient, i, force)
    np.add.at(gradient, j, -force)
    return np.asarray(gradient[~(flat.pinned | flat.grasped)])


def _residual(flat: Sheet, stiffness: float, x: Floats) -> float | None:
    """Of the gradient, what is left; None where it is not finite."""
    start = flat.rest + flat.grasped[:, None] * PULL
    left = np.linalg.norm(_gradient(flat, stiffness, x)) / np.linalg.norm(_gradient(flat, stiffness, start))
    return float(left) if np.isfinite(left) else None


def _distance(flat: Sheet, x: Floats, exact: Floats) -> float | None:
    away = np.linalg.norm((x - exact)[~(flat.pinned | flat.grasped)], axis=1)
    return float(np.sqrt((away**2).mean())) if np.isfinite(away).all() else None
