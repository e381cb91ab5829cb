"""Smooths the planned gripper steps and keeps them within every limit: one small quadratic program per controller step.

    minimise    |u - u_hat|^2 + w |u_t - 2 u_(t-1) + u_(t-2)|^2          (the second sum is the jerk of the gripper's path)
    subject to  the length and change of each step, the workspace, the distance to the other tool, predicted tension and strain

The two steps executed last belong to the sequence, so that the plan joins the motion that is under way. A nominal that MPPI averages from
noisy samples jitters by about a tenth of a millimetre; the program takes that out and leaves where the pull leads.

Solved by daqp, an active-set method: bounds hold to rounding and the answer depends on nothing but the problem. At h = 8 with all rows
it takes 0.07 ms on one core (osqp at 1e-6: 0.46 ms, one in twenty above 1.2 ms), and 0.5 ms with the filling in and the check.
osqp, warm started from its last answer, is the second try, because it fails on other problems than an active-set method. No solver's
success flag is asked: whether a plan may be executed is decided by `violations`, which looks at the plan alone.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from hardware.codes import Code
from hardware.interface import Array
from skills.expose.smoothing_problem import (
    Predicted,
    Smoothed,
    SmoothingConfig,
    SmoothingProblem,
    Violation,
    unusable,
    violations,
)

__all__ = ["Predicted", "Smoothed", "Smoother", "SmoothingConfig", "SmoothingProblem", "sensitivities"]

MM = 1e3  # inside the program lengths are in mm, so that steps, multipliers and tolerances are of the order of 1
CUTS = 4  # tangent planes per step that bound its Euclidean length; see `Smoother._attempt`
ROUND = 1e-6  # relative excess over a step's length that is left to scaling


def sensitivities(controls: Array, values: Array, nominal: Array, ridge: float = 1e-3) -> tuple[Array, Array]:
    """Value (h,) and gradient (h, 3) [per m] of a rolled-out quantity at the nominal, for free from the samples of MPPI.

    At each step the quantity is fitted as linear in where the gripper then is. Ridge regression: `ridge` times the mean variance of
    the displacement is added, so that a direction that no sample explored gets no slope. Samples that are not finite are left out; with
    fewer than five of them the slope is zero, with none the value is nan (which `Smoother.solve` refuses).

    Args:
        controls: (K, h, 3) [m] steps of the samples.
        values: (h, K) the quantity, at the end of each step.
        nominal: (h, 3) [m] steps at whose ends value and gradient are wanted.
        ridge: share of the variance, without unit.
    """
    samples, horizon, _ = controls.shape
    if values.shape != (horizon, samples) or nominal.shape != (horizon, 3):
        raise ValueError(f"controls {controls.shape}, values {values.shape} and nominal {nominal.shape} must agree in K and h")
    moved = np.cumsum(controls - nominal, axis=1).swapaxes(0, 1)
    finite = np.isfinite(values) & np.isfinite(moved).all(axis=2)
    count = finite.sum(axis=1)
    share = finite / np.maximum(count, 1)[:, None]
    d, y = np.where(finite[:, :, None], moved, 0.0), np.where(finite, values, 0.0)
    centre, mean = np.einsum("tk,tki->ti", share, d), np.einsum("tk,tk->t", share, y)
    around = share[:, :, None] * (d - centre[:, None])
    spread = np.einsum("tki,tkj->tij", around, d - centre[:, None])
    damping = ridge * np.trace(spread, axis1=1, axis2=2) / 3.0
    sloped = (count >= 5) & (damping > 0)
    damped = spread + np.where(sloped, damping, 1.0)[:, None, None] * np.eye(3)
    gradient = np.linalg.solve(damped, np.einsum("tki,tk->ti", around, y)[:, :, None])[:, :, 0] * sloped[:, None]
    value = np.where(count > 0, mean - np.einsum("ti,ti->t", gradient, centre), np.nan)
    return value, gradient


class Smoother:
    """The quadratic program, built once for a horizon of h steps; `solve` only fills in numbers. One thread at a time."""

    def __init__(self, config: SmoothingConfig, horizon: int) -> None:
        if horizon < 1:
            raise ValueError(f"the horizon must be 1 step or more, not {horizon}")
        self._config = config
        self._horizon = horizon
        self._rows = _Rows(config, horizon)
        per_axis = np.eye(horizon) + config.weight * self._rows.jerk.T @ self._rows.jerk
        quadratic = np.asarray(2.0 * np.kron(per_axis, np.eye(3)), dtype=np.float64)
        plain: dict[str, Any] = {"error_on_fail": False}
        # The interval of the penalty's adaption is fixed: by default it hangs on measured time, and no two runs would be alike.
        careful = {"eps_abs": 1e-7, "eps_rel": 1e-7, "max_iter": 2000, "adaptive_rho_interval": 25, "verbose": False}
        self._programs = (
            _Program("daqp", quadratic, self._rows.pattern, plain),
            _Program("osqp", quadratic, self._rows.pattern, plain | {"osqp": careful}),
            _Elastic(quadratic, self._rows.pattern, self._rows.family),
        )

    def solve(self, problem: SmoothingProblem) -> Smoothed:
        """The smooth plan, or a hold with the reason why there is none.

        The distance to the other tool is kept at the end of each step. On the way the gripper may come nearer, by at most
        max_step^2 / (8 min_tool_distance), 10 micrometres at the defaults. Give limits with that much in hand.

        Raises:
            ValueError: an array has the wrong shape. Values that are not finite end in a hold, not here.
        """
        self._check_shapes(problem)
        reason = unusable(problem)
        if reason:
            return self._hold(reason)
        found: list[Violation] = []
        for program in self._programs:
            steps = self._attempt(program, problem)
            if steps is None:
                continue
            found = violations(problem, steps, self._config)
            if not found:
                program.keep()
                return Smoothed(Code.OK, "the plan is smooth and keeps every limit", steps)
        if not found:
            return self._hold("no solver found a plan for the gripper, though no limit stands out")
        broken = "; ".join(f"{v.name}, {v.detail} at step {v.step}" for v in found)
        return self._hold(f"no plan of {self._horizon} steps keeps every limit. The best one breaks {broken}")

    def _attempt(self, program: _Program, problem: SmoothingProblem) -> Array | None:
        """Steps (h, 3) [m] from one solver, no longer than allowed; None if it returned no numbers.

        The Euclidean bound on a step is a ball, which linear rows meet by its tangent planes: first the one in the nominal's direction,
        then one where the answer still sticks out. The worst of many random problems left 3e-5 of a step, and that is scaled away.
        """
        longest = self._config.longest * MM
        self._rows.fill(problem)
        for cut in range(CUTS):
            x = program.solve(self._rows)
            if x is None:
                return None
            steps = x.reshape(-1, 3)
            length = np.linalg.norm(steps, axis=1)
            long = length > longest * (1.0 + ROUND)
            if not long.any() or cut + 1 == CUTS:
                break
            self._rows.cut(cut + 1, long, steps)
        return np.asarray(steps * np.minimum(1.0, longest / np.maximum(length, 1e-12))[:, None] / MM)

    def _hold(self, reason: str) -> Smoothed:
        return Smoothed(Code.SMOOTHING_INFEASIBLE, f"The gripper holds: {reason}.", np.zeros((self._horizon, 3)))

    def _check_shapes(self, problem: SmoothingProblem) -> None:
        h = self._horizon
        expected: list[tuple[str, Array | None, tuple[int, ...]]] = [
            ("nominal", problem.nominal, (h, 3)),
            ("position", problem.position, (3,)),
            ("past", problem.past, (2, 3)),
            ("low", problem.low, (3,)),
            ("high", problem.high, (3,)),
            ("other_tool", problem.other_tool, (3,)),
        ]
        for name, predicted in (("tension", problem.tension), ("strain", problem.strain)):
            if predicted is not None:
                expected += [(f"{name}.value", predicted.value, (h,)), (f"{name}.gradient", predicted.gradient, (h, 3))]
        for name, value, shape in expected:
            if value is not None and np.shape(value) != shape:
                raise ValueError(f"{name} must be {shape}, not {np.shape(value)}")


class _Rows:
    """The program's numbers: linear term, matrix (m, 3h) and bounds, in mm. The pattern is fixed, the values are filled in.

    Variables are the steps, axis by axis within step by step. Rows: `CUTS` blocks of tangents (h), change (3h), workspace (3h), other
    tool (h), tension (h), strain (h). `family` (m,) groups them for the elastic program; -1: never given way.
    """

    def __init__(self, config: SmoothingConfig, horizon: int) -> None:
        h = horizon
        self._config = config
        self._place = np.tril(np.ones((h, h)))  # from steps to places
        # Second difference of the steps; what the two executed ones contribute is constant (in `fill`).
        self.jerk = np.eye(h) - 2.0 * np.eye(h, k=-1) + np.eye(h, k=-2)
        blocks = [("cut", h)] * CUTS + [("change", 3 * h), ("workspace", 3 * h), ("tool", h), ("tension", h), ("strain", h)]
        ends = np.cumsum([0] + [size for _, size in blocks])
        spans = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        self._cuts, (self._change, self._workspace, self._tool, *self._predicted) = spans[:CUTS], spans[CUTS:]
        self.family = np.repeat([max(i - CUTS, -1) for i in range(len(blocks))], [size for _, size in blocks])
        step = np.kron(np.eye(h), np.ones(3))
        place = np.kron(self._place, np.ones(3))
        self.matrix = np.vstack(
            [step] * CUTS + [np.kron(np.eye(h) - np.eye(h, k=-1), np.eye(3)), np.kron(self._place, np.eye(3))] + [place] * 3
        )
        self.pattern = self.matrix != 0
        self.lower = np.full(len(self.matrix), -math.inf)
        self.upper = np.full(len(self.matrix), math.inf)
        self.linear = np.zeros(3 * h)
        self.box = config.longest * MM

    def fill(self, problem: SmoothingProblem) -> None:
        """Write the problem's numbers; the first tangent of each step stands in the nominal's direction."""
        self.lower[:], self.upper[:] = -math.inf, math.inf
        nominal, past = problem.nominal * MM, problem.past * MM
        ahead = np.zeros_like(nominal)
        ahead[0] = past[0] - 2.0 * past[1]
        ahead[1:2] += past[1]
        self.linear[:] = (-2.0 * nominal + 2.0 * self._config.weight * self.jerk.T @ ahead).ravel()
        for span in self._cuts:
            self.matrix[span] = 0.0
        self.cut(0, np.linalg.norm(nominal, axis=1) > 1e-9, nominal)
        if self._config.max_change is not None:
            self.lower[self._change], self.upper[self._change] = -self._config.max_change * MM, self._config.max_change * MM
            first = slice(self._change.start, self._change.start + 3)
            self.lower[first] += past[1]
            self.upper[first] += past[1]
        horizon = len(nominal)
        if problem.low is not None:
            self.lower[self._workspace] = np.tile((problem.low - problem.position) * MM, horizon)
        if problem.high is not None:
            self.upper[self._workspace] = np.tile((problem.high - problem.position) * MM, horizon)
        moved = np.cumsum(nominal, axis=0)
        self.matrix[self._tool] = 0.0
        if problem.other_tool is not None:
            away = (problem.position - problem.other_tool) * MM
            normal = _directions(away, moved)
            self.matrix[self._tool] = self._along_path(normal)
            self.lower[self._tool] = self._config.min_tool_distance * MM - normal @ away
        for span, predicted in zip(self._predicted, (problem.tension, problem.strain), strict=True):
            self.matrix[span] = 0.0
            if predicted is None or not math.isfinite(predicted.limit):
                continue
            # Divided by the slope, a row is in mm of gripper motion like all others, and one tolerance serves them all.
            slope = np.maximum(np.linalg.norm(predicted.gradient, axis=1), 1e-9)
            normal = predicted.gradient / slope[:, None]
            room = (
                np.clip((predicted.limit - predicted.value) / slope, -1.0, 1.0) * MM
            )  # beyond a metre nothing is reached anyway
            self.matrix[span] = self._along_path(normal)
            self.upper[span] = room + np.einsum("ti,ti->t", normal, moved)

    def cut(self, number: int, which: NDArray[np.bool_], steps: Array) -> None:
        """Bound the steps `which` (h,) by the plane that touches their ball in the direction of `steps` (h, 3)."""
        span, t = self._cuts[number], np.flatnonzero(which)
        blocks = self.matrix[span].reshape(len(which), len(which), 3)  # a view
        blocks[t, t] = steps[t] / np.linalg.norm(steps[t], axis=1, keepdims=True)
        self.upper[span][t] = self.box

    def _along_path(self, normal: Array) -> Array:
        """Rows (h, 3h) of normal_t . (u_0 + ... + u_t)."""
        return np.asarray((self._place[:, :, None] * normal[:, None, :]).reshape(len(normal), -1))


def _directions(away: Array, moved: Array) -> Array:
    """Unit vectors (h, 3) from the other tool to the gripper along the nominal; the half-space beyond each keeps the distance.

    Where the nominal passes by the tool or through it, the direction of now is kept: a half-space on the far side cannot be reached
    without going through.
    """
    now = away / max(float(np.linalg.norm(away)), 1e-9)
    planned = away + moved
    length = np.linalg.norm(planned, axis=1, keepdims=True)
    direction = planned / np.maximum(length, 1e-9)
    return np.where((direction @ now)[:, None] > 0.5, direction, now)


class _Program:
    """One solver with its buffers, warm started where it can be with its last answer that was kept."""

    def __init__(self, plugin: str, quadratic: Array, pattern: NDArray[np.bool_], options: dict[str, Any]) -> None:
        sparse = {"h": ca.sparsify(ca.DM(quadratic)).sparsity(), "a": ca.sparsify(ca.DM(pattern.astype(float))).sparsity()}
        function = ca.conic(f"smoothing_{plugin}", plugin, sparse, options)
        # Buffers instead of calls with casadi's own matrices: these would cost more than the solve.
        buffer: Any
        buffer, self._run = function.buffer()
        self._buffer = buffer  # must live as long as `_run`
        self._in = {name: np.zeros(function.nnz_in(i)) for i, name in enumerate(function.name_in())}
        self._out = {name: np.zeros(function.nnz_out(i)) for i, name in enumerate(function.name_out())}
        for i, values in enumerate(self._in.values()):
            buffer.set_arg(i, values.data)
        for i, values in enumerate(self._out.values()):
            buffer.set_res(i, values.data)
        columns, rows = np.nonzero(pattern.T)  # casadi stores column by column
        self._entries = (rows, columns)
        columns, rows = np.nonzero(quadratic.T)
        self._in["h"][:] = quadratic[rows, columns]

    def solve(self, rows: _Rows) -> Array | None:
        """The variables (3h,) [mm], unchecked; None if not finite."""
        box = np.full(len(rows.linear), rows.box)
        return self._solved(rows.linear, rows.matrix, (rows.lower, rows.upper), (-box, box))

    def keep(self) -> None:
        """Start the next solve from the answer just given. Only good answers should be: what a failed solve leaves is a poor start."""
        for start, answer in (("x0", "x"), ("lam_x0", "lam_x"), ("lam_a0", "lam_a")):
            self._in[start][:] = self._out[answer]

    def _solved(self, linear: Array, matrix: Array, bounds: tuple[Array, Array], box: tuple[Array, Array]) -> Array | None:
        put = self._in
        put["g"][:], put["a"][:] = linear, matrix[self._entries]
        put["lba"][:], put["uba"][:] = bounds
        put["lbx"][:], put["ubx"][:] = box
        self._run()
        return self._out["x"].copy() if all(np.isfinite(values).all() for values in self._out.values()) else None


class _Elastic(_Program):
    """The same program in which each family of limits may give way at a high price: says which limit fails, and by how much."""

    PRICE = 1e4  # per mm; above the multipliers of a feasible problem, whose answer is then the same

    def __init__(self, quadratic: Array, pattern: NDArray[np.bool_], family: NDArray[np.int64]) -> None:
        families = int(family.max()) + 1
        give = (family[:, None] == np.arange(families)).astype(np.float64)
        self._give = np.vstack([-give, give])
        self._families = families
        size = len(quadratic)
        widened = np.eye(size + families)
        widened[:size, :size] = quadratic
        both = np.hstack([np.vstack([pattern, pattern]), self._give != 0])
        super().__init__("daqp", widened, both, {"error_on_fail": False})

    def solve(self, rows: _Rows) -> Array | None:
        """The variables (3h,) [mm] that break the limits the least, unchecked; None if not finite."""
        infinite, none, box = np.full(len(rows.upper), math.inf), np.zeros(self._families), np.full(len(rows.linear), rows.box)
        x = self._solved(
            np.concatenate([rows.linear, none + self.PRICE]),
            np.hstack([np.vstack([rows.matrix, rows.matrix]), self._give]),
            (np.concatenate([-infinite, rows.lower]), np.concatenate([rows.upper, infinite])),
            (np.concatenate([-box, none]), np.concatenate([box, none + math.inf])),
        )
        return None if x is None else x[: len(rows.linear)]
