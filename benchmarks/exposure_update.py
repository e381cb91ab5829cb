"""A whole MPPI update on a synthetic scene: what `benchmarks.exposure` times as one step of the exposure controller."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hardware.interface import Array, CameraModel
from skills.expose.model import TissueModel, build_model
from skills.expose.mppi import MppiConfig
from skills.expose.planner import Limits, Plan, Planner, PlannerConfig, Situation
from skills.expose.region import region_around
from skills.expose.smoothing import Predicted, Smoother, SmoothingConfig, SmoothingProblem
from skills.expose.xpbd import State, XpbdConfig, XpbdSolver, rest_state
from skills.scene.lattice import Lattice
from skills.scene.surface import Surface

CAMERA = CameraModel(640, 480, 620.0, 319.5, 239.5, 0.0043)
EXTENT = 320.0  # px, the lattice's side: 40 mm at the distance below
DISTANCE = 0.0775  # m from the camera to the lattice's middle
SLOPE = np.radians(20.0)
BUMP = 0.004  # m
TENSION, STRAIN = 6.0, 1.0  # N and share: limits that the smoothing keeps


@dataclass(frozen=True)
class Scene:
    """All that an update needs; made once per observation."""

    config: MppiConfig
    model: TissueModel
    state: State
    solver: XpbdSolver
    planner: Planner
    situation: Situation
    smoother: Smoother
    grasp: Array  # (3,) [m]
    toward: Array  # (3,) unit vector across the goal: where a plan starts


def scene(side: int, samples: int, horizon: int, threads: int) -> Scene:
    """A tilted sheet of `side` x `side` vertices over a bump, severed along a goal in its middle, grasped 10 mm beside it."""
    step = EXTENT / (side - 1)
    station: Array = step * (np.arange(side, dtype=np.float64) - side // 5)
    lateral: Array = step * (np.arange(side, dtype=np.float64) - side // 2)
    length = step * (side - 1 - 2 * (side // 5))
    lattice = Lattice(_pixels(station, lateral, length), station, lateral, length)
    pixels = lattice.pixels.reshape(-1, 2)
    columns, rows = (part.ravel() for part in np.meshgrid(np.arange(side), np.arange(side)))
    surface = Surface(
        stamp=0.0,
        vertices=_placed(pixels),
        triangles=lattice.triangles(np.ones((CAMERA.height, CAMERA.width), bool)),
        pixels=pixels,
        station=station[columns],
        lateral=lateral[rows],
        border=(columns % (side - 1) == 0) | (rows % (side - 1) == 0),
        measured=np.ones(side * side, bool),
        goal_length=length,
    )
    goal = _pixels(np.array([0.0, length / 2, length]), np.zeros(1), length)[0]
    ahead = _placed(_pixels(np.array([length / 2]), np.array([0.0, 80.0]), length)[:, 0])
    grasp = ahead[1]
    model = build_model(surface, grasp)
    region = region_around(goal, grasp, surface, CAMERA)
    config = MppiConfig(samples=samples, horizon=horizon)
    toward = (ahead[1] - ahead[0]) / np.linalg.norm(ahead[1] - ahead[0])
    planning = PlannerConfig(mppi=config, xpbd=XpbdConfig(substeps=2, iterations=10))
    limits = Limits(grasp - 0.03, grasp + 0.03, TENSION, STRAIN)
    planner = Planner(model, surface, region, CAMERA, limits, planning, np.random.default_rng(1), "cpu", threads)
    planner.begin(toward, grasp)
    return Scene(
        config=config,
        model=model,
        state=rest_state(model, joined=0.0),
        solver=XpbdSolver(model, samples, horizon, XpbdConfig(substeps=2, iterations=10), threads=threads),
        planner=planner,
        situation=Situation(grasp, grasp - 0.02 * toward, np.zeros((2, 3)), 0.0, 1.0),
        smoother=Smoother(SmoothingConfig(max_step=config.max_step), horizon),
        grasp=grasp,
        toward=toward,
    )


def mppi_update(scene: Scene) -> Plan:
    """One planning step of the controller as it is: sample, roll out, judge, average and smooth."""
    return scene.planner.update(scene.state, scene.situation)


def smoothing_problems(scene: Scene, count: int, rng: np.random.Generator) -> list[SmoothingProblem]:
    """A pull along a slowly turning direction, jittering as averages of noisy samples do, with all limits."""
    horizon, longest = scene.config.horizon, scene.config.max_step
    past, problems = np.zeros((2, 3)), []
    side = np.cross(scene.toward, [0.0, 0.0, 1.0])
    for turn in np.linspace(0.0, 1.0, count):
        direction = np.cos(turn) * scene.toward + np.sin(turn) * side
        nominal = 0.9 * longest * direction + 0.1e-3 * rng.standard_normal((horizon, 3))
        predicted = Predicted(np.linspace(2.0, 4.0, horizon), np.tile(300.0 * direction, (horizon, 1)), TENSION)
        problem = SmoothingProblem(
            nominal, scene.grasp, past, scene.grasp - 0.03, scene.grasp + 0.03, scene.grasp - 0.02 * scene.toward
        )
        problems.append(replace(problem, tension=predicted, strain=replace(predicted, limit=5.0)))
        past = np.stack([past[1], 0.9 * longest * direction])
    return problems


def _pixels(station: Array, lateral: Array, length: float) -> Array:
    """Pixels (rows, columns, 2) of a goal that runs to the right, with its near side below it."""
    u, v = np.meshgrid(station - length / 2, lateral)
    return np.stack([u + CAMERA.cu, v + CAMERA.cv], axis=-1)


def _placed(pixels: Array) -> Array:
    """Points (N, 3) [m] of `pixels` (N, 2) on a plane tilted about the image's u axis, with a bump beside the middle.

    A flat sheet would buckle to either side by rounding alone, so that no two solvers could agree on where it goes.
    """
    rays = CAMERA.unproject(pixels, np.ones(len(pixels)))
    normal = np.array([0.0, np.sin(SLOPE), -np.cos(SLOPE)])
    height = BUMP * np.exp(-((np.linalg.norm(pixels - [CAMERA.cu + 20.0, CAMERA.cv - 30.0], axis=1) / 130.0) ** 2))
    return np.asarray(rays * (normal[2] * DISTANCE / (rays @ normal) - height)[:, None])
