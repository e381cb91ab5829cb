"""The exposure controller's planning step: where the jaws go next so that the camera sees the cut (paper, Eq. ocp_formulation).

One update: sample gripper paths (MPPI), roll the tissue model out along each (XPBD), judge what the camera would see (visibility),
average, and smooth within the limits (CasADi). Nothing here touches an arm or a picture.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from hardware.codes import Code
from hardware.interface import Array, CameraModel
from skills.expose.ground import Ground
from skills.expose.hypotheses import BELIEVED, CONNECTED
from skills.expose.model import TissueModel
from skills.expose.mppi import MppiConfig, adapted, controls, perturbations, shifted, updated
from skills.expose.region import Region, RegionConfig
from skills.expose.smoothing import Predicted, Smoother, SmoothingConfig, SmoothingProblem, sensitivities
from skills.expose.visibility import LossWeights, Terms, Visibility, VisibilityConfig, cost, lips_of
from skills.expose.xpbd import State, XpbdConfig, XpbdSolver
from skills.scene.surface import Surface

SINK = 0.3e-3  # [m] that the jaws may go deeper into the surface seen at t_d than they were then: about its error
STEPS_LIMITED = 2  # of the plan, whose expected tension and strain are kept within their limits


class Objective(StrEnum):
    """What the sampled paths are judged by."""

    OPENING = "opening"  # the visible area of the parted cut, on the model of what is believed severed, at little tension
    PAPER = "paper"  # the paper's two losses, on the uncut model


@dataclass(frozen=True)
class PlannerConfig:
    """Settings of the planning step."""

    objective: Objective = Objective.OPENING
    # Two rounds: where a stiff tissue leaves few ways within its limits, one round finds that most samples break them, the next a way.
    mppi: MppiConfig = field(default_factory=lambda: MppiConfig(iterations=2))
    camera: float = 1.0  # lambda_c
    deform: float = 1.0  # lambda_d
    opening: float = 1.0  # lambda_o, of the opening in units of the goal's length times the band
    tension: float = 0.1  # lambda_T, of the expected tension in units of the budget
    overload: float = 10.0  # of the square of what exceeds the budget
    guide: float = 15.0  # [1/m] of the way along the first guess, which counts where the model expects nothing of any way
    smooth: bool = True
    xpbd: XpbdConfig = field(default_factory=XpbdConfig)
    region: RegionConfig = field(default_factory=RegionConfig)
    visibility: VisibilityConfig = field(default_factory=VisibilityConfig)
    smoothing: SmoothingConfig = field(default_factory=lambda: SmoothingConfig(min_tool_distance=3.5e-3))  # the gate's is 3 mm

    def __post_init__(self) -> None:
        object.__setattr__(self, "objective", Objective(self.objective))

    @property
    def hypothesis(self) -> int:
        """The version of the model that is planned on."""
        return BELIEVED if self.objective is Objective.OPENING else CONNECTED


@dataclass(frozen=True)
class Limits:
    """What the plan keeps: workspace corners (3,) [m], tension [N] and strain at most."""

    low: Array
    high: Array
    tension: float
    strain: float


@dataclass(frozen=True)
class Situation:
    """Where things are before the step: gripper (3,), other tool (3,) [m], the last two executed steps (2, 3) [m].

    The tissue is under tension at t_d already, which the model, at rest there, does not know: what is expected is `preload` [N] plus
    `tension_scale` times the model's, the measured rise over the expected one so far.
    """

    gripper: Array
    other_tool: Array
    past: Array
    preload: float
    tension_scale: float

    def tension(self, modelled: Array) -> Array:
        """Tension [N] to be expected where the model has `modelled` [N]."""
        return self.preload + self.tension_scale * modelled


@dataclass(frozen=True)
class Plan:
    """`code` OK and the next `step` (3,) [m], or why the jaws must hold.

    `nominal` (h, 3) planned steps; `samples` (K, h, 3) sampled ones; `camera`, `deform` and `opening` [px^2] are the terms of the loss,
    means over samples (weighted) and horizon; `tension` [N] and `strain` expected after the step; the rest as in `MppiUpdate`.
    """

    code: Code
    message: str
    step: Array
    nominal: Array
    samples: Array
    camera: float
    deform: float
    opening: float
    tension: float
    strain: float
    effective: float
    feasible: float
    agreement: float


class Planner:
    """Buffers and program for one tissue model; `update` once for each step. One thread."""

    def __init__(
        self,
        model: TissueModel,
        surface: Surface,
        region: Region,
        camera: CameraModel,
        limits: Limits,
        config: PlannerConfig,
        rng: np.random.Generator,
        device: str = "cpu",
        threads: int | None = None,
    ) -> None:
        self._config = config
        self._limits = limits
        self._rng = rng
        mppi = config.mppi
        self._solver = XpbdSolver(model, mppi.samples, mppi.horizon, config.xpbd, device, threads)
        lips = lips_of(surface, model.seams) if config.objective is Objective.OPENING else None
        self._visibility = Visibility(region, model.triangles, camera, lips, config.visibility, device=self._solver.device)
        band = float(np.ptp(region.lateral)) + region.spacing[0]
        self._area = surface.goal_length * band
        self._smoother = Smoother(config.smoothing, mppi.horizon)
        self._ground = Ground(surface)
        self._nominal: Array | None = None

    def begin(self, guess: Array, gripper: Array) -> None:
        """Start from a pull along `guess` (3,), a direction, of the jaws that are at `gripper` (3,) [m]."""
        step = guess / max(float(np.linalg.norm(guess)), 1e-12) * self._config.mppi.max_step
        self._nominal = np.tile(step, (self._config.mppi.horizon, 1))
        self._guess = step / self._config.mppi.max_step
        self._lowest = min(float(self._ground.height(gripper)), 0.0) - SINK

    def update(self, state: State, now: Situation) -> Plan:
        """One update of the plan from the model's `state`, of which the first step is to be executed.

        Raises:
            RuntimeError: `begin` was not called.
        """
        if self._nominal is None:
            raise RuntimeError("a plan needs a first guess")
        mppi = self._config.mppi
        nominal = self._nominal
        for iteration in range(mppi.iterations):
            samples = controls(nominal, perturbations(self._rng, adapted(mppi, iteration)), mppi.max_step)
            rollout = self._solver.rollout(state, samples)
            terms = self._visibility.terms(rollout)
            costs, feasible = self._cost(terms, now.tension(rollout.tension), samples, now)
            outcome = updated(nominal, samples, costs, feasible, mppi)
            if outcome.code is not Code.OK:
                return self._hold(outcome.code, outcome.message, samples)
            nominal = outcome.nominal
        tension = now.tension(rollout.tension)
        means = [float(np.nanmean(values @ outcome.weights)) for values in (terms.camera, terms.deform, terms.opening)]
        step, message = self._smoothed(nominal, samples, tension, rollout.strain, now)
        if step is None:
            return self._hold(Code.SMOOTHING_INFEASIBLE, message, samples)
        self._nominal = shifted(nominal)
        return Plan(
            code=Code.OK,
            message=outcome.message,
            step=step,
            nominal=nominal,
            samples=samples,
            camera=means[0],
            deform=means[1],
            opening=means[2],
            tension=float(tension[0] @ outcome.weights),
            strain=float(rollout.strain[0] @ outcome.weights),
            effective=outcome.effective_samples,
            feasible=outcome.feasible,
            agreement=outcome.agreement,
        )

    # ------------------------------------------------------------ inside

    def _cost(self, terms: Terms, tension: Array, samples: Array, now: Situation) -> tuple[Array, NDArray[np.bool_]]:
        config = self._config
        opening = config.opening / self._area if config.objective is Objective.OPENING else 0.0
        costs, feasible = cost(terms, LossWeights(config.camera, config.deform, opening))
        feasible = feasible & self._within(samples, now)
        if config.objective is Objective.OPENING:
            load = tension / self._limits.tension
            costs = costs + (config.tension * load + config.overload * np.maximum(load - 1.0, 0.0) ** 2).sum(axis=0)
            costs = costs - config.guide * (np.cumsum(samples, axis=1) @ self._guess).sum(axis=1)
        return costs, feasible

    def _within(self, samples: Array, now: Situation) -> NDArray[np.bool_]:
        """Which samples (K,) keep the jaws in the workspace and out of the ground at every step."""
        path = now.gripper + np.cumsum(samples, axis=1)
        inside = ((path >= self._limits.low) & (path <= self._limits.high)).all(axis=(1, 2))
        lowest = min(float(self._ground.height(now.gripper)), self._lowest)
        return np.asarray(inside & (self._ground.height(path) >= lowest).all(axis=1))

    def _smoothed(
        self, nominal: Array, samples: Array, tension: Array, strain: Array, now: Situation
    ) -> tuple[Array | None, str]:
        """The first step of the smoothed plan, of full length, or in words why there is none."""
        config, limits = self._config, self._limits
        lengths = np.linalg.norm(nominal, axis=1, keepdims=True)
        # An average of directions that agree is nearly of full length; what is missing is the samples' spread, not a wish to go slower.
        full = nominal * np.minimum(config.mppi.max_step / np.maximum(lengths, 1e-9), 2.0)
        if not config.smooth:
            return full[0], ""
        load, load_slope = sensitivities(samples, tension, full)
        stretched, stretch_slope = sensitivities(samples, strain, full)
        problem = SmoothingProblem(
            nominal=full,
            position=now.gripper,
            past=now.past,
            low=limits.low,
            high=limits.high,
            other_tool=now.other_tool,
            tension=_soon(load, load_slope, limits.tension),
            strain=_soon(stretched, stretch_slope, limits.strain),
        )
        result = self._smoother.solve(problem)
        return (result.steps[0], "") if result.code is Code.OK else (None, result.message)

    def _hold(self, code: Code, message: str, samples: Array) -> Plan:
        none = float("nan")
        h = self._config.mppi.horizon
        return Plan(code, message, np.zeros(3), np.zeros((h, 3)), samples, none, none, none, none, none, 0.0, 0.0, 0.0)


def _soon(value: Array, gradient: Array, limit: float) -> Predicted:
    """A limit on the steps that come next. What lies farther ahead will be planned again, and must not forbid to go on now."""
    ahead = np.arange(len(value)) >= STEPS_LIMITED
    return Predicted(np.where(ahead, np.minimum(value, limit), value), np.where(ahead[:, None], 0.0, gradient), limit)
