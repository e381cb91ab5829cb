"""What a session's skills tell the gate of the tissue's strain, and what they keep of a pull to judge the edges by.

The exposure, the gate and the arms are real or mocks with no tissue; tracker, depth and gauge say what the test wants.
"""

import math
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hardware.codes import Code
from hardware.interface import GRASPER, Array, MoveReport, MoveStatus
from skills.estimate.elongation import ElongationConfig
from skills.estimate.graph import EdgeState
from skills.estimate.grid import Grid, grid_around
from skills.estimate.likelihood import LikelihoodConfig
from skills.estimate.look import Look
from skills.estimate.rule import Rule
from skills.expose.outcome import ExposeOutcome, Forecast
from skills.grasp import Grasped
from skills.scene.goal import Goal
from skills.scene.stereo import DepthMap, Region
from skills.skill import ImmediateExecutor
from skills.tracking.choose import TrackerChoice
from skills.tracking.dis import TrackerDIS
from skills.tracking.lk import TrackerLK
from skills.tracking.strain import StrainConfig
from skills.tracking.tracks import TrackedGoal, Tracks
from supervisor import skillset
from supervisor.skillset import ExposureKind, SessionSkills, SkillConfig
from tests.mocks.bench import CAMERA
from tests.mocks.table import TICK, Table
from tests.skills.test_planning import goal
from tests.skills.test_pull import ScriptedSteering

GOAL = Goal(goal().polyline, goal().grasp, (CAMERA.width, CAMERA.height))
GRID = grid_around(goal(), 18.0)
PERIOD, PATIENCE = StrainConfig().period, StrainConfig().patience
LOOK = SkillConfig().track_period  # [s] between looks of the tracker
NAN = float("nan")
CROSSING = np.flatnonzero(GRID.crosses_goal)
FORECAST = Forecast(CROSSING, *(np.full((35, len(CROSSING)), rho) for rho in (6.0, 2.5, 30.0)), np.full(35, 3.0))


class Opening:
    """What opened so far along every edge [px]: as many tenths as there were looks."""

    def __init__(self, looks: int) -> None:
        self._width = 0.1 * looks

    def slit(self) -> Array:
        return self.parted()

    def stranded(self) -> NDArray[np.bool_]:
        return np.zeros(len(GRID.edges), dtype=bool)

    def parted(self) -> Array:
        return np.full(len(GRID.edges), self._width)

    def bed(self) -> Array:
        return np.full(len(GRID.edges), self._width / 2)

    def decided(self) -> Array:
        return np.full(len(GRID.edges), self._width / 3)


class FollowsNothing:
    """A tracker for which nothing ever moves; `points` are those of the grid now."""

    points = GRID.points

    def __init__(self, config: object, tracker: object) -> None:
        self.made_with = tracker
        self._stamp = 0.0
        self._looks = 0

    def start(self, frame, goal) -> TrackedGoal:
        return self.update(frame)

    def update(self, frame) -> TrackedGoal:
        self._stamp = frame.stamp
        self._looks += 1
        return self.tracked()

    def tracked(self) -> TrackedGoal:
        return replace(goal(), stamp=self._stamp)

    def mark_reference(self, frame) -> Grid:
        self.update(frame)
        return GRID

    def grid(self) -> Grid:
        return GRID

    def placed(self):
        return np.ones(len(GRID.points), dtype=bool)

    def grid_tracks(self) -> tuple[Array, Tracks, Grid]:
        count = len(GRID.points)
        return GRID.points, Tracks(self._stamp, self.points, np.ones(count, dtype=bool), np.ones(count)), GRID

    def gaps(self) -> Opening:
        return Opening(self._looks)


class Session:
    """A goal followed and held; `expose` pulls it, while `readings(t)` is the strain read `t` [s] after the newest reference."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, readings: Callable[[float], float] = lambda t: 0.1, **settings: Any
    ) -> None:
        self.table = Table()
        self.bench, self.gate = self.table.bench, self.table.gate
        self.readings = readings
        self.referenced: list[float] = []  # bench times [s] of
        self.looked: list[float] = []
        self.regions: list[Region] = []
        self.told: list[tuple[float, float]] = []  # bench time [s] and the strain that the gate was told
        self.pulled: list[float] = []  # bench times [s] at which a step was planned
        self._replace_parts(monkeypatch)
        config = SkillConfig(**{"exposure": ExposureKind.GOAL_NORMAL} | settings)
        self.skills = SessionSkills(self.gate, config, ImmediateExecutor(), 0, "", None)
        self._hold()
        self.table.finish(self.skills.start_tracking(GOAL))
        self._following = self.skills.track()

    def follow(self, duration: float) -> None:
        """Look on for `duration` [s]."""
        for _ in range(round(duration / TICK)):
            next(self._following)
            self.bench.advance(TICK)

    def expose(self) -> ExposeOutcome:
        """Pull to the end, the tracker looking on."""

        def both() -> Iterator:
            pull = self.skills.expose(self.table.lease)
            while True:
                next(self._following)
                try:
                    yield next(pull)
                except StopIteration as end:
                    return end.value

        return self.table.finish(both())

    def seen(self) -> TrackedGoal:
        tracked = self.skills.tracked()
        assert tracked is not None
        return tracked

    def pull_further(self) -> Code:
        """Servo the grasper by half a millimetre away from where it closed."""
        return self.table.servo(GRASPER, 0.3, 0.0, -0.4)

    def _replace_parts(self, monkeypatch: pytest.MonkeyPatch) -> None:
        session = self

        class Gauge:
            def __init__(self, grid, depth, camera, config) -> None:
                session.referenced.append(session.bench.now())

            def read(self, points, visible, confidence, depth) -> float:
                session.looked.append(session.bench.now())
                return session.readings(session.bench.now() - session.referenced[-1])

        def depth(pair, camera, config, region) -> DepthMap:
            self.regions.append(region)
            return DepthMap(pair.left.stamp, np.full((CAMERA.height, CAMERA.width), 0.08), 1.0)

        def tell(strain: float, stamp: float) -> None:
            self.told.append((self.bench.now(), strain))
            report(strain, stamp)

        def steer(number: int) -> Array:
            self.pulled.append(self.bench.now())
            return 0.5e-3 * np.array([0.6, 0.0, -0.8])

        def foreseen(steering: ScriptedSteering, sight: object, separation: object, executor: object, gaps: object) -> object:
            monkeypatch.setattr(steering, "forecast", lambda: FORECAST)
            self.gaps_told = gaps
            return steering

        report = self.gate.report_strain
        monkeypatch.setattr(self.gate, "report_strain", tell)
        monkeypatch.setattr(skillset, "GoalTracker", FollowsNothing)
        monkeypatch.setattr(skillset, "StrainGauge", Gauge)
        monkeypatch.setattr(skillset, "depth_from_stereo", depth)
        monkeypatch.setattr(skillset, "SteeringStraight", lambda *_: ScriptedSteering(steer))
        monkeypatch.setattr(skillset, "SteeringForeseen", foreseen)

    def _hold(self) -> None:
        """Tissue is in the jaws, 3 mm from where they closed."""
        start = self.bench.grasper.pose
        origin = start.moved(np.array([0.0, 3e-3, 0.0]))
        self.bench.grasper.pose = origin
        self.table.pull(0.3)
        self.bench.grasper.pose = start
        self.skills._agent.grasped = Grasped(origin, np.array([0.0, 0.0, -1.0]))


def test_nothing_is_told_before_the_reference(monkeypatch):
    session = Session(monkeypatch)

    session.follow(1.0)

    assert session.told == []
    assert math.isnan(session.seen().strain)


def test_the_gate_is_told_nought_at_the_reference(monkeypatch):
    session = Session(monkeypatch)
    session.gate.report_strain(NAN, session.bench.now())
    session.told.clear()

    session.expose()

    assert len(session.referenced) == 1
    assert session.told[0] == (session.referenced[0], 0.0)
    assert session.told[0][0] < session.pulled[0] < session.told[1][0]


def test_the_gate_is_told_each_reading_no_more_often_than_the_period(monkeypatch):
    session = Session(monkeypatch, readings=lambda t: 0.01 * t)

    outcome = session.expose()

    stamps = np.array([stamp for stamp, _ in session.told[1:]])
    assert outcome.stopped_by is Code.EXPOSURE_STEPS_DONE
    assert len(stamps) > 8
    assert (np.diff(stamps) > PERIOD - 1e-5).all()
    assert (np.diff(stamps) < PERIOD + LOOK + TICK).all()
    assert list(stamps) == session.looked
    assert [strain for _, strain in session.told[1:]] == pytest.approx(0.01 * (stamps - session.referenced[0]))


def test_nothing_is_told_when_the_pull_has_ended(monkeypatch):
    session = Session(monkeypatch)
    session.expose()
    told, ended = list(session.told), session.bench.now()

    session.follow(2.0)

    assert session.told == told
    assert session.told[-1][0] <= ended
    assert session.seen().stamp > ended


def test_the_tracked_goal_carries_what_was_read(monkeypatch):
    session = Session(monkeypatch, readings=lambda t: 0.1 + 0.02 * t)

    outcome = session.expose()
    session.follow(2 * LOOK)

    assert session.seen().strain == session.told[-1][1] == session.gate.strain()
    assert np.isfinite(outcome.strain).all()
    assert set(outcome.strain) <= {strain for _, strain in session.told}
    assert outcome.strain[-1] == pytest.approx(0.1 + 0.02 * (outcome.stamps[-1] - session.referenced[0]), abs=0.01)


def test_a_reading_at_the_limit_ends_the_pull(monkeypatch):
    session = Session(monkeypatch, readings=lambda t: 0.6 if t > 1.5 else 0.1)

    outcome = session.expose()

    assert (outcome.code, outcome.stopped_by) == (Code.OK, Code.STRAIN)
    assert "stretched by 60%" in outcome.message
    assert session.pulled[-1] - session.referenced[0] < 1.5 + PERIOD + 2 * LOOK
    assert session.pull_further() is Code.STRAIN


def test_pulling_further_is_refused_when_no_look_was_usable_for_too_long(monkeypatch):
    session = Session(monkeypatch, readings=lambda t: 0.1 if t < 1.2 else NAN)

    outcome = session.expose()
    session.follow(2 * LOOK)

    usable = max(stamp for stamp in session.looked if stamp - session.referenced[0] < 1.2)
    unknown = min(stamp for stamp, strain in session.told if math.isnan(strain))
    assert PATIENCE < unknown - usable < PATIENCE + PERIOD + LOOK
    assert {strain for stamp, strain in session.told if usable <= stamp < unknown} == {0.1}
    assert (outcome.code, outcome.stopped_by) == (Code.OK, Code.STRAIN)
    assert "strain of the tissue is unknown" in outcome.message
    assert session.pulled[-1] - usable < PATIENCE + PERIOD + 2 * LOOK
    assert session.pull_further() is Code.STRAIN
    assert math.isnan(session.seen().strain)


def test_a_gauge_that_never_reads_lets_no_pull_go_on(monkeypatch):
    session = Session(monkeypatch, readings=lambda t: NAN)

    outcome = session.expose()

    assert outcome.stopped_by is Code.STRAIN
    assert "strain of the tissue is unknown" in outcome.message
    assert {strain for stamp, strain in session.told if stamp - session.referenced[0] < PATIENCE} == {0.0}


def test_looks_that_fail_for_less_than_the_patience_change_nothing(monkeypatch):
    session = Session(monkeypatch, readings=lambda t: NAN if 1.0 < t < 1.6 else 0.1)

    outcome = session.expose()

    assert outcome.stopped_by is Code.EXPOSURE_STEPS_DONE
    assert {strain for _, strain in session.told[1:]} == {0.1}


def test_a_strain_that_was_unknown_is_known_again_after_a_usable_look(monkeypatch):
    session = Session(monkeypatch, readings=lambda t: NAN)
    session.expose()
    refused = session.pull_further()
    session.readings = lambda t: 0.2

    session.skills._exposure.pulling = True  # as in the next steps of a pull
    session.follow(PERIOD + 2 * LOOK)

    assert refused is Code.STRAIN
    assert session.gate.strain() == session.seen().strain == 0.2
    assert session.pull_further() is Code.OK


def test_a_new_reference_starts_from_nought_again(monkeypatch):
    session = Session(monkeypatch, readings=lambda t: NAN)
    session.expose()
    session.follow(1.0)
    first, session.readings = len(session.told), lambda t: 0.15

    outcome = session.expose()

    assert len(session.referenced) == 2
    assert session.told[first] == (session.referenced[1], 0.0)
    assert {strain for _, strain in session.told[first + 1 :]} == {0.15}
    assert outcome.stopped_by is Code.EXPOSURE_STEPS_DONE
    assert np.isfinite(outcome.strain).all()


def test_depth_is_measured_around_the_keypoints_that_are_finite(monkeypatch):
    points = GRID.points + np.array([10.0, 0.0])
    points[0] = np.nan
    monkeypatch.setattr(FollowsNothing, "points", points)
    session = Session(monkeypatch)

    session.expose()

    margin = StrainConfig().margin
    # The first is that of the goal's length at t_d.
    assert len(session.regions) == len(session.told) + 1
    for region, around in ((session.regions[1], GRID.points), (session.regions[-1], points[1:])):
        assert np.abs(np.array(region[:2]) - (around.min(axis=0) - margin)).max() <= 1.0
        assert np.abs(np.array(region[2:]) - (around.max(axis=0) + margin)).max() <= 2.0


def test_keypoints_of_which_none_is_finite_are_a_look_that_was_not_usable(monkeypatch):
    monkeypatch.setattr(FollowsNothing, "points", np.full_like(GRID.points, np.nan))
    session = Session(monkeypatch, readings=lambda t: NAN)
    assert session.expose().stopped_by is Code.STRAIN


def test_the_goal_carries_nought_from_the_reference_on(monkeypatch):
    session = Session(monkeypatch)
    gen = session.skills.expose(session.table.lease)
    while not session.referenced:
        next(session._following)
        next(gen)
        session.bench.advance(1 / 30)
    assert session.seen().strain == 0.0


# What is kept of a pull to judge the edges by


@dataclass
class Judged:
    """What the estimate was given."""

    looks: list[Look]
    forecast: Forecast | None
    config: LikelihoodConfig


def judged(session: Session, monkeypatch: pytest.MonkeyPatch) -> Judged:
    """Estimate, and say on what."""
    given: list[Judged] = []
    estimate = skillset.by_likelihood

    def noted(grid, reference, looks, forecast, config):
        given.append(Judged(list(looks), forecast, config))
        return estimate(grid, reference, looks, forecast, config)

    with monkeypatch.context() as patch:
        patch.setattr(skillset, "by_likelihood", noted)
        session.table.finish(session.skills.estimate())
    (only,) = given
    return only


def test_a_look_is_kept_once_a_step_and_the_newest_frame_is_looked_at_last(monkeypatch):
    session = Session(monkeypatch)
    outcome = session.expose()
    session.follow(1.0)

    found = judged(session, monkeypatch)

    kept, last = found.looks[:-1], found.looks[-1]
    steps = [look.step for look in kept]
    assert len(outcome.path) == 35
    assert len(steps) > 12 and steps[0] >= 1 and steps[-1] <= 35
    assert (np.diff(steps) > 0).all()
    assert (np.diff([look.tracks.stamp for look in kept]) > 0).all()
    assert last.step == 35
    assert last.tracks.stamp == session.seen().stamp > kept[-1].tracks.stamp


def test_what_opened_is_kept_as_it_was_at_each_look(monkeypatch):
    session = Session(monkeypatch)
    session.expose()

    looks = judged(session, monkeypatch).looks

    parted = [look.parted for look in looks]
    assert {widths.shape for widths in parted} == {(len(GRID.edges),)}
    assert (np.diff([widths[0] for widths in parted[:-1]]) > 0).all()
    assert np.array_equal([look.bed for look in looks], np.array(parted) / 2)


def test_looks_begin_anew_at_a_new_reference(monkeypatch):
    session = Session(monkeypatch)
    session.expose()
    session.follow(1.0)
    first = judged(session, monkeypatch).looks

    session.expose()
    second = judged(session, monkeypatch).looks

    assert len(session.referenced) == 2
    assert min(look.tracks.stamp for look in second) > session.referenced[1] >= max(look.tracks.stamp for look in first)
    steps = [look.step for look in second[:-1]]
    assert steps[0] <= 3 and (np.diff(steps) > 0).all()


def test_before_a_pull_and_when_it_has_ended_no_look_is_kept(monkeypatch):
    session = Session(monkeypatch)
    session.follow(1.0)
    assert [look.step for look in judged(session, monkeypatch).looks] == [0]
    session.expose()
    pulled = judged(session, monkeypatch).looks

    session.follow(2.0)

    assert [look.step for look in judged(session, monkeypatch).looks] == [look.step for look in pulled]


def test_the_forecast_of_the_pull_is_judged_by(monkeypatch):
    session = Session(monkeypatch, likelihood=LikelihoodConfig(severed=0.9))
    before = judged(session, monkeypatch)
    session.expose()

    after = judged(session, monkeypatch)

    assert (before.forecast, after.forecast) == (None, FORECAST)
    assert after.config == LikelihoodConfig(severed=0.9)


def test_what_an_earlier_pull_should_have_done_is_not_expected_of_a_pull_that_did_not_begin(monkeypatch):
    session = Session(monkeypatch)
    session.expose()
    session.skills._agent.grasped = None

    outcome = session.expose()

    assert outcome.code is Code.GRASP_EMPTY
    assert judged(session, monkeypatch).forecast is None


def test_tissue_that_slipped_from_the_jaws_is_grasped_anew_by_the_next_exposure(monkeypatch):
    session, taken = Session(monkeypatch), []
    held, run = session.skills.grasped, session.skills._exposure.run

    def slipping(*arguments):
        outcome = yield from run(*arguments)
        return replace(outcome, stopped_by=Code.GRASP_SLIPPED)

    def take_hold(lease, tracked, retraction):
        yield from ()
        taken.append(retraction)
        session.skills._agent.grasped, session.skills._agent.slipped = held, False
        return MoveReport(MoveStatus.DONE)

    monkeypatch.setattr(session.skills._exposure, "run", slipping)
    monkeypatch.setattr(session.skills._agent, "take_hold", take_hold)
    session.expose()
    assert session.skills.grasped is None
    monkeypatch.setattr(session.skills._exposure, "run", run)
    outcome = session.expose()

    assert outcome.stopped_by is Code.EXPOSURE_STEPS_DONE
    assert taken == [session.skills._config.planning.retraction]
    assert session.skills.grasped is held


def test_an_exposure_says_why_slipped_tissue_could_not_be_grasped_anew_and_expects_nothing(monkeypatch):
    session = Session(monkeypatch)
    session.expose()
    session.skills._agent.lose_grasp()

    outcome = session.expose()

    assert outcome.code is Code.DEPTH_INVALID  # where to grasp is not seen on this bench
    assert len(outcome.path) == 0
    assert judged(session, monkeypatch).forecast is None
    assert session.bench.holding()


def test_the_pull_is_foreseen_with_the_openings_that_are_decided_so_far(monkeypatch):
    session = Session(monkeypatch)
    session.follow(0.5)

    assert np.array_equal(session.gaps_told(), session.skills._tracker.gaps().decided())


class HalfWay(ImmediateExecutor):
    """While it is `stuck`, what it was given has changed things already and is not done."""

    stuck = False

    def submit(self, fn, /, *args, **kwargs):
        done = super().submit(fn, *args, **kwargs)
        return Future() if self.stuck else done


def test_while_the_tracker_works_on_a_frame_the_newest_finished_look_counts(monkeypatch):
    session = Session(monkeypatch, exposure=ExposureKind.OPTIMAL)
    session.expose()
    executor = session.skills._executor = HalfWay()
    session.follow(2 * LOOK)
    left = []
    monkeypatch.setattr(skillset, "last_in_sight", lambda grid, looks, *_: left.append(looks[-1]) or 1)
    session.skills._leave_at(35)
    told = session.skills._gaps()

    executor.stuck = True
    session.follow(2 * LOOK)
    session.skills._leave_at(35)

    assert not np.array_equal(told, session.skills._tracker.gaps().decided())
    assert np.array_equal(session.skills._gaps(), told)
    assert left[1].tracks.stamp == left[0].tracks.stamp == session.seen().stamp
    assert np.array_equal(left[1].parted, left[0].parted)
    assert left[1].step == session.skills.exposure_step


# What is chosen


def stretched(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the edges across the goal be 2.5 times as long as while it was closed."""
    points = GRID.points.copy()
    points[:, 1] += np.where(GRID.near_side, -0.75, 0.75) * GRID.closed_length
    monkeypatch.setattr(FollowsNothing, "points", points)
    monkeypatch.setattr(Opening, "parted", lambda self: np.zeros(len(GRID.edges)))
    monkeypatch.setattr(Opening, "bed", lambda self: np.zeros(len(GRID.edges)))


def test_both_rules_can_be_chosen_and_judge_a_stretched_attachment_differently(monkeypatch):
    stretched(monkeypatch)
    graphs = {}
    for rule in Rule:
        session = Session(monkeypatch, rule=rule)
        session.expose()
        graphs[rule] = session.table.finish(session.skills.estimate())

    assert (graphs[Rule.ELONGATION].state[CROSSING] == EdgeState.SEVERED).all()
    assert not (graphs[Rule.LIKELIHOOD].state == EdgeState.SEVERED).any()


def test_unless_told_otherwise_edges_are_judged_by_the_likelihood(monkeypatch):
    stretched(monkeypatch)
    session = Session(monkeypatch)
    session.expose()

    assert not (session.table.finish(session.skills.estimate()).state == EdgeState.SEVERED).any()


def test_the_threshold_of_the_elongation_rule_is_the_one_set(monkeypatch):
    stretched(monkeypatch)
    session = Session(monkeypatch, rule=Rule.ELONGATION, elongation=ElongationConfig(tau=2.6))
    session.expose()

    assert (session.table.finish(session.skills.estimate()).state[CROSSING] == EdgeState.CONNECTED).all()


@pytest.mark.parametrize("rule", list(Rule))
def test_what_would_be_judged_now_is_what_is_estimated(monkeypatch, rule):
    session = Session(monkeypatch, rule=rule)
    session.expose()

    now, later = session.skills.judge_now(), session.table.finish(session.skills.estimate())

    assert np.array_equal(now.state, later.state)
    assert np.array_equal(now.probability, later.probability)


@pytest.mark.parametrize(("kind", "made"), [("dis", TrackerDIS), ("lk", TrackerLK)])
def test_the_goal_is_followed_by_the_tracker_chosen(monkeypatch, kind, made):
    session = Session(monkeypatch, choice=TrackerChoice(kind))

    assert type(session.skills._tracker.made_with) is made
