"""The exposure controller (paper, Exposure Maximization Control): sees the surface at t_d, plans each step on a model of it, stops in time.

It stops where severed and connected are easiest to tell apart within the budget of tension and strain, and says what it expected of
every edge.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hardware.codes import Code
from hardware.gate import Lease
from hardware.interface import CUTTER, Array, CameraModel
from skills.estimate.grid import Grid
from skills.expose.expected import (
    MEMBRANE,
    PLATE,
    Expected,
    Sight,
    SightConfig,
    expected_of,
    no_model,
    sight,
    tissue_seen,
)
from skills.expose.hypotheses import DECIDED, SeparationConfig
from skills.expose.model import ModelConfig, TissueModel
from skills.expose.outcome import ExposeOutcome, Forecast, Planned
from skills.expose.planner import Limits, Plan, Planner, PlannerConfig, Situation
from skills.expose.pull import Stop
from skills.expose.region import region_around
from skills.expose.straight import goal_normal
from skills.grasp import Grasped
from skills.scene.stereo import DepthMap, StereoConfig
from skills.scene.surface import Surface, SurfaceConfig
from skills.scene.tissue import TissueConfig
from skills.skill import Progress, Steps, computed
from skills.tracking.tracks import TrackedGoal

MARGIN = 0.5e-3  # [m] that a plan stays inside the gate's workspace and farther from the other tool
HEADROOM = 1.1  # what a plan may use of the budget of strain: kept to just that, the pull would creep towards it for ever


@dataclass(frozen=True)
class OptimalConfig:
    """Settings of the controller; `surface`, `tissues` and `margin` as in `SightConfig`."""

    surface: SurfaceConfig = field(default_factory=SurfaceConfig)
    tissues: tuple[ModelConfig, ...] = (MEMBRANE, PLATE)
    planner: PlannerConfig = field(default_factory=PlannerConfig)
    separation: SeparationConfig = field(default_factory=SeparationConfig)
    stop_early: bool = True  # False: pull all steps, as the paper does, whatever strain is expected
    least_steps: int = 6
    patience: int = 6  # steps without a better separation after which the best is behind
    worth: float = 1.0  # standard deviations below which nothing has been told apart yet
    tension_budget: float = 0.9  # of the gate's stop limit, that a plan may use
    strain_budget: float = 1.0  # of the model's worst edge outside the jaws: membranes fail at 0.8 to 2.2
    margin: float = 130.0  # [px] around the goal that is matched in stereo
    least_agreement: float = 0.2  # of the samples; below it nothing is decided
    device: str = "auto"
    threads: int | None = None

    def __post_init__(self) -> None:
        if not self.tissues:
            raise ValueError("tissues must name at least one tissue model")
        if self.least_steps < 1 or self.patience < 1:
            raise ValueError(f"least_steps ({self.least_steps}) and patience ({self.patience}) must be at least 1")
        if not (self.tension_budget > 0 and self.strain_budget > 0 and self.margin > 0 and self.least_agreement >= 0):
            raise ValueError("the budgets of tension and strain and the margin must be positive, least_agreement not negative")


@dataclass(frozen=True)
class View:
    """What the controller has in mind now, for people to look at: the expected mesh, sampled jaw paths, the plan."""

    number: int
    vertices: Array  # (V, 3) [m], left camera frame
    triangles: NDArray[np.int32]
    paths: Array  # (K, h + 1, 3) [m]
    plan: Array  # (h + 1, 3) [m]
    opening: float  # [px^2]
    camera: float
    deform: float
    tension: float  # [N]
    separation: float


class SteeringOptimal:
    """Plans every step. One run at a time."""

    turns = True

    def __init__(
        self,
        config: OptimalConfig,
        stereo: StereoConfig,
        tissue: TissueConfig,
        executor: Executor,
        rng: np.random.Generator,
        gaps: Callable[[], Array | None],
    ) -> None:
        self._config = config
        self._stereo = stereo
        self._tissue = tissue
        self._executor = executor
        self._rng = rng
        self._gaps = gaps  # openings (E,) [px] along the grid's edges since t_d, nan undecided (`GapWatch.decided`)
        self._run: _Run | None = None
        self.view: View | None = None

    def begin(self, lease: Lease, goal: TrackedGoal, grid: Grid, grasped: Grasped) -> Steps[Stop | None]:
        """Reconstruct the surface and build the model on it."""
        yield Progress("looking")
        self._run, self.view = None, None
        seen = sight(lease, goal, grid, grasped)
        limits = lease.limits
        bounds = Limits(
            np.array(limits.workspace_lower) + MARGIN,
            np.array(limits.workspace_upper) - MARGIN,
            self._config.tension_budget * limits.tension_stop,
            HEADROOM * self._config.strain_budget if self._config.stop_early else math.inf,
        )
        made = yield from computed(self._executor, "building the tissue model", self._build, seen, bounds)
        if isinstance(made, Stop):
            return made
        self._run = made
        return None

    def step(self, lease: Lease, here: Array, number: int) -> Steps[Array | Stop]:
        """Plan step `number`, or stop."""
        run = self._run
        assert run is not None, "a step follows a successful begin"
        other = lease.measured_cp(CUTTER).value.position
        plan = yield from computed(
            self._executor, f"planning step {number}", run.next, here, other, lease.tension(), self._gaps(), number
        )
        self.view = run.view
        if run.stop is not None and self._config.stop_early:
            return run.stop
        if plan.code is not Code.OK:
            return Stop(Code.OK if number > 1 else plan.code, plan.message, plan.code)
        return plan.step

    def forecast(self) -> Forecast | None:
        """What was expected so far."""
        return None if self._run is None else self._run.expected.forecast()

    def report(self, outcome: ExposeOutcome) -> ExposeOutcome:
        """Add what was expected."""
        return outcome if self._run is None else self._run.report(outcome)

    def _build(self, seen: Sight, limits: Limits) -> _Run | Stop:
        config, planning = self._config, self._config.planner
        tissue = tissue_seen(seen, sight_config(config, self._stereo, self._tissue))
        if isinstance(tissue, Stop):
            return tissue
        expected = expected_of(tissue, seen, config.separation, planning.xpbd)
        if isinstance(expected, Stop):
            return expected
        surface, model, camera = tissue.surface, tissue.model, seen.camera
        try:
            region = region_around(seen.goal.polyline, seen.grasp, surface, camera, planning.region)
            planner = Planner(model, surface, region, camera, limits, planning, self._rng, config.device, config.threads)
        except ValueError as error:
            return no_model(error)
        planner.begin(_first_guess(seen.goal, tissue.depth, camera, surface), seen.grasp)
        preload = seen.tension if math.isfinite(seen.tension) else 0.0
        return _Run(config, model, planner, expected, preload)


def sight_config(config: OptimalConfig, stereo: StereoConfig, tissue: TissueConfig) -> SightConfig:
    """How the controller sees and models the tissue."""
    return SightConfig(config.surface, config.tissues, stereo, tissue, config.planner.xpbd, config.margin)


class _Run:
    """One exposure's model, plan and memory."""

    def __init__(self, config: OptimalConfig, model: TissueModel, planner: Planner, expected: Expected, preload: float) -> None:
        self._config = config
        self._model = model
        self._planner = planner
        self.expected = expected
        self._hypotheses = expected.hypotheses
        self._from: Array | None = None
        self._past = np.zeros((2, 3))
        self._plans: list[Plan] = []
        self._strains: list[float] = []
        self._preload = preload
        self._scale = 1.0
        self.view: View | None = None
        self.stop: Stop | None = None

    def next(self, gripper: Array, other_tool: Array, tension: float, gaps: Array | None, number: int) -> Plan:
        """Take in what the last step did, decide whether it was the last one, and plan the next."""
        if self._from is not None:
            self._executed(gripper - self._from, tension, gaps)
        self._from = gripper
        hypothesis = self._config.planner.hypothesis
        now = Situation(gripper, other_tool, self._past, self._preload, self._scale)
        plan = self._planner.update(self._hypotheses.one(hypothesis), now)
        if plan.code is Code.OK and plan.agreement < self._config.least_agreement:
            plan = replace(plan, code=Code.EXPOSURE_INFEASIBLE, message="the sampled pulls cancel each other: no direction helps")
        if plan.code is Code.OK:
            self._plans.append(plan)
        self._look(number, gripper, plan)
        return plan

    def report(self, outcome: ExposeOutcome) -> ExposeOutcome:
        """The outcome with forecast and plans, one row for each step that was made."""
        steps = len(outcome.path)
        # The last step made is taken into the model only when a further one is planned.
        if steps and len(self.expected.stretches) < steps and self._from is not None:
            self._executed(outcome.path[-1] - self._from, float(outcome.tension[-1]), None)
        plans = self._plans[:steps]

        def column(name: str) -> Array:
            return np.array([getattr(plan, name) for plan in plans])

        planned = Planned(
            column("camera"),
            column("deform"),
            column("opening"),
            column("tension"),
            column("effective"),
            column("feasible"),
            column("agreement"),
        )
        return replace(outcome, forecast=self.expected.forecast(), planned=planned)

    def _executed(self, step: Array, tension: float, gaps: Array | None) -> None:
        """Pull the model along, compare the tension, and see whether the hypotheses are far enough apart."""
        self.expected.executed(step, gaps)
        self._past = np.vstack([self._past[1:], step])
        expected = float(self._hypotheses.tension[self._config.planner.hypothesis])
        if math.isfinite(tension) and expected > 0.02:
            # The force sensor is noisy: the ratio follows slowly.
            self._scale += 0.3 * (float(np.clip((tension - self._preload) / expected, 0.3, 10.0)) - self._scale)
        self._strains.append(float(self._hypotheses.strain[self._config.planner.hypothesis]))
        self.stop = self._decided()

    def _decided(self) -> Stop | None:
        """Stop when what matters is clear, or when it only gets worse."""
        c, apart = self._config, self.expected.separations
        if len(apart) < c.least_steps:
            return None
        if apart[-1] >= c.separation.enough:
            told = "every edge across the goal has been seen to part or to hold"
            said = told if apart[-1] >= DECIDED else f"severed and connected tissue are {apart[-1]:.1f} standard deviations apart"
            return Stop(Code.OK, said, Code.EXPOSURE_SEPARATED)
        if self._strains[-1] >= c.strain_budget:
            return Stop(Code.OK, f"tissue beside the goal is stretched by {self._strains[-1]:.0%} by now", Code.STRAIN)
        best = int(np.argmax(apart))
        if apart[best] >= c.worth and len(apart) - 1 - best >= c.patience:
            return Stop(
                Code.OK,
                f"pulling further no longer tells severed from connected better ({apart[best]:.1f} standard deviations)",
                Code.EXPOSURE_SEPARATED,
            )
        return None

    def _look(self, number: int, gripper: Array, plan: Plan) -> None:
        state = self._hypotheses.one(self._config.planner.hypothesis)
        paths = np.concatenate([np.zeros((len(plan.samples), 1, 3)), np.cumsum(plan.samples, axis=1)], axis=1) + gripper
        way = np.vstack([np.zeros(3), np.cumsum(plan.nominal, axis=0)]) + gripper
        apart = self.expected.separations[-1] if self.expected.separations else 0.0
        self.view = View(
            number,
            state.positions[0].astype(np.float64),
            self._model.triangles,
            paths,
            way,
            plan.opening,
            plan.camera,
            plan.deform,
            plan.tension,
            apart,
        )


def _first_guess(goal: TrackedGoal, depth: DepthMap, camera: CameraModel, surface: Surface) -> Array:
    """Along the goal's normal in the tissue's plane; from the surface where the rows' own depth is not known."""
    direction = goal_normal(goal, depth, camera)
    if direction is not None:
        return direction
    near, far = surface.vertices[surface.lateral > 0], surface.vertices[surface.lateral < 0]
    return near.mean(axis=0) - far.mean(axis=0)
