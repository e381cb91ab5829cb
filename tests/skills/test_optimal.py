"""The controller on a table with a synthetic sheet: it sees, plans each step, stops in time, and says what it expected."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from hardware.codes import Code
from hardware.interface import GRASPER, Array
from skills.estimate.grid import Grid
from skills.expose import expected, optimal
from skills.expose.expected import Pulled
from skills.expose.hypotheses import Hypotheses, SeparationConfig, Stretch
from skills.expose.model import ModelConfig, TissueModel, build_model
from skills.expose.optimal import OptimalConfig, SteeringOptimal, View
from skills.expose.outcome import ExposeOutcome, Planned
from skills.expose.planner import Objective, Plan, Planner
from skills.expose.pull import Exposure, PullConfig
from skills.expose.xpbd import XpbdConfig
from skills.grasp import Grasped
from skills.scene.surface import SurfaceOutcome
from skills.skill import Progress, Steps
from skills.tracking.tracks import TrackedGoal
from tests.mocks.exposing import (
    ACROSS,
    GRASP,
    TISSUE,
    UP,
    HangingExecutor,
    RecordingExecutor,
    goal_on_sheet,
    grid_on_sheet,
    planning,
    sheet,
    show,
    steering,
    take_sheet,
)
from tests.mocks.table import Table

GRID = grid_on_sheet()
CROSSING = np.flatnonzero(GRID.crosses_goal)
NEVER: dict[str, Any] = {"stop_early": False}
STEP = 0.5e-3
PLATE = ModelConfig(stretch=1000.0, bending=2e-4, adhesion=2e6, free_adhesion=2e6, adhesion_limit=2e-3, grasp_radius=3e-3)


class Exposing:
    """An exposure of the synthetic sheet under the controller; set what is to be different, then `finish`."""

    def __init__(
        self, steps: int = 5, executor: Executor | None = None, gaps: Callable[[], Array | None] = lambda: None, **settings: Any
    ) -> None:
        self.table = Table()
        self.bench, self.lease = self.table.bench, self.table.lease
        self.grasped: Grasped = take_sheet(self.bench)
        self.table.pull(0.3)
        self.steering: SteeringOptimal = steering(executor, gaps, **settings)
        self.exposure = Exposure(PullConfig(step=STEP, steps=steps, settle=0.05), self.steering)
        self.stiffness = 0.0  # [N/m] of what pulls at the jaws, beside the 0.3 N of the beginning
        self.views: list[View | None] = []  # after each step

    def tracked(self) -> TrackedGoal:
        moved = np.linalg.norm(self.bench.grasper.pose.position - GRASP)
        if moved > 0:
            self.bench.grasper.force = np.array([0.0, 0.3 + self.stiffness * moved, 0.0])
            self.views.append(self.steering.view)
        return goal_on_sheet()

    def run(self) -> Steps[ExposeOutcome]:
        def mark() -> Steps[Grid | None]:
            yield Progress("taking the reference")
            return GRID

        return self.exposure.run(self.lease, self.tracked, self.grasped, self.bench.cutter.pose, mark)

    def finish(self) -> ExposeOutcome:
        """The outcome of the exposure, after which both arms hold."""
        outcome = self.table.finish(self.run())
        assert self.bench.holding()
        return outcome

    def moved(self) -> bool:
        """Whether the grasper was sent anywhere."""
        return bool(self.bench.motions(GRASPER))


@pytest.fixture(autouse=True)
def _seen(monkeypatch: pytest.MonkeyPatch) -> None:
    show(monkeypatch)


@pytest.fixture
def apart(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Give the separations that the hypotheses reach step by step; the last one stays."""

    def script(*values: float) -> None:
        left = list(values)

        def separation(self: Hypotheses, stretch: Stretch) -> float:
            return left.pop(0) if len(left) > 1 else left[0]

        monkeypatch.setattr(Hypotheses, "separation", separation)

    return script


def hold_at(monkeypatch: pytest.MonkeyPatch, step: int, code: Code = Code.EXPOSURE_INFEASIBLE) -> None:
    """Let the planner find no plan for step `step`."""
    update, count = Planner.update, iter(range(1, 1000))

    def scripted(self: Planner, *args: Any) -> Plan:
        plan = update(self, *args)
        return replace(plan, code=code, message="no way", step=np.zeros(3)) if next(count) == step else plan

    monkeypatch.setattr(Planner, "update", scripted)


# ------------------------------------------------------------ the pull


@pytest.mark.parametrize("objective", list(Objective))
def test_the_tissue_is_pulled_across_the_goal(objective):
    outcome = Exposing(8, planner=planning(objective=objective), **NEVER).finish()

    way = outcome.path[-1] - GRASP
    assert (outcome.code, outcome.stopped_by) == (Code.OK, Code.EXPOSURE_STEPS_DONE)
    assert way @ ACROSS > 0.8 * np.linalg.norm(way)
    assert np.linalg.norm(way) > 0.7 * 8 * STEP
    steps = np.diff(np.vstack([GRASP, outcome.path]), axis=0)
    assert np.linalg.norm(steps, axis=1).max() <= STEP * (1 + 1e-6)


def test_the_same_seed_makes_the_same_pull():
    one, two, other = (Exposing(4, seed=seed, **NEVER).finish() for seed in (1, 1, 2))

    assert np.array_equal(one.path, two.path)
    assert one.planned is not None and two.planned is not None
    assert np.array_equal(one.planned.opening, two.planned.opening)
    assert not np.allclose(one.path, other.path)


def test_a_second_run_starts_afresh():
    exposing = Exposing(3, **NEVER)
    first = exposing.finish()

    second = exposing.finish()

    assert first.forecast is not None and second.forecast is not None
    assert second.forecast.severed.shape == first.forecast.severed.shape == (3, len(CROSSING))
    assert second.forecast.severed[0] == pytest.approx(first.forecast.severed[0], abs=0.05)


def test_where_the_depth_beside_the_goal_is_unknown_the_first_guess_comes_from_the_surface(monkeypatch):
    show(monkeypatch, depth=float("nan"))
    guesses: list[Array] = []
    begin = Planner.begin

    def noted(self: Planner, guess: Array, gripper: Array) -> None:
        guesses.append(guess)
        begin(self, guess, gripper)

    monkeypatch.setattr(Planner, "begin", noted)

    outcome = Exposing(2).finish()

    (guess,) = guesses
    assert guess / np.linalg.norm(guess) == pytest.approx(ACROSS, abs=1e-6)
    assert len(outcome.path) == 2


# ------------------------------------------------------------ what cannot be seen


@pytest.mark.parametrize("code", [Code.SURFACE_INVALID, Code.DEPTH_INVALID])
def test_a_surface_that_cannot_be_used_ends_it_before_anything_moves(monkeypatch, code):
    show(monkeypatch, SurfaceOutcome(code, "The surface is of no use."))
    exposing = Exposing()

    outcome = exposing.finish()

    assert outcome.code is outcome.stopped_by is code
    assert "of no use" in outcome.message
    assert not exposing.moved()
    assert outcome.forecast is outcome.planned is exposing.steering.view is None


def test_a_grasp_off_the_surface_is_a_surface_of_no_use():
    exposing = Exposing()
    exposing.grasped = take_sheet(exposing.bench, GRASP + 60e-3 * ACROSS)

    outcome = exposing.finish()

    assert outcome.code is outcome.stopped_by is Code.SURFACE_INVALID
    assert "grasp" in outcome.message
    assert not exposing.moved()


def test_a_goal_too_short_for_the_surface_is_a_surface_of_no_use(monkeypatch):
    show(monkeypatch, SurfaceOutcome(Code.OK, "", replace(sheet(), goal_length=0.1, station=sheet().station + 3.0)))
    exposing = Exposing()

    outcome = exposing.finish()

    assert outcome.code is outcome.stopped_by is Code.SURFACE_INVALID
    assert not exposing.moved()


def test_a_failed_look_forgets_the_run_before(monkeypatch):
    exposing = Exposing(2, **NEVER)
    assert exposing.finish().forecast is not None
    show(monkeypatch, SurfaceOutcome(Code.DEPTH_INVALID, "dark"))

    outcome = exposing.finish()

    assert outcome.code is Code.DEPTH_INVALID
    assert outcome.forecast is outcome.planned is exposing.steering.view is None


# ------------------------------------------------------------ what the tissue is like


def models() -> list[TissueModel]:
    return [build_model(sheet(), GRASP, config) for config in (TISSUE, PLATE)]


@pytest.mark.parametrize(("tension", "stiff"), [(0.02, False), (3.5, True)])
def test_the_test_pull_of_the_grasp_chooses_the_tissue(monkeypatch, tension, stiff):
    chosen: list[TissueModel] = []

    def noted(model: TissueModel, *rest: Any) -> Planner:
        chosen.append(model)
        return Planner(model, *rest)

    monkeypatch.setattr(optimal, "Planner", noted)
    exposing = Exposing(1, tissues=(TISSUE, PLATE))
    exposing.grasped = replace(exposing.grasped, test_pull=2e-3, test_tension=tension)

    exposing.finish()

    compliance = np.median(chosen[0].edge_compliance)
    assert (compliance < 0.3 * np.median(models()[0].edge_compliance)) == stiff


def test_a_pull_longer_than_the_test_pull_tells_more(monkeypatch):
    asked: list[Pulled] = []

    def note(models: list[TissueModel], pulled: Pulled, config: XpbdConfig) -> TissueModel:
        asked.append(pulled)
        return models[0]

    monkeypatch.setattr(expected, "likeliest", note)
    for back in (1e-3, 5e-3):
        exposing = Exposing(1)
        origin = exposing.grasped.origin.moved(-back * ACROSS)
        exposing.grasped = replace(exposing.grasped, origin=origin, test_pull=2e-3, test_tension=0.8)
        exposing.finish()

    tested, retracted = asked
    assert (tested.tension, tested.displacement) == (0.8, pytest.approx(2e-3 * UP))
    assert (retracted.tension, retracted.displacement) == (pytest.approx(0.3), pytest.approx(5e-3 * ACROSS))


# ------------------------------------------------------------ when to stop


def test_it_stops_once_severed_and_connected_are_far_enough_apart(apart):
    apart(0.5, 1.0, 2.0, 9.0)

    outcome = Exposing(12, least_steps=2).finish()

    assert (outcome.code, outcome.stopped_by) == (Code.OK, Code.EXPOSURE_SEPARATED)
    assert len(outcome.path) == 4
    assert "9.0 standard deviations" in outcome.message


def test_the_hypotheses_of_a_pull_come_apart_by_themselves():
    enough = Exposing(4, **NEVER).finish().forecast
    assert enough is not None
    separation = SeparationConfig(enough=float(enough.separation[2]), pixel_error=1.5, model_error=0.2, quantile=0.05)

    outcome = Exposing(12, least_steps=1, separation=separation).finish()

    assert outcome.stopped_by is Code.EXPOSURE_SEPARATED
    assert len(outcome.path) == 3


def test_openings_seen_on_the_way_tell_them_apart():
    wide = np.where(GRID.crosses_goal, 30.0, np.nan)

    outcome = Exposing(12, gaps=lambda: wide, least_steps=3).finish()

    assert (outcome.stopped_by, len(outcome.path)) == (Code.EXPOSURE_SEPARATED, 3)


def test_it_makes_the_least_steps_whatever_it_knows(apart):
    apart(50.0)

    outcome = Exposing(12, least_steps=5).finish()

    assert (outcome.stopped_by, len(outcome.path)) == (Code.EXPOSURE_SEPARATED, 5)


def test_it_stops_when_the_tissue_is_stretched_to_its_budget(apart):
    apart(0.1, 0.2, 0.3, 0.4)

    # Without smoothing nothing keeps the plan itself within the budget.
    outcome = Exposing(12, least_steps=1, strain_budget=0.08, planner=planning(smooth=False)).finish()

    assert (outcome.code, outcome.stopped_by) == (Code.OK, Code.STRAIN)
    assert 1 < len(outcome.path) < 8
    assert "stretched" in outcome.message


def test_it_stops_when_the_best_is_behind(apart):
    apart(0.5, 1.5, 2.5, 2.4, 2.3, 2.2, 2.1)

    outcome = Exposing(12, least_steps=1, patience=3, worth=1.0).finish()

    assert (outcome.code, outcome.stopped_by) == (Code.OK, Code.EXPOSURE_SEPARATED)
    assert len(outcome.path) == 6
    assert "2.5 standard deviations" in outcome.message


def test_patience_begins_anew_with_every_better_separation(apart):
    apart(1.5, 1.4, 1.3, 1.6, 1.4, 1.3, 1.2)

    assert len(Exposing(12, least_steps=1, patience=3, worth=1.0).finish().path) == 7


def test_a_separation_that_is_worth_nothing_is_not_waited_for(apart):
    apart(0.9, 0.8, 0.7, 0.6)

    outcome = Exposing(8, least_steps=1, patience=2, worth=1.0).finish()

    assert (outcome.stopped_by, len(outcome.path)) == (Code.EXPOSURE_STEPS_DONE, 8)


@pytest.mark.parametrize("values", [(50.0,), (2.5, 2.4, 2.3)], ids=["apart", "past the best"])
def test_told_not_to_stop_early_it_makes_all_steps(apart, values):
    apart(*values)

    outcome = Exposing(8, least_steps=1, patience=2, worth=1.0, strain_budget=0.5, stop_early=False).finish()

    assert (outcome.stopped_by, len(outcome.path)) == (Code.EXPOSURE_STEPS_DONE, 8)


def test_without_a_first_plan_it_fails_and_nothing_moves(monkeypatch):
    hold_at(monkeypatch, 1)
    exposing = Exposing()

    outcome = exposing.finish()

    assert outcome.code is outcome.stopped_by is Code.EXPOSURE_INFEASIBLE
    assert not exposing.moved()


def test_without_a_later_plan_what_was_pulled_is_good(monkeypatch):
    hold_at(monkeypatch, 4, Code.SMOOTHING_INFEASIBLE)

    outcome = Exposing(8, **NEVER).finish()

    assert (outcome.code, outcome.stopped_by) == (Code.OK, Code.SMOOTHING_INFEASIBLE)
    assert outcome.message == "pulled 3 of 8 steps: no way"
    assert len(outcome.path) == 3


def test_tissue_under_too_much_tension_is_not_pulled_further():
    exposing = Exposing(tension_budget=0.5)
    exposing.bench.grasper.force = np.array([0.0, 3.0, 0.0])
    exposing.bench.advance(0.1)

    outcome = exposing.finish()

    assert outcome.code is outcome.stopped_by is Code.SMOOTHING_INFEASIBLE
    assert not exposing.moved()


def test_samples_that_cancel_each_other_decide_nothing():
    exposing = Exposing(least_agreement=1.1)

    outcome = exposing.finish()

    assert outcome.code is outcome.stopped_by is Code.EXPOSURE_INFEASIBLE
    assert "cancel" in outcome.message
    assert not exposing.moved()


# ------------------------------------------------------------ what is reported


def assert_one_row_a_step(outcome: ExposeOutcome, steps: int) -> None:
    assert outcome.forecast is not None and outcome.planned is not None
    assert np.array_equal(outcome.forecast.edges, CROSSING)
    assert outcome.forecast.severed.shape == outcome.forecast.connected.shape == (steps, len(CROSSING))
    assert outcome.forecast.separation.shape == (steps,)
    for field in fields(Planned):
        values = getattr(outcome.planned, field.name)
        assert values.shape == (steps,)
        assert np.isfinite(values).all()


@pytest.mark.parametrize("steps", [1, 5])
def test_the_report_has_a_row_for_each_step(steps):
    outcome = Exposing(steps, **NEVER).finish()

    assert len(outcome.path) == steps
    assert_one_row_a_step(outcome, steps)


def test_the_report_has_a_row_for_each_step_when_the_controller_stops_early(apart):
    apart(0.5, 9.0)

    outcome = Exposing(12, least_steps=1).finish()

    assert len(outcome.path) == 2
    assert_one_row_a_step(outcome, 2)
    assert outcome.forecast is not None
    assert outcome.forecast.separation == pytest.approx([0.5, 9.0])


def test_the_report_has_a_row_for_each_step_when_a_limit_stops_a_step():
    exposing = Exposing(12, tension_budget=50.0, **NEVER)
    exposing.stiffness = 3.8 / (3 * STEP)  # the gate's limit of 4 N, within a few steps

    outcome = exposing.finish()

    assert outcome.stopped_by is Code.TENSION
    assert 0 < len(outcome.path) < 12
    assert_one_row_a_step(outcome, len(outcome.path))


def test_the_report_has_no_row_when_no_step_was_made(monkeypatch):
    hold_at(monkeypatch, 1)

    outcome = Exposing().finish()

    assert outcome.path.shape == (0, 3)
    assert_one_row_a_step(outcome, 0)


def test_what_was_expected_is_told_on_the_way_and_after_the_report():
    exposing = Exposing(2)
    before = exposing.exposure.forecast()

    outcome = exposing.finish()

    after = exposing.exposure.forecast()
    assert before is None and after is not None and outcome.forecast is not None
    assert after.gap.shape == after.severed.shape == (2, len(after.edges))
    assert np.array_equal(after.gap, outcome.forecast.gap, equal_nan=True)


def test_the_forecast_follows_the_pull():
    forecast = Exposing(6, **NEVER).finish().forecast

    assert forecast is not None
    severed = np.median(forecast.severed, axis=1)
    assert (np.diff(severed) > 0.0).all()
    assert (np.diff(forecast.separation) > 0.0).all()
    assert severed[-1] > np.median(forecast.connected[-1]) > 1.0


# ------------------------------------------------------------ tension


def test_the_expected_tension_begins_at_the_measured_one_and_follows_it():
    soft, stiff = Exposing(10, **NEVER), Exposing(10, **NEVER)
    stiff.stiffness = 400.0

    low, high = soft.finish(), stiff.finish()

    assert low.planned is not None and high.planned is not None
    assert low.planned.tension[0] == high.planned.tension[0] > 0.3
    assert low.planned.tension[-1] < 0.6
    assert high.planned.tension[-1] == pytest.approx(high.tension[-1], rel=0.4)


def test_tension_that_is_unknown_breaks_nothing(monkeypatch):
    exposing = Exposing(5, **NEVER)
    monkeypatch.setattr(exposing.lease, "tension", lambda: float("nan"))

    outcome = exposing.finish()

    assert (outcome.stopped_by, len(outcome.path)) == (Code.EXPOSURE_STEPS_DONE, 5)
    assert_one_row_a_step(outcome, 5)


def test_tension_that_becomes_unknown_is_passed_over(monkeypatch):
    exposing, steady = Exposing(6, **NEVER), Exposing(6, **NEVER)
    known = iter([0.3, 0.3, 0.3])
    monkeypatch.setattr(exposing.lease, "tension", lambda: next(known, float("nan")))

    lost, kept = exposing.finish(), steady.finish()

    assert lost.planned is not None and kept.planned is not None
    assert len(lost.path) == 6
    assert lost.planned.tension == pytest.approx(kept.planned.tension, rel=0.5)


# ------------------------------------------------------------ what people see, and who computes


def test_every_planned_step_can_be_looked_at():
    exposing = Exposing(4, **NEVER)

    outcome = exposing.finish()

    before = np.vstack([GRASP, outcome.path[:-1]])
    assert [view.number for view in exposing.views if view] == [1, 2, 3, 4]
    for view, here in zip(exposing.views, before, strict=True):
        assert view is not None
        assert view.paths.shape == (16, 4, 3)
        assert view.plan.shape == (4, 3)
        assert view.paths[:, 0] == pytest.approx(np.tile(here, (16, 1)))
        assert view.plan[0] == pytest.approx(here)
        assert view.vertices.shape[1] == 3
        assert view.triangles.max() < len(view.vertices)
        assert np.isfinite(view.vertices).all()
        assert np.isfinite([view.opening, view.camera, view.deform, view.tension, view.separation]).all()


def test_the_mesh_that_is_shown_moves_with_the_jaws():
    exposing = Exposing(4, **NEVER)

    outcome = exposing.finish()

    first, last = exposing.views[0], exposing.views[-1]
    assert first is not None and last is not None
    carried = np.linalg.norm(last.vertices - first.vertices, axis=1).max()
    assert carried == pytest.approx(np.linalg.norm(outcome.path[-2] - GRASP), rel=0.05)


def test_a_view_is_there_also_when_there_is_no_plan(monkeypatch):
    hold_at(monkeypatch, 1)
    exposing = Exposing()

    exposing.finish()

    assert exposing.steering.view is not None and exposing.steering.view.number == 1


def test_the_computations_are_left_to_the_executor():
    executor = RecordingExecutor()

    Exposing(3, executor=executor, **NEVER).finish()

    assert len(executor.ran) == 4  # the model, and one plan a step
    assert len(set(executor.ran)) == 2


def ticks(exposing: Exposing, steps: Steps[Any], until: Callable[[], bool], most: int = 300) -> Iterator[Progress]:
    """Tick `steps` until something is so."""
    for _ in range(most):
        if until():
            return
        yield next(steps)
        exposing.bench.advance(1 / 30)
    raise AssertionError("it never became so")


@pytest.mark.parametrize(("free", "doing"), [(0, "model"), (2, "planning step 2")])
def test_the_skill_goes_on_yielding_while_something_is_computed(free, doing):
    executor = HangingExecutor(free)
    exposing = Exposing(3, executor=executor)
    steps = exposing.run()
    list(ticks(exposing, steps, lambda: executor.busy > 0))
    before = len(exposing.bench.motions())

    said = [next(steps).message for _ in range(20)]

    assert all(doing in message for message in said)
    assert len(exposing.bench.motions()) == before


def test_the_pull_goes_on_when_the_computation_is_done():
    executor = HangingExecutor(2)
    exposing = Exposing(2, executor=executor)
    steps = exposing.run()
    list(ticks(exposing, steps, lambda: executor.busy > 0))

    executor.finish()
    outcome = exposing.table.finish(steps)

    assert len(outcome.path) == 2


@pytest.mark.parametrize("free", [0, 1, 2])
def test_closed_while_something_is_computed_it_leaves_both_arms_holding(free):
    executor = HangingExecutor(free)
    exposing = Exposing(3, executor=executor)
    steps = exposing.run()
    list(ticks(exposing, steps, lambda: executor.busy > 0))

    steps.close()

    assert exposing.bench.holding()
    assert [command.name for command in exposing.bench.log if command.arm == GRASPER][-1] == "hold"
    executor.finish()  # a result that comes too late
    assert exposing.bench.holding()


def test_an_error_in_a_computation_is_not_swallowed_and_the_arms_hold(monkeypatch):
    def broken(self: Planner, *args: Any) -> Plan:
        raise RuntimeError("out of memory")

    monkeypatch.setattr(Planner, "update", broken)
    exposing = Exposing()

    with pytest.raises(RuntimeError, match="out of memory"):
        exposing.finish()

    assert exposing.bench.holding()


def test_a_pull_that_uses_up_its_strain_budget_ends_there_and_does_not_creep(apart):
    apart(*np.linspace(0.01, 0.3, 40))  # nothing else ends it

    outcome = Exposing(20, least_steps=1, strain_budget=0.15).finish()

    assert outcome.stopped_by is Code.STRAIN


def test_a_decided_stop_is_reported_though_there_is_no_further_plan(monkeypatch, apart):
    apart(0.5, 9.0)
    hold_at(monkeypatch, 3, Code.SMOOTHING_INFEASIBLE)

    outcome = Exposing(8, least_steps=1).finish()

    assert (len(outcome.path), outcome.stopped_by) == (2, Code.EXPOSURE_SEPARATED)


def test_an_exposure_that_never_looked_has_no_forecast_of_an_earlier_one():
    exposing = Exposing(5, **NEVER)
    steps = exposing.run()
    for _ in range(16):
        next(steps)
        exposing.bench.advance(1 / 30)
    steps.close()
    exposing.grasped = None

    outcome = exposing.finish()

    assert outcome.code is Code.GRASP_EMPTY
    assert outcome.forecast is None and outcome.planned is None


@pytest.mark.parametrize(
    "wrong",
    [{"tissues": ()}, {"least_steps": 0}, {"patience": 0}, {"tension_budget": 0.0}, {"strain_budget": 0.0}, {"margin": -1.0}],
)
def test_settings_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValueError):
        OptimalConfig(**wrong)
