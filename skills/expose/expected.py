"""What is expected of the edges across the goal while somebody pulls: the tissue seen at t_d, pulled along in the model."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hardware.codes import Code
from hardware.gate import Lease
from hardware.interface import GRASPER, Array, CameraModel, StereoFrame
from skills.estimate.grid import Grid
from skills.expose.hypotheses import Hypotheses, SeparationConfig, Stretch
from skills.expose.model import ModelConfig, TissueModel, build_model
from skills.expose.outcome import Forecast
from skills.expose.pull import Stop
from skills.expose.xpbd import State, XpbdConfig, XpbdSolver, rest_state
from skills.grasp import Grasped
from skills.scene.stereo import DepthMap, StereoConfig, depth_from_stereo, region_around
from skills.scene.surface import Surface, SurfaceConfig, reconstruct
from skills.scene.tissue import TissueConfig, tissue_mask, tool_mask
from skills.tracking.tracks import TrackedGoal

LEAST_PULL = 0.5e-3  # [m] below which the force says nothing about the tissue
MEMBRANE = ModelConfig()
PLATE = ModelConfig(stretch=1000.0, bending=2e-4, free_adhesion=2e6, adhesion_limit=2e-3)


@dataclass(frozen=True)
class Pulled:
    """A pull that was made: its displacement (3,) [m] from where the jaws closed, and the tension [N] that it met."""

    displacement: Array
    tension: float


@dataclass(frozen=True)
class Sight:
    """What was seen at t_d, to build a model from."""

    pair: StereoFrame
    camera: CameraModel
    goal: TrackedGoal
    grid: Grid
    grasp: Array  # (3,) [m]
    tension: float  # [N]
    pulled: Pulled


@dataclass(frozen=True)
class SightConfig:
    """How the tissue is seen and modelled.

    `tissues` are what the tissue may be like: a soft sheet over a prepared plane, or a thick flap that still sticks to its bed. The force
    that the grasp met so far chooses between them, since a membrane can be pulled back in its plane and a plate cannot.
    """

    surface: SurfaceConfig
    tissues: tuple[ModelConfig, ...]
    stereo: StereoConfig
    tissue: TissueConfig
    xpbd: XpbdConfig
    margin: float  # [px] around the goal that is matched in stereo


@dataclass(frozen=True)
class Tissue:
    """The tissue seen at t_d, and the likeliest model of it."""

    surface: Surface
    model: TissueModel
    depth: DepthMap


def sight(lease: Lease, goal: TrackedGoal, grid: Grid, grasped: Grasped) -> Sight:
    """Look: the newest stereo pair, where the jaws are, and the last pull that says something about the tissue."""
    position, tension = lease.measured_cp(GRASPER).value.position, lease.tension()
    pulled = Pulled(lease.setpoint_cp(GRASPER).position - grasped.origin.position, tension)
    if float(np.linalg.norm(pulled.displacement)) < grasped.test_pull:
        pulled = Pulled(grasped.test_pull * grasped.normal, grasped.test_tension)
    return Sight(lease.endoscope.stereo(), lease.endoscope.camera, goal, grid, position, tension, pulled)


def tissue_seen(seen: Sight, config: SightConfig) -> Tissue | Stop:
    """Reconstruct the surface and build the likeliest model on it, or say why that cannot be done."""
    camera, goal = seen.camera, seen.goal
    pixel = camera.project(seen.grasp[None])[0]
    box = region_around(np.vstack([goal.near, goal.far, pixel]), config.margin, (camera.width, camera.height))
    depth = depth_from_stereo(seen.pair, camera, config.stereo, box)
    image = seen.pair.left.image
    tissue, tools = tissue_mask(image, config.tissue), tool_mask(image, config.tissue)
    outcome = reconstruct(depth, camera, tissue, tools, goal.polyline, pixel, config.surface)
    if outcome.surface is None:
        return Stop(outcome.code, outcome.message, outcome.code)
    try:
        models = [build_model(outcome.surface, seen.grasp, kind) for kind in config.tissues]
        return Tissue(outcome.surface, likeliest(models, seen.pulled, config.xpbd), depth)
    except ValueError as error:
        return no_model(error)


def no_model(error: ValueError) -> Stop:
    """A grasp off the surface, a goal too short for the lattice, a region all hidden: the picture does not carry a model."""
    return Stop(Code.SURFACE_INVALID, f"no tissue model can be built on the surface seen: {error}", Code.SURFACE_INVALID)


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


class Expected:
    """The hypotheses pulled along with the jaws, and what they said after each step. One thread."""

    def __init__(self, tissue: Tissue, grid: Grid, camera: CameraModel, separation: SeparationConfig, xpbd: XpbdConfig) -> None:
        self.hypotheses = Hypotheses(tissue.model, tissue.surface, grid, camera, separation, xpbd, "cpu")
        self.stretches: list[Stretch] = []
        self.separations: list[float] = []

    def executed(self, step: Array, gaps: Array | None) -> None:
        """The jaws were moved by `step` (3,) [m]; `gaps` (E,) [px] are openings along the grid's edges, nan undecided."""
        self.hypotheses.advance(step)
        if gaps is not None:
            self.hypotheses.see(gaps)
        self.stretches.append(self.hypotheses.stretch())
        self.separations.append(self.hypotheses.separation(self.stretches[-1]))

    def forecast(self) -> Forecast:
        """What was expected after each step."""
        edges = self.hypotheses.edges

        def table(name: str) -> Array:
            return np.array([getattr(stretch, name) for stretch in self.stretches]).reshape(-1, len(edges))

        return Forecast(edges, table("severed"), table("connected"), table("gap"), np.array(self.separations))


def expected_of(tissue: Tissue, seen: Sight, separation: SeparationConfig, xpbd: XpbdConfig) -> Expected | Stop:
    """Begin to expect something of `tissue`, or say why the picture carries no model."""
    try:
        return Expected(tissue, seen.grid, seen.camera, separation, xpbd)
    except ValueError as error:
        return no_model(error)
