"""What is expected of the edges: the tissue seen, the likeliest model of it, and the model pulled along with the jaws."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hardware.codes import Code
from hardware.interface import GRASPER, Array, Frame, StereoFrame
from skills.expose import expected
from skills.expose.expected import (
    LEAST_PULL,
    Expected,
    Pulled,
    Sight,
    SightConfig,
    Tissue,
    expected_of,
    likeliest,
    sight,
    tissue_seen,
)
from skills.expose.hypotheses import Hypotheses, SeparationConfig
from skills.expose.model import ModelConfig, TissueModel, build_model
from skills.expose.pull import Stop
from skills.expose.xpbd import XpbdConfig, XpbdSolver, rest_state
from skills.scene.stereo import StereoConfig
from skills.scene.surface import SurfaceConfig, SurfaceOutcome
from skills.scene.tissue import TissueConfig
from tests.mocks.bench import CAMERA
from tests.mocks.exposing import ACROSS, GRASP, TISSUE, UP, goal_on_sheet, grid_on_sheet, sheet, show, take_sheet
from tests.mocks.table import Table

GOAL, GRID = goal_on_sheet(), grid_on_sheet()
CROSSING = np.flatnonzero(GRID.crosses_goal)
STEP = 0.5e-3 * ACROSS
XPBD = XpbdConfig()
SEPARATION = SeparationConfig(quantile=0.05)
PLATE = ModelConfig(stretch=1000.0, bending=2e-4, adhesion=2e6, free_adhesion=2e6, adhesion_limit=2e-3, grasp_radius=3e-3)
UNPULLED = Pulled(np.zeros(3), 0.0)
NAN = float("nan")


def config(*tissues: ModelConfig) -> SightConfig:
    return SightConfig(SurfaceConfig(), tissues or (TISSUE,), StereoConfig(), TissueConfig(), XPBD, 130.0)


def seen(pulled: Pulled = UNPULLED, grasp: Array = GRASP) -> Sight:
    """A look at the sheet."""
    picture = np.full((CAMERA.height, CAMERA.width, 3), 128, np.uint8)
    return Sight(StereoFrame(Frame(1, 0.0, picture), picture), CAMERA, GOAL, GRID, grasp, 0.3, pulled)


def tissue(*kinds: ModelConfig, pulled: Pulled = UNPULLED) -> Tissue:
    found = tissue_seen(seen(pulled), config(*kinds))
    assert isinstance(found, Tissue)
    return found


def following() -> Expected:
    made = expected_of(tissue(), seen(), SEPARATION, XPBD)
    assert isinstance(made, Expected)
    return made


@pytest.fixture(autouse=True)
def _seen(monkeypatch: pytest.MonkeyPatch) -> None:
    show(monkeypatch)


# ------------------------------------------------------------ a look at the tissue


def holding(back: Array, test_pull: float = 2e-3) -> Sight:
    """What is seen of tissue that was retracted by `back` (3,) [m] since the jaws closed, with 0.3 N; the test pull met 0.8 N."""
    table = Table()
    grasped = take_sheet(table.bench)
    table.pull(0.3)
    origin = grasped.origin.moved(-back)
    held = replace(grasped, origin=origin, test_pull=test_pull, test_tension=0.8)
    return sight(table.lease, GOAL, GRID, held)


def test_a_look_says_where_the_jaws_are_and_what_they_meet():
    found = holding(5e-3 * ACROSS)

    assert found.grasp == pytest.approx(GRASP)
    assert found.tension == pytest.approx(0.3)
    assert found.goal is GOAL and found.grid is GRID
    assert found.pair.left.image.shape == (CAMERA.height, CAMERA.width, 3)


def test_a_pull_longer_than_the_test_pull_tells_more():
    retracted, tested = holding(5e-3 * ACROSS).pulled, holding(1e-3 * ACROSS).pulled

    assert (retracted.tension, retracted.displacement) == (pytest.approx(0.3), pytest.approx(5e-3 * ACROSS))
    assert (tested.tension, tested.displacement) == (0.8, pytest.approx(2e-3 * UP))


def test_without_a_test_pull_the_retraction_is_all_there_is():
    assert holding(1e-4 * ACROSS, test_pull=0.0).pulled.displacement == pytest.approx(1e-4 * ACROSS)


@pytest.mark.parametrize("code", [Code.SURFACE_INVALID, Code.DEPTH_INVALID])
def test_a_surface_that_cannot_be_used_is_said_with_its_own_code(monkeypatch, code):
    show(monkeypatch, SurfaceOutcome(code, "The surface is of no use."))

    stop = tissue_seen(seen(), config())

    assert stop == Stop(code, "The surface is of no use.", code)


def test_a_grasp_off_the_surface_carries_no_model():
    stop = tissue_seen(seen(grasp=GRASP + 60e-3 * ACROSS), config())

    assert isinstance(stop, Stop)
    assert stop.code is stop.stopped_by is Code.SURFACE_INVALID
    assert "grasp" in stop.message


def test_a_goal_too_short_for_the_surface_carries_no_model(monkeypatch):
    show(monkeypatch, SurfaceOutcome(Code.OK, "", replace(sheet(), goal_length=0.1, station=sheet().station + 3.0)))

    stop = tissue_seen(seen(), config())

    assert isinstance(stop, Stop) and stop.code is Code.SURFACE_INVALID


def test_hypotheses_that_cannot_be_made_are_a_surface_of_no_use(monkeypatch):
    found = tissue()

    def refused(*_: Any) -> Hypotheses:
        raise ValueError("a seam without a station")

    monkeypatch.setattr(expected, "Hypotheses", refused)

    stop = expected_of(found, seen(), SEPARATION, XPBD)

    assert isinstance(stop, Stop) and stop.code is Code.SURFACE_INVALID
    assert "a seam without a station" in stop.message


def test_stereo_is_matched_around_the_goal_and_the_grasp_only(monkeypatch):
    regions = []
    flat = expected.depth_from_stereo

    def noted(pair: StereoFrame, camera: Any, stereo: StereoConfig, region: Any) -> Any:
        regions.append(region)
        return flat(pair, camera, stereo, region)

    monkeypatch.setattr(expected, "depth_from_stereo", noted)
    tissue_seen(seen(), replace(config(), margin=20.0))

    ((u0, v0, u1, v1),) = regions
    inside = np.vstack([GOAL.near, GOAL.far, CAMERA.project(GRASP[None])])
    assert (u0, v0) <= tuple(inside.min(axis=0)) and (u1, v1) >= tuple(inside.max(axis=0))
    assert np.abs(np.array([u0, v0]) - inside.min(axis=0) + 20).max() <= 1.0
    assert np.abs(np.array([u1, v1]) - inside.max(axis=0) - 20).max() <= 2.0


# ------------------------------------------------------------ what the tissue is like


def models() -> list[TissueModel]:
    return [build_model(sheet(), GRASP, kind) for kind in (TISSUE, PLATE)]


def met(model: TissueModel, way: Array) -> float:
    """Tension [N] of `model` after a pull along `way` [m], the goal connected."""
    steps = max(1, round(float(np.linalg.norm(way)) / LEAST_PULL))
    solver = XpbdSolver(model, 1, steps, threads=1)
    return float(solver.rollout(rest_state(model), np.broadcast_to(way / steps, (1, steps, 3))).tension[-1, 0])


@pytest.mark.parametrize("way", [2e-3 * UP, 6e-3 * ACROSS], ids=["lifted", "retracted"])
def test_much_force_means_a_plate_and_little_a_membrane(way):
    membrane, plate = models()
    little, much = met(membrane, way), met(plate, way)

    assert much > 3 * little
    for order in ([membrane, plate], [plate, membrane]):
        assert likeliest(order, Pulled(way, 0.8 * little), XPBD) is membrane
        assert likeliest(order, Pulled(way, 1.2 * much), XPBD) is plate


@pytest.mark.parametrize(
    "pulled",
    [
        Pulled(np.zeros(3), 3.0),
        Pulled(0.1e-3 * UP, 3.0),
        Pulled(2e-3 * UP, 0.0),
        Pulled(2e-3 * UP, NAN),
    ],
    ids=["not pulled", "hardly pulled", "no tension", "tension unknown"],
)
def test_where_nothing_is_known_the_first_tissue_is_taken(pulled):
    for order in (models(), models()[::-1]):
        assert likeliest(order, pulled, XPBD) is order[0]


@pytest.mark.parametrize(("tension", "stiff"), [(0.02, False), (3.5, True)])
def test_the_pull_that_was_made_chooses_the_tissue(tension, stiff):
    chosen = tissue(TISSUE, PLATE, pulled=Pulled(2e-3 * UP, tension)).model

    assert (np.median(chosen.edge_compliance) < 0.3 * np.median(models()[0].edge_compliance)) == stiff


# ------------------------------------------------------------ pulled along


def test_before_the_first_step_there_is_a_forecast_without_rows():
    forecast = following().forecast()

    assert np.array_equal(forecast.edges, CROSSING)
    assert forecast.severed.shape == forecast.connected.shape == forecast.gap.shape == (0, len(CROSSING))
    assert forecast.separation.shape == (0,)


def test_the_forecast_has_a_row_for_each_step_and_follows_the_pull():
    followed = following()
    for _ in range(5):
        followed.executed(STEP, None)

    forecast = followed.forecast()

    assert forecast.severed.shape == forecast.connected.shape == forecast.gap.shape == (5, len(CROSSING))
    severed = np.median(forecast.severed, axis=1)
    assert (np.diff(severed) > 0.0).all()
    assert (np.diff(np.median(forecast.gap, axis=1)) > 0.0).all()
    assert (np.diff(forecast.separation) > 0.0).all()
    assert severed[-1] > np.median(forecast.connected[-1]) > 1.0


def test_rows_that_were_given_stay_as_they_were():
    followed = following()
    followed.executed(STEP, None)
    first = followed.forecast()
    followed.executed(STEP, None)

    second = followed.forecast()

    assert np.array_equal(second.severed[:1], first.severed)
    assert len(first.severed) == 1


def test_a_step_that_is_no_motion_changes_no_length():
    followed = following()
    followed.executed(STEP, None)
    followed.executed(np.zeros(3), None)

    forecast = followed.forecast()

    assert forecast.severed[1] == pytest.approx(forecast.severed[0], rel=0.1)


def test_what_is_seen_to_part_or_to_hold_tells_the_edges_apart():
    def apart(gaps: Array | None) -> float:
        followed = following()
        for _ in range(4):
            followed.executed(STEP, gaps)
        return float(followed.forecast().separation[-1])

    wide = np.where(GRID.crosses_goal, 30.0, np.nan)

    assert apart(wide) > apart(None) > 0.0
    assert apart(np.full(len(GRID.edges), NAN)) == apart(None)


def test_the_jaws_of_the_table_are_the_graspers():
    table = Table()
    held = take_sheet(table.bench)

    found = sight(table.lease, GOAL, GRID, held)

    assert found.grasp == pytest.approx(table.lease.measured_cp(GRASPER).value.position)
