"""A sheet of tissue before the mock bench's camera, seen from straight above, and executors that record or hang: what exposures need."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hardware.codes import Code
from hardware.interface import CUTTER, GRASPER, Array
from skills.estimate.grid import Grid, grid_around
from skills.expose import expected
from skills.expose.hypotheses import SeparationConfig
from skills.expose.model import ModelConfig
from skills.expose.mppi import MppiConfig
from skills.expose.optimal import OptimalConfig, SteeringOptimal
from skills.expose.planner import PlannerConfig
from skills.grasp import Grasped
from skills.scene.stereo import DepthMap, StereoConfig
from skills.scene.surface import Surface, SurfaceOutcome
from skills.scene.tissue import TissueConfig
from skills.skill import ImmediateExecutor
from skills.tracking.tracks import TrackedGoal
from tests.mocks.bench import CAMERA, MockBench
from tests.skills.goals import tracked_goal
from tests.skills.sheets import DEPTH, PIXEL, surface

ACROSS = np.array([1.0, 0.0, 0.0])  # the goal's normal, towards the grasp's side
ALONG = np.array([0.0, 1.0, 0.0])
UP = np.array([0.0, 0.0, -1.0])  # towards the camera
GRASP = np.array([7.5e-3, 0.0, DEPTH])  # [m], on the goal's normal
ROWS = 18.0  # [px] from the goal to either of its tracked rows
TISSUE = ModelConfig(
    stretch=80.0, bending=6e-6, adhesion=2e6, free_margin=8e-3, free_adhesion=1e5, adhesion_limit=1.5e-3, grasp_radius=3e-3
)


def sheet(goal: float = 20e-3, bump: float = 0.0) -> Surface:
    """A square of 50 mm with a `goal` [m] along y in its middle, as the mock bench's camera sees it; flat without a `bump` [m]."""
    made = surface(21, bump=bump, goal=goal)
    scale = CAMERA.focal / DEPTH * PIXEL
    return replace(
        made,
        pixels=CAMERA.project(made.vertices),
        station=made.station * scale,
        lateral=made.lateral * scale,
        goal_length=made.goal_length * scale,
    )


def polyline(goal: float = 20e-3) -> Array:
    """The `goal` [m] of `sheet` as pixels (21, 2), from its start."""
    reach = goal / 2 * CAMERA.focal / DEPTH
    return np.column_stack([np.full(21, CAMERA.cu), CAMERA.cv + np.linspace(-reach, reach, 21)])


def goal_on_sheet(strain: float = float("nan")) -> TrackedGoal:
    """The goal of `sheet` as tracked, the near row at x > 0."""
    u, v = CAMERA.project(GRASP)
    return replace(tracked_goal(polyline(), -ROWS, (float(u), float(v))), strain=strain)


def grid_on_sheet() -> Grid:
    """The keypoint grid round the goal of `sheet`."""
    return grid_around(goal_on_sheet(), ROWS)


def show(monkeypatch: pytest.MonkeyPatch, seen: SurfaceOutcome | None = None, depth: float = DEPTH) -> None:
    """Let the controller see `sheet`, or whatever `seen` says, at `depth` [m] everywhere."""
    found = seen or SurfaceOutcome(Code.OK, "a sheet", sheet())
    flat = DepthMap(0.0, np.full((CAMERA.height, CAMERA.width), depth), 1.0)
    monkeypatch.setattr(expected, "depth_from_stereo", lambda *_: flat)
    monkeypatch.setattr(expected, "reconstruct", lambda *_: found)


def planning(**settings: Any) -> PlannerConfig:
    """A planner that is quick: few samples, few steps ahead."""
    return PlannerConfig(mppi=MppiConfig(samples=16, horizon=3), **settings)


def steering(
    executor: Executor | None = None, gaps: Callable[[], Array | None] = lambda: None, seed: int = 0, **settings: Any
) -> SteeringOptimal:
    """The controller with a quick planner and one kind of tissue, unless `settings` of its configuration say otherwise."""
    quick: dict[str, Any] = {
        "planner": planning(),
        "tissues": (TISSUE,),
        "separation": SeparationConfig(pixel_error=1.5, model_error=0.2, quantile=0.05, enough=4.0, parted=1.5, expected=6.0),
        "least_steps": 6,
        "patience": 6,
        "worth": 1.0,
        "tension_budget": 0.9,
        "strain_budget": 1.0,
        "least_agreement": 0.2,
        "device": "cpu",
        "threads": 1,
    }
    config = OptimalConfig(**quick | settings)
    rng = np.random.default_rng(seed)
    return SteeringOptimal(config, StereoConfig(), TissueConfig(), executor or ImmediateExecutor(), rng, gaps)


def take_sheet(bench: MockBench, grasp: Array = GRASP) -> Grasped:
    """Close the jaws on the sheet at `grasp` (3,) [m], the scissors well away."""
    bench.arms[CUTTER].pose = bench.arms[CUTTER].pose.at(np.array([-0.03, -0.03, 0.05]))
    pose = bench.arms[GRASPER].pose.at(grasp)
    bench.arms[GRASPER].pose = pose
    return Grasped(pose, UP)


class RecordingExecutor(ImmediateExecutor):
    """Runs each call at once, and keeps the names of what it ran."""

    def __init__(self) -> None:
        self.ran: list[str] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:  # type: ignore[override]
        """Run `fn` now."""
        self.ran.append(fn.__name__)
        return super().submit(fn, *args, **kwargs)


class HangingExecutor(Executor):
    """Runs the first `free` calls at once; the others look as if a thread were busy with them, until `finish`."""

    def __init__(self, free: int = 0) -> None:
        self._free = free
        self._running: list[tuple[Future[Any], Callable[[], Any]]] = []

    @property
    def busy(self) -> int:
        """Calls that have not come to their end."""
        return len(self._running)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Begin `fn`; a call that has begun cannot be cancelled."""
        if self._free > 0:
            self._free -= 1
            return ImmediateExecutor().submit(fn, *args, **kwargs)
        future: Future[Any] = Future()
        future.set_running_or_notify_cancel()
        self._running.append((future, lambda: fn(*args, **kwargs)))
        return future

    def finish(self) -> None:
        """Let the calls that hang come to their end."""
        running, self._running = self._running, []
        for future, call in running:
            future.set_result(call())
