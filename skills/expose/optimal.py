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
from hardware.interface import CUTTER, GRASPER, Array, CameraModel, StereoFrame
from skills.estimate.grid import Grid
from skills.expose.hypotheses import DECIDED, Hypotheses, SeparationConfig, Stretch
from skills.expose.model import ModelConfig, TissueModel, build_model
from skills.expose.outcome import ExposeOutcome, Forecast, Planned
from skills.expose.planner import Limits, Plan, Planner, PlannerConfig, Situation
from skills.expose.pull import Stop
from skills.expose.region import region_around
from skills.expose.straight import goal_normal
from skills.expose.xpbd import State, XpbdConfig, XpbdSolver, rest_state
from skills.grasp import Grasped
from skills.scene.stereo import DepthMap, StereoConfig, depth_from_stereo
from skills.scene.stereo import region_around as image_region
from skills.scene.surface import Surface, SurfaceConfig, reconstruct
from skills.scene.tissue import TissueConfig, tissue_mask, tool_mask
from skills.skill import Progress, Steps, computed
from skills.tracking.tracks import TrackedGoal

MARGIN = 0.5e-3  # [m] that a plan stays inside the gate's workspace and farther from the other tool
HEADROOM = 1.1  # what a plan may use of the budget of strain: kept to just that, the pull would creep towards it for ever
LEAST_PULL = 0.5e-3  # [m] below which the force says nothing about the tissue
MEMBRANE = ModelConfig()
PLATE = ModelConfig(stretch=1000.0, bending=2e-4, free_adhesion=2e6, adhesion_limit=2e-3)


@dataclass(frozen=True)
class OptimalConfig:
    """Settings of the controller.

    `tissues` are what the tissue may be like: a soft sheet over a prepared plane, or a thick flap that still sticks to its bed. The force
    that the grasp met so far chooses between them, since a membrane can be pulled back in its plane and a plate cannot.
    """

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
        self._gaps = gaps  # widest openings (E,) [px] seen along the grid's edges since t_d
        self._run: _Run | None = None
        self.view: View | None = None

    def begin(self, lease: Lease, goal: TrackedGoal, grid: Grid, grasped: Grasped) -> Steps[Stop | None]:
        """Reconstruct the surface and build the model on it."""
        yield Progress("looking")
        self._run, self.view = None, None
        grasp = lease.measured_cp(GRASPER).value.position
        tension = lease.tension()
        pulled = Pulled(lease.setpoint_cp(GRASPER).position - grasped.origin.position, tension)
        if float(np.linalg.norm(pulled.displacement)) < grasped.test_pull:
            pulled = Pulled(grasped.test_pull * grasped.normal, grasped.test_tension)
        pair, camera = lease.endoscope.stereo(), lease.endoscope.camera
        limits = lease.limits
        bounds = Limits(
            np.array(limits.workspace_lower) + MARGIN,
            np.array(limits.workspace_upper) - MARGIN,
            self._config.tension_budget * limits.tension_stop,
            HEADROOM * self._config.strain_budget if self._config.stop_early else math.inf,
        )
        made = yield from computed(
            self._executor, "building the tissue model", self._build, pair, camera, goal, grid, grasp, pulled, tension, bounds
        )
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

    def report(self, outcome: ExposeOutcome) -> ExposeOutcome:
        """Add what was expected."""
        run, self._run = self._run, None
        return outcome if run is None else run.report(outcome)

    def _build(
        self,
        pair: StereoFrame,
        camera: CameraModel,
        goal: TrackedGoal,
        grid: Grid,
        grasp: Array,
        pulled: Pulled,
        tension: float,
        limits: Limits,
    ) -> _Run | Stop:
        config = self._config
        pixel = camera.project(grasp[None])[0]
        box = image_region(np.vstack([goal.near, goal.far, pixel]), config.margin, (camera.width, camera.height))
        depth = depth_from_stereo(pair, camera, self._stereo, box)
        image = pair.left.image
        tissue, tools = tissue_mask(image, self._tissue), tool_mask(image, self._tissue)
        seen = reconstruct(depth, camera, tissue, tools, goal.polyline, pixel, config.surface)
        if seen.surface is None:
            return Stop(seen.code, seen.message, seen.code)
        surface = seen.surface
        try:
            models = [build_model(surface, grasp, tissue) for tissue in config.tissues]
            region = region_around(goal.polyline, grasp, surface, camera, config.planner.region)
            model = likeliest(models, pulled, config.planner.xpbd)
            planner = Planner(model, surface, region, camera, limits, config.planner, self._rng, config.device, config.threads)
            hypotheses = Hypotheses(model, surface, grid, camera, config.separation, config.planner.xpbd, "cpu")
        except ValueError as error:
            # A grasp off the surface, a goal too short for the lattice, a region all hidden: the picture does not carry a model.
            return Stop(Code.SURFACE_INVALID, f"no tissue model can be built on the surface seen: {error}", Code.SURFACE_INVALID)
        planner.begin(_first_guess(goal, depth, camera, surface))
        preload = tension if math.isfinite(tension) else 0.0
        return _Run(config, model, planner, hypotheses, preload)


@dataclass(frozen=True)
class Pulled:
    """A pull that was made: its displacement (3,) [m] from where the jaws closed, and the tension [N] that it met."""

    displacement: Array
    tension: float


def likeliest(models: list[TissueModel], pulled: Pulled, config: XpbdConfig) -> TissueModel:
    """The model whose tension after the same pull comes nearest, as a ratio; the first one if nothing was pulled or nothing is known.

    Each is tried with the goal severed and connected, since that is not known.
    """
    length = float(np.linalg.norm(pulled.displacement))
    if len(models) == 1 or length < LEAST_PULL or not pulled.tension > 0.0:
        return models[0]
    steps = max(1, round(length / LEAST_PULL))
    misfits = []
    for model in models:
        state = rest_state(model)
        joined = np.repeat(np.array([[0.0], [1.0]], np.float32), len(model.seams), axis=1)
        both = State(np.repeat(state.positions, 2, axis=0), np.repeat(state.adhesion, 2, axis=0), joined)
        pull = np.broadcast_to(pulled.displacement / steps, (2, steps, 3))
        tension = XpbdSolver(model, 2, steps, config, threads=1).rollout(both, pull).tension[-1]
        misfits.append(abs(math.log(max(pulled.tension, 0.02) / max(float(np.sqrt(tension.prod())), 0.02))))
    return models[int(np.argmin(misfits))]


class _Run:
    """One exposure's model, plan and memory."""

    def __init__(
        self, config: OptimalConfig, model: TissueModel, planner: Planner, hypotheses: Hypotheses, preload: float
    ) -> None:
        self._config = config
        self._model = model
        self._planner = planner
        self._hypotheses = hypotheses
        self._from: Array | None = None
        self._past = np.zeros((2, 3))
        self._plans: list[Plan] = []
        self._stretches: list[Stretch] = []
        self._separations: list[float] = []
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
        steps, edges = len(outcome.path), len(self._hypotheses.edges)
        # The last step made is taken into the model only when a further one is planned.
        if steps and len(self._stretches) < steps and self._from is not None:
            self._executed(outcome.path[-1] - self._from, float(outcome.tension[-1]), None)
        plans = self._plans[:steps]
        forecast = Forecast(
            self._hypotheses.edges,
            np.array([s.severed for s in self._stretches[:steps]]).reshape(steps, edges),
            np.array([s.connected for s in self._stretches[:steps]]).reshape(steps, edges),
            np.array(self._separations[:steps]),
        )

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
        return replace(outcome, forecast=forecast, planned=planned)

    def _executed(self, step: Array, tension: float, gaps: Array | None) -> None:
        """Pull the model along, compare the tension, and see whether the hypotheses are far enough apart."""
        self._hypotheses.advance(step)
        if gaps is not None:
            self._hypotheses.see(gaps)
        self._past = np.vstack([self._past[1:], step])
        expected = float(self._hypotheses.tension[self._config.planner.hypothesis])
        if math.isfinite(tension) and expected > 0.02:
            # The force sensor is noisy: the ratio follows slowly.
            self._scale += 0.3 * (float(np.clip((tension - self._preload) / expected, 0.3, 10.0)) - self._scale)
        stretch = self._hypotheses.stretch()
        self._stretches.append(stretch)
        self._separations.append(self._hypotheses.separation(stretch))
        self._strains.append(float(self._hypotheses.strain[self._config.planner.hypothesis]))
        self.stop = self._decided()

    def _decided(self) -> Stop | None:
        """Stop when what matters is clear, or when it only gets worse."""
        c, apart = self._config, self._separations
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
        apart = self._separations[-1] if self._separations else 0.0
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
