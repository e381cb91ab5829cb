"""A pull that somebody else steers goes where it would have gone, and what was expected of it is told beside."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hardware.codes import Code
from hardware.interface import GRASPER, Array
from skills.estimate.grid import Grid
from skills.expose import foreseen
from skills.expose.expected import SightConfig, expected_of, sight, tissue_seen
from skills.expose.foreseen import SteeringForeseen
from skills.expose.hypotheses import SeparationConfig
from skills.expose.outcome import ExposeOutcome, Forecast
from skills.expose.pull import Exposure, PullConfig, Steering, Stop
from skills.expose.straight import Direction, SteeringStraight
from skills.expose.xpbd import XpbdConfig
from skills.grasp import Grasped
from skills.scene.stereo import StereoConfig
from skills.scene.surface import SurfaceConfig, SurfaceOutcome
from skills.scene.tissue import TissueConfig
from skills.skill import ImmediateExecutor, Progress, Steps
from skills.tracking.tracks import TrackedGoal
from tests.mocks.exposing import (
    ACROSS,
    ALONG,
    GRASP,
    TISSUE,
    HangingExecutor,
    RecordingExecutor,
    goal_on_sheet,
    grid_on_sheet,
    show,
    take_sheet,
)
from tests.mocks.table import Table
from tests.skills.test_pull import ScriptedSteering

GOAL, GRID = goal_on_sheet(), grid_on_sheet()
CROSSING = np.flatnonzero(GRID.crosses_goal)
STEP = 0.5e-3 * ACROSS
SIGHT = SightConfig(SurfaceConfig(), (TISSUE,), StereoConfig(), TissueConfig(), XpbdConfig(), 130.0)
SEPARATION = SeparationConfig(quantile=0.05)


def winding(number: int) -> Array:
    """A pull across the goal that goes to and fro along it."""
    return 0.5e-3 * (np.cos(number) * ALONG + ACROSS) / np.hypot(np.cos(number), 1.0)


class Foreseen:
    """An exposure of the synthetic sheet by `steering`, foreseen unless told otherwise; set what is to be different, then `finish`."""

    def __init__(
        self,
        steering: Steering | None = None,
        steps: int = 4,
        executor: Executor | None = None,
        gaps: Callable[[], Array | None] = lambda: None,
        foreseeing: bool = True,
    ) -> None:
        self.table = Table()
        self.bench, self.lease = self.table.bench, self.table.lease
        self.grasped: Grasped | None = take_sheet(self.bench)
        self.table.pull(0.3)
        self.inside: Any = steering or ScriptedSteering(winding)
        self.outside = SteeringForeseen(self.inside, SIGHT, SEPARATION, executor or ImmediateExecutor(), gaps)
        self.exposure = Exposure(PullConfig(steps=steps, settle=0.05), self.outside if foreseeing else self.inside)
        self.lost_after = 10**6  # steps
        self.forecasts: list[Forecast | None] = []  # after each step

    def tracked(self) -> TrackedGoal:
        if self.exposure.pulling:
            self.forecasts.append(self.exposure.forecast())
        return replace(GOAL, lost=len(self.forecasts) >= self.lost_after)

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


def expected_after(path: Array, gaps: Array | None = None) -> Forecast:
    """What is expected when the model is moved along `path` (S, 3) [m] by hand."""
    table = Table()
    seen = sight(table.lease, GOAL, GRID, take_sheet(table.bench))
    tissue = tissue_seen(seen, SIGHT)
    assert not isinstance(tissue, Stop)
    expected = expected_of(tissue, seen, SEPARATION, SIGHT.xpbd)
    assert not isinstance(expected, Stop)
    for step in np.diff(np.vstack([GRASP, path]), axis=0):
        expected.executed(step, gaps)
    return expected.forecast()


def forecast_of(outcome: ExposeOutcome, steps: int) -> Forecast:
    """The forecast of a pull of so many steps, one row for each of them."""
    forecast = outcome.forecast
    assert forecast is not None
    assert len(outcome.path) == steps
    assert np.array_equal(forecast.edges, CROSSING)
    assert forecast.severed.shape == forecast.connected.shape == forecast.gap.shape == (steps, len(CROSSING))
    assert forecast.separation.shape == (steps,)
    return forecast


@pytest.fixture(autouse=True)
def _seen(monkeypatch: pytest.MonkeyPatch) -> None:
    show(monkeypatch)


# ------------------------------------------------------------ the pull


@pytest.mark.parametrize("steer", [winding, lambda number: STEP], ids=["winding", "straight"])
def test_it_steers_exactly_as_the_steering_inside(steer):
    alone, foreseen = (Foreseen(ScriptedSteering(steer), foreseeing=told).finish() for told in (False, True))

    assert np.array_equal(foreseen.path, alone.path)
    assert (foreseen.code, foreseen.stopped_by) == (alone.code, alone.stopped_by)
    assert alone.forecast is None and foreseen.forecast is not None


def test_a_straight_pull_with_a_look_of_its_own_stays_straight(monkeypatch):
    monkeypatch.setattr("skills.expose.straight.goal_normal", lambda *_: ACROSS)
    straight = SteeringStraight(Direction.GOAL_NORMAL, 0.5e-3, StereoConfig(), ImmediateExecutor())

    outcome = Foreseen(straight, steps=3).finish()

    assert outcome.path == pytest.approx(GRASP + 0.5e-3 * np.arange(1, 4)[:, None] * ACROSS)
    forecast_of(outcome, 3)


def test_the_steering_inside_is_asked_and_told_what_it_would_have_been_alone():
    alone, foreseen = Foreseen(foreseeing=False), Foreseen()

    alone.finish()
    outcome = foreseen.finish()

    assert [number for number, _ in foreseen.inside.asked] == [number for number, _ in alone.inside.asked] == [1, 2, 3, 4]
    assert np.array_equal([here for _, here in foreseen.inside.asked], [here for _, here in alone.inside.asked])
    assert foreseen.inside.begun[0][1] is GRID
    assert len(foreseen.inside.reported) == 1
    assert outcome.message.endswith("(reported)")


def test_a_steering_that_refuses_to_begin_is_believed_and_nothing_is_built():
    refused, executor = Stop(Code.DEPTH_INVALID, "it is dark", Code.DEPTH_INVALID), RecordingExecutor()
    pull = Foreseen(ScriptedSteering(begins=refused), executor=executor)

    outcome = pull.finish()

    assert (outcome.code, outcome.forecast) == (Code.DEPTH_INVALID, None)
    assert executor.ran == []
    assert not pull.bench.motions(GRASPER)


@pytest.mark.parametrize("after", [0, 1, 3])
def test_a_steering_that_stops_ends_the_pull_with_a_row_for_each_step_made(after):
    far = Stop(Code.OK, "far enough", Code.EXPOSURE_SEPARATED)

    outcome = Foreseen(ScriptedSteering(lambda number: far if number > after else winding(number)), steps=8).finish()

    assert (outcome.code, outcome.stopped_by) == (Code.OK, Code.EXPOSURE_SEPARATED)
    forecast_of(outcome, after)


# ------------------------------------------------------------ what was expected


@pytest.mark.parametrize("steps", [1, 2, 5])
def test_each_step_has_its_row_the_last_one_too(steps):
    outcome = Foreseen(steps=steps).finish()

    forecast = forecast_of(outcome, steps)
    by_hand = expected_after(outcome.path)
    assert forecast.severed == pytest.approx(by_hand.severed, rel=1e-4)
    assert forecast.connected == pytest.approx(by_hand.connected, rel=1e-4)


def test_the_model_goes_where_the_jaws_went():
    across = Foreseen(ScriptedSteering(lambda number: STEP), steps=5).finish()
    along = Foreseen(ScriptedSteering(lambda number: 0.5e-3 * ALONG), steps=5).finish()

    assert np.median(forecast_of(across, 5).severed[-1]) > 1.1 * np.median(forecast_of(along, 5).severed[-1])


def test_on_the_way_the_forecast_has_the_steps_before_the_newest():
    pull = Foreseen(steps=4)
    pull.finish()

    rows = [0 if told is None else len(told.severed) for told in pull.forecasts]
    assert rows[0] == 0 and max(rows) == 3
    assert (np.diff(rows) >= 0).all()


def test_after_the_pull_the_exposure_still_knows_what_was_expected_of_all_of_it():
    pull = Foreseen(steps=3)
    outcome = pull.finish()

    after = pull.exposure.forecast()
    assert after is not None
    assert np.array_equal(after.severed, forecast_of(outcome, 3).severed)


def test_a_step_that_a_limit_refused_has_no_row():
    def pulls_harder(number: int) -> Array:
        pull.bench.grasper.force = np.array([0.0, 1.5 * number, 0.0])
        pull.bench.advance(0.1)
        return STEP

    pull = Foreseen(ScriptedSteering(pulls_harder), steps=8)

    outcome = pull.finish()

    assert outcome.stopped_by is Code.TENSION
    forecast_of(outcome, len(outcome.path))
    assert 0 < len(outcome.path) < 8


def test_a_step_after_which_the_goal_was_lost_has_its_row():
    pull = Foreseen(steps=8)
    pull.lost_after = 3

    outcome = pull.finish()

    assert outcome.stopped_by is Code.GOAL_LOST
    forecast_of(outcome, len(outcome.path))


def test_a_pull_that_is_broken_off_keeps_what_was_expected_of_its_steps():
    pull = Foreseen(steps=8)
    steps = pull.run()
    while pull.exposure.steps_done < 3:
        next(steps)
        pull.bench.advance(1 / 30)
    steps.close()

    told = pull.exposure.forecast()
    assert told is not None and 2 <= len(told.severed) <= 3
    assert pull.bench.holding()


def test_openings_seen_on_the_way_are_taken_in():
    wide = np.where(GRID.crosses_goal, 30.0, np.nan)

    seen, blind = Foreseen(gaps=lambda: wide).finish(), Foreseen().finish()

    assert forecast_of(seen, 4).separation[-1] > forecast_of(blind, 4).separation[-1]


def test_the_newest_openings_are_taken_in_with_the_last_step():
    closed = np.where(GRID.crosses_goal, 0.0, np.nan)
    known = iter([closed, closed, closed])  # then all of it is seen to part

    outcome = Foreseen(gaps=lambda: next(known, 30.0 + closed)).finish()

    separation = forecast_of(outcome, 4).separation
    assert separation[-1] > 2 * separation[-2]


def test_a_second_pull_starts_afresh():
    pull = Foreseen(ScriptedSteering(lambda number: STEP), steps=4)
    first = forecast_of(pull.finish(), 4)

    second = forecast_of(pull.finish(), 4)

    # The tissue is held farther off by then.
    assert np.median(second.severed[0]) == pytest.approx(np.median(first.severed[0]), abs=0.03)
    assert np.median(first.severed[-1]) > np.median(first.severed[0]) + 0.1


# ------------------------------------------------------------ nothing expected


@pytest.mark.parametrize("code", [Code.SURFACE_INVALID, Code.DEPTH_INVALID])
def test_where_no_surface_is_seen_nothing_is_expected_and_the_pull_goes_on(monkeypatch, code):
    show(monkeypatch, SurfaceOutcome(code, "dark"))

    outcome, alone = Foreseen().finish(), Foreseen(foreseeing=False).finish()

    assert (outcome.code, outcome.stopped_by, len(outcome.path)) == (Code.OK, Code.EXPOSURE_STEPS_DONE, 4)
    assert outcome.forecast is None
    assert outcome.message == alone.message
    assert np.array_equal(outcome.path, alone.path)


def test_where_no_hypotheses_can_be_made_nothing_is_expected_and_the_pull_goes_on(monkeypatch):
    no = Stop(Code.SURFACE_INVALID, "no model", Code.SURFACE_INVALID)
    monkeypatch.setattr(foreseen, "expected_of", lambda *_: no)
    pull = Foreseen()

    outcome = pull.finish()

    assert len(outcome.path) == 4
    assert outcome.forecast is pull.exposure.forecast() is None


def test_a_look_that_fails_forgets_the_pull_before(monkeypatch):
    pull = Foreseen(steps=2)
    forecast_of(pull.finish(), 2)
    show(monkeypatch, SurfaceOutcome(Code.DEPTH_INVALID, "dark"))

    outcome = pull.finish()

    assert outcome.forecast is pull.exposure.forecast() is None
    assert len(outcome.path) == 2


def test_a_steering_that_refuses_a_second_pull_leaves_no_forecast_of_the_first():
    pull = Foreseen(steps=2)
    forecast_of(pull.finish(), 2)
    pull.inside.begins = Stop(Code.DEPTH_INVALID, "it is dark", Code.DEPTH_INVALID)

    outcome = pull.finish()

    assert outcome.code is Code.DEPTH_INVALID
    assert outcome.forecast is pull.exposure.forecast() is None


def test_an_exposure_that_never_looked_has_no_forecast_of_an_earlier_one():
    pull = Foreseen(steps=2)
    forecast_of(pull.finish(), 2)
    pull.grasped = None

    outcome = pull.finish()

    assert outcome.code is Code.GRASP_EMPTY
    assert outcome.forecast is pull.exposure.forecast() is None


# ------------------------------------------------------------ who computes


def test_the_model_is_built_and_followed_on_the_executor():
    executor = RecordingExecutor()

    Foreseen(steps=3, executor=executor).finish()

    assert len(executor.ran) == 3  # the model, and the first two steps; the last one is followed when the pull is reported
    assert len(set(executor.ran)) == 2


def ticks(pull: Foreseen, steps: Steps[Any], until: Callable[[], bool], most: int = 300) -> Iterator[Progress]:
    """Tick `steps` until something is so."""
    for _ in range(most):
        if until():
            return
        yield next(steps)
        pull.bench.advance(1 / 30)
    raise AssertionError("it never became so")


@pytest.mark.parametrize(("free", "doing"), [(0, "building the tissue model"), (1, "following the pull")])
def test_the_pull_waits_while_the_model_is_computed_and_goes_on_after(free, doing):
    executor = HangingExecutor(free)
    pull = Foreseen(steps=2, executor=executor)
    steps = pull.run()
    list(ticks(pull, steps, lambda: executor.busy > 0))
    before = len(pull.bench.motions())

    said = [next(steps).message for _ in range(10)]
    assert set(said) == {doing}
    assert len(pull.bench.motions()) == before

    executor.finish()
    if free == 0:
        list(ticks(pull, steps, lambda: executor.busy > 0))  # the first step is to be followed
        executor.finish()
    forecast_of(pull.table.finish(steps), 2)


@pytest.mark.parametrize("free", [0, 1])
def test_closed_while_the_model_is_computed_it_leaves_both_arms_holding(free):
    executor = HangingExecutor(free)
    pull = Foreseen(steps=3, executor=executor)
    steps = pull.run()
    list(ticks(pull, steps, lambda: executor.busy > 0))

    steps.close()

    assert pull.bench.holding()
    executor.finish()  # a result that comes too late
    assert pull.bench.holding()
