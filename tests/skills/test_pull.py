"""An exposure goes exactly where its steering says, stops for good reasons, and leaves both arms holding whatever happens."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hardware.codes import Code
from hardware.interface import CUTTER, GRASPER, Array, Pose
from skills.estimate.grid import Grid, grid_around
from skills.expose.outcome import ExposeOutcome
from skills.expose.pull import Exposure, LeaveAt, PullConfig, Stop, where_it_ends
from skills.grasp import Grasped
from skills.skill import Progress, Steps
from skills.tracking.tracks import TrackedGoal
from tests.mocks.servo import lag, sent, stick
from tests.mocks.table import TICK, Table
from tests.skills.test_planning import goal

STEP = 0.5e-3 * np.array([0.6, 0.0, -0.8])  # [m] away from where the grasp closed
GRID = grid_around(goal(), 18.0)
FAR_ENOUGH = Stop(Code.OK, "far enough", Code.EXPOSURE_SEPARATED)
NO_WAY = Stop(Code.EXPOSURE_INFEASIBLE, "no pull is allowed", Code.EXPOSURE_INFEASIBLE)


class ScriptedSteering:
    """Steps as `steer(number)` says, which may also do things to the bench or raise; `begins` answers `begin`."""

    def __init__(self, steer: Callable[[int], Array | Stop] = lambda number: STEP, begins: Stop | None = None) -> None:
        self.steer, self.begins = steer, begins
        self.begun: list[tuple[TrackedGoal, Grid]] = []
        self.asked: list[tuple[int, Array]] = []
        self.reported: list[ExposeOutcome] = []
        self.turns = False

    def begin(self, lease, goal, grid, grasped) -> Steps[Stop | None]:
        yield Progress("scripted: looking")
        self.begun.append((goal, grid))
        return self.begins

    def step(self, lease, here, number) -> Steps[Array | Stop]:
        yield Progress("scripted: planning")
        self.asked.append((number, here))
        return self.steer(number)

    def forecast(self) -> None:
        return None

    def report(self, outcome) -> ExposeOutcome:
        self.reported.append(outcome)
        return replace(outcome, message=f"{outcome.message} (reported)")


class Pull:
    """An exposure of tissue that is held `retracted` [m] from where the jaws closed; set what is to be different, then `finish`."""

    def __init__(self, steering: ScriptedSteering | None = None, retracted: float = 3e-3, **settings) -> None:
        self.table = Table()
        self.bench = self.table.bench
        self.lease = self.table.lease
        self.start = self.lease.setpoint_cp(GRASPER)
        self.origin = self.start.moved(np.array([0.0, retracted, 0.0]))
        self.grasped: Grasped | None = Grasped(self.origin, np.array([0.0, 0.0, -1.0]))
        self.bench.grasper.pose = self.origin
        self.table.pull(0.3)
        self.bench.grasper.pose = self.start
        self.park = self.lease.setpoint_cp(CUTTER)
        self.steering = steering or ScriptedSteering()
        self.exposure = Exposure(PullConfig(**settings), self.steering)
        self.tracked: Callable[[], TrackedGoal | None] = goal
        self.grid: Grid | None = GRID
        self.leave_at: LeaveAt = where_it_ends
        self.referenced_at: list[Array] = []  # [m], the jaws when the reference was taken

    def mark_reference(self) -> Steps[Grid | None]:
        yield Progress("scripted: taking the reference")
        self.referenced_at.append(self.lease.setpoint_cp(GRASPER).position)
        return self.grid

    def run(self) -> Steps[ExposeOutcome]:
        return self.exposure.run(self.lease, lambda: self.tracked(), self.grasped, self.park, self.mark_reference, self.leave_at)

    def finish(self) -> ExposeOutcome:
        """The outcome of the exposure, after which both arms hold."""
        outcome = self.table.finish(self.run())
        assert self.bench.holding()
        return outcome

    def note_looks(self) -> list[float]:
        """Times [s] of each look at the goal, to be filled as the exposure goes on."""
        stamps: list[float] = []

        def look() -> TrackedGoal:
            stamps.append(self.lease.now())
            return goal()

        self.tracked = look
        return stamps

    def pulls_with(self, newtons: float) -> None:
        """Let the tissue pull with this force from now on."""
        self.bench.grasper.force = np.array([0.0, newtons, 0.0])


def from_step(first: int, act: Callable[[Pull], None], **settings) -> Pull:
    """A pull to whose table `act` happens once, when step `first` is planned."""

    def steer(number: int) -> Array:
        if number == first:
            act(pull)
        return STEP

    pull = Pull(ScriptedSteering(steer), **settings)
    return pull


def test_all_steps_are_pulled_half_a_millimetre_each():
    pull = Pull()

    outcome = pull.finish()

    assert (outcome.code, outcome.stopped_by) == (Code.OK, Code.EXPOSURE_STEPS_DONE)
    assert outcome.path.shape == (35, 3)
    assert np.linalg.norm(np.diff(outcome.path, axis=0), axis=1) == pytest.approx(np.full(34, 0.5e-3))
    assert outcome.tension == pytest.approx(np.full(35, 0.3))
    assert np.isnan(outcome.strain).all()
    assert outcome.strain.shape == (35,)
    assert outcome.message == "pulled all 35 steps (reported)"
    assert pull.exposure.steps_done == 35


@pytest.mark.parametrize("lagging", [False, True])
def test_the_commanded_path_is_made_of_the_steerings_steps_whatever_the_arms_latency(lagging):
    rng = np.random.default_rng(5)
    directions = rng.normal(size=(20, 3)) + np.array([2.0, 0.0, -2.0])
    steps = 0.5e-3 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    pull = Pull(ScriptedSteering(lambda number: steps[number - 1]), steps=20)
    if lagging:
        lag(pull.bench, GRASPER)

    outcome = pull.finish()

    wanted = pull.start.position + np.cumsum(steps, axis=0)
    assert outcome.path == pytest.approx(wanted, abs=1e-12)
    assert [number for number, _ in pull.steering.asked] == list(range(1, 21))
    assert np.array([here for _, here in pull.steering.asked]) == pytest.approx(
        np.vstack([pull.start.position, wanted[:-1]]), abs=1e-12
    )
    commanded = sent(pull.bench, GRASPER)
    reached = [int(np.argmin(np.linalg.norm(commanded - corner, axis=1))) for corner in wanted]
    assert commanded[reached] == pytest.approx(wanted, abs=1e-12)
    assert (np.diff(reached) > 0).all()
    assert commanded[-1] == pytest.approx(wanted[-1], abs=1e-12)


def test_a_lagging_arm_is_never_sent_back():
    pull = Pull(steps=10)
    lag(pull.bench, GRASPER, latency=0.1)

    pull.finish()

    along = sent(pull.bench, GRASPER) @ STEP / np.linalg.norm(STEP)
    assert np.diff(along).min() > -1e-12


def test_the_jaws_keep_their_orientation_and_their_speed():
    pull = Pull(steps=10)

    pull.finish()

    commands = pull.bench.motions(GRASPER)
    assert {command.name for command in commands} == {"servo_cp"}
    assert all(isinstance(command.target, Pose) and command.target.angle_to(pull.start) < 1e-6 for command in commands)
    speeds = np.linalg.norm(np.diff(sent(pull.bench, GRASPER), axis=0), axis=1) / np.diff([command.stamp for command in commands])
    assert speeds.max() <= PullConfig().speed * (1 + 1e-6)


def test_without_a_grasp_nothing_moves():
    pull = Pull()
    pull.grasped = None

    outcome = pull.finish()

    assert (outcome.code, outcome.stopped_by) == (Code.GRASP_EMPTY, Code.GRASP_EMPTY)
    assert pull.bench.motions() == []
    assert pull.referenced_at == []
    assert pull.steering.begun == []


@pytest.mark.parametrize("seen", [None, goal(lost=True)])
def test_a_goal_that_is_not_seen_is_not_exposed(seen):
    pull = Pull()
    pull.tracked = lambda: seen

    outcome = pull.finish()

    assert (outcome.code, outcome.stopped_by) == (Code.GOAL_LOST, Code.GOAL_LOST)
    assert pull.bench.motions(GRASPER) == []
    assert pull.steering.begun == []


def test_a_goal_lost_while_the_reference_is_taken_is_not_exposed():
    pull = Pull()
    pull.tracked = lambda: goal(lost=bool(pull.referenced_at))

    outcome = pull.finish()

    assert outcome.code is Code.GOAL_LOST
    assert pull.bench.motions(GRASPER) == []
    assert pull.steering.begun == []


def test_without_a_reference_nothing_is_pulled():
    pull = Pull()
    pull.grid = None

    outcome = pull.finish()

    assert (outcome.code, outcome.stopped_by) == (Code.GOAL_LOST, Code.GOAL_LOST)
    assert "reference" in outcome.message
    assert pull.bench.motions(GRASPER) == []
    assert pull.steering.begun == []


def test_an_exposure_that_never_began_has_empty_rows():
    pull = Pull()
    pull.grid = None

    outcome = pull.finish()

    assert outcome.path.shape == (0, 3)
    assert outcome.tension.shape == outcome.strain.shape == outcome.stamps.shape == (0,)
    assert pull.exposure.steps_done == 0


def test_the_steering_looks_at_the_goal_and_the_grid_of_the_reference():
    pull = Pull(steps=1)
    older, newer = goal(), goal()
    pull.tracked = lambda: newer if pull.referenced_at else older

    pull.finish()

    ((seen, grid),) = pull.steering.begun
    assert seen is newer
    assert grid is GRID


@pytest.mark.parametrize("lagging", [False, True])
def test_a_stretched_grasp_is_relaxed_before_the_reference(lagging):
    pull = Pull(retracted=10e-3, steps=1)
    if lagging:
        lag(pull.bench, GRASPER)

    outcome = pull.finish()

    relaxed = pull.start.moved(np.array([0.0, 10e-3 - PullConfig().relaxed, 0.0])).position
    assert pull.referenced_at[0] == pytest.approx(relaxed, abs=1e-9)
    assert outcome.path[0] == pytest.approx(relaxed + STEP, abs=1e-9)


def test_a_grasp_under_too_much_tension_may_be_relaxed():
    pull = Pull(retracted=10e-3)
    pull.table.pull(4.5)

    pull.finish()

    assert np.linalg.norm(pull.referenced_at[0] - pull.origin.position) == pytest.approx(PullConfig().relaxed)


def test_a_grasp_that_is_slack_enough_stays_until_the_pull():
    pull = Pull(retracted=5.9e-3, steps=1)

    pull.finish()

    assert pull.referenced_at == [pytest.approx(pull.start.position)]


def test_the_scissors_are_parked_before_the_reference():
    pull = Pull(ScriptedSteering(begins=NO_WAY))
    pull.park = pull.park.moved(np.array([0.02, 0.0, 0.01]))

    pull.finish()

    assert [command.target for command in pull.bench.motions(CUTTER)] == [pull.park]


def test_scissors_that_do_not_park_end_it():
    pull = Pull()
    pull.bench.cutter.fail_next(Code.MOVE_NOT_REACHED, "stuck")

    outcome = pull.finish()

    assert (outcome.code, outcome.message) == (Code.MOVE_NOT_REACHED, "stuck")
    assert pull.bench.motions(GRASPER) == []


def test_tissue_that_cannot_be_relaxed_is_not_pulled():
    pull = Pull(retracted=10e-3)
    stick(pull.bench, GRASPER)

    outcome = pull.finish()

    assert outcome.code is not Code.OK
    assert pull.referenced_at == []


@pytest.mark.parametrize("settle", [0.2, 1.0])
def test_the_tissue_settles_before_the_reference_and_after_the_pull(settle):
    pull = Pull(steps=1, settle=settle)
    began = pull.lease.now()
    looks = pull.note_looks()

    outcome = pull.finish()

    assert looks[0] - began >= settle - 1e-9
    assert pull.lease.now() - outcome.stamps[-1] >= settle - 1e-9


@pytest.mark.parametrize("stop", [FAR_ENOUGH, NO_WAY])
def test_a_steering_that_stops_at_once_pulls_nothing(stop):
    pull = Pull(ScriptedSteering(lambda number: stop))

    outcome = pull.finish()

    assert (outcome.code, outcome.stopped_by) == (stop.code, stop.stopped_by)
    assert outcome.message == f"pulled 0 of 35 steps: {stop.message} (reported)"
    assert outcome.path.shape == (0, 3)
    assert pull.bench.motions(GRASPER) == []


@pytest.mark.parametrize("stop", [FAR_ENOUGH, NO_WAY])
def test_a_steering_that_stops_midway_keeps_what_was_pulled(stop):
    pull = Pull(ScriptedSteering(lambda number: STEP if number <= 7 else stop))

    outcome = pull.finish()

    assert (outcome.code, outcome.stopped_by) == (stop.code, stop.stopped_by)
    assert outcome.message == f"pulled 7 of 35 steps: {stop.message} (reported)"
    assert len(outcome.path) == 7
    assert pull.exposure.steps_done == 7


def test_tissue_that_hides_what_matters_is_eased_back_along_the_path():
    def zigzag(number: int) -> Array:
        return STEP if number % 2 else 0.5e-3 * np.array([-0.8, 0.0, -0.6])

    pull = Pull(ScriptedSteering(zigzag), steps=8)
    asked = []
    pull.leave_at = lambda steps: asked.append(steps) or 3
    outcome = pull.finish()

    assert asked == [8]
    assert (outcome.code, outcome.stopped_by, len(outcome.path)) == (Code.OK, Code.EXPOSURE_STEPS_DONE, 8)
    assert "eased back to step 3" in outcome.message
    assert pull.exposure.steps_done == 3
    jaws = sent(pull.bench, GRASPER)
    assert jaws[-1] == pytest.approx(outcome.path[2], abs=1e-9)
    back = jaws[1 + int(np.argmin(np.linalg.norm(jaws - outcome.path[7], axis=1))) :]
    for position in outcome.path[2:7]:
        assert np.linalg.norm(back - position, axis=1).min() < 1e-9


def test_an_arm_that_does_not_ease_back_is_a_failure():
    pull = Pull(steps=8)

    def sticking(steps: int) -> int:
        stick(pull.bench, GRASPER)
        return 3

    pull.leave_at = sticking
    outcome = pull.finish()

    assert outcome.code is not Code.OK and len(outcome.path) == 8
    assert pull.exposure.steps_done == 8


def test_a_pull_that_failed_or_made_no_step_asks_nobody_where_to_leave_the_tissue():
    asked = []
    for steering in (ScriptedSteering(lambda number: NO_WAY), ScriptedSteering(lambda number: FAR_ENOUGH)):
        pull = Pull(steering, steps=8)
        pull.leave_at = lambda steps: asked.append(steps) or steps
        pull.finish()

    assert asked == []


def test_a_steering_that_cannot_begin_pulls_nothing():
    pull = Pull(ScriptedSteering(begins=NO_WAY))

    outcome = pull.finish()

    assert (outcome.code, outcome.message) == (NO_WAY.code, f"{NO_WAY.message} (reported)")
    assert pull.steering.asked == []
    assert pull.bench.motions(GRASPER) == []


def test_tension_at_its_limit_ends_the_pull_well():
    pull = from_step(5, lambda pull: pull.pulls_with(4.2))

    outcome = pull.finish()

    assert (outcome.code, outcome.stopped_by) == (Code.OK, Code.TENSION)
    assert outcome.message.startswith("pulled 4 of 35 steps: ")
    assert len(outcome.path) == pull.exposure.steps_done == 4
    assert sent(pull.bench, GRASPER)[-1] == pytest.approx(outcome.path[-1], abs=0.4e-3)


def test_a_steering_that_turns_is_asked_again_when_a_step_was_refused_for_tension():
    def steer(number: int) -> Array:
        pull.pulls_with(4.2 if number == 5 else 3.0)
        return STEP

    pull = Pull(ScriptedSteering(steer))
    pull.steering.turns = True

    outcome = pull.finish()

    assert (outcome.code, outcome.stopped_by) == (Code.OK, Code.EXPOSURE_STEPS_DONE)
    assert [number for number, _ in pull.steering.asked] == list(range(1, 36))
    assert len(outcome.path) == len(outcome.tension) == 35
    refused = outcome.path[4]
    assert np.linalg.norm(refused - outcome.path[3]) < 0.4e-3
    assert pull.steering.asked[5][1] == pytest.approx(refused)  # it goes on from where the jaws are


def test_a_step_refused_for_tension_counts_from_where_the_gate_held_the_jaws():
    pull = from_step(5, lambda pull: pull.pulls_with(4.2))
    pull.steering.turns = True

    outcome = pull.finish()

    assert sent(pull.bench, GRASPER)[-1] == pytest.approx(outcome.path[-1], abs=1e-12)


def test_tension_that_stays_at_its_limit_ends_a_pull_that_turns():
    pull = from_step(5, lambda pull: pull.pulls_with(4.2))
    pull.steering.turns = True

    outcome = pull.finish()

    assert (outcome.code, outcome.stopped_by) == (Code.OK, Code.TENSION)
    assert [number for number, _ in pull.steering.asked] == list(range(1, 4 + 3 + 1))
    assert np.linalg.norm(outcome.path[-1] - outcome.path[3]) < 0.4e-3


def test_a_single_refusal_ends_a_pull_that_turns_where_no_more_are_allowed():
    pull = from_step(5, lambda pull: pull.pulls_with(4.2), refusals=1)
    pull.steering.turns = True

    outcome = pull.finish()

    assert (outcome.code, outcome.stopped_by) == (Code.OK, Code.TENSION)
    assert len(outcome.path) == 4


def test_strain_at_its_limit_ends_the_pull_well():
    pull = from_step(5, lambda pull: pull.lease.report_strain(0.6, pull.lease.now()))

    outcome = pull.finish()

    assert (outcome.code, outcome.stopped_by) == (Code.OK, Code.STRAIN)
    assert outcome.message.startswith("pulled 4 of 35 steps: ")
    assert len(outcome.path) == 4


def test_the_strain_seen_after_each_step_is_kept():
    pull = Pull(steps=4)
    pull.tracked = lambda: replace(goal(), strain=0.01 * len(pull.steering.asked))

    outcome = pull.finish()

    assert outcome.strain == pytest.approx([0.01, 0.02, 0.03, 0.04])


@pytest.mark.parametrize("seen", [None, goal(lost=True)])
def test_a_goal_lost_midway_ends_the_pull_well(seen):
    pull = Pull()
    pull.tracked = lambda: seen if len(pull.steering.asked) >= 6 else goal()

    outcome = pull.finish()

    assert (outcome.code, outcome.stopped_by) == (Code.OK, Code.GOAL_LOST)
    assert outcome.message.startswith("pulled 6 of 35 steps: ")
    assert len(outcome.path) == 6


@pytest.mark.parametrize(("before", "after"), [(1.0, 0.3), (3.0, 1.0), (0.6, 0.0)])
def test_tension_that_falls_off_means_that_the_tissue_slipped(before, after):
    pull = from_step(8, lambda pull: pull.pulls_with(after))
    pull.table.pull(before)

    outcome = pull.finish()

    assert (outcome.code, outcome.stopped_by) == (Code.OK, Code.GRASP_SLIPPED)
    assert outcome.message.startswith("pulled 8 of 35 steps: ")
    assert len(outcome.path) == 8


@pytest.mark.parametrize(("before", "after"), [(0.45, 0.0), (1.0, 0.45), (3.0, 1.5)])
def test_a_little_tension_or_a_little_less_of_it_means_nothing(before, after):
    pull = from_step(8, lambda pull: pull.pulls_with(after))
    pull.table.pull(before)

    assert pull.finish().stopped_by is Code.EXPOSURE_STEPS_DONE


def test_slip_is_measured_against_the_greatest_tension_of_this_pull():
    forces = {1: 0.3, 5: 2.0, 10: 1.2, 15: 0.7}

    def steer(number: int) -> Array:
        pull.pulls_with(forces.get(number, float(pull.bench.grasper.force[1])))
        return STEP

    pull = Pull(ScriptedSteering(steer))

    outcome = pull.finish()

    assert outcome.stopped_by is Code.GRASP_SLIPPED
    assert len(outcome.path) == 15


def test_an_arm_that_no_longer_follows_is_a_failure():
    pull = from_step(5, lambda pull: stick(pull.bench, GRASPER))

    outcome = pull.finish()

    assert outcome.code is outcome.stopped_by is Code.MOVE_NOT_REACHED
    # One step is within what an arm may lag behind.
    assert len(outcome.path) == 5


@pytest.mark.parametrize(
    "act",
    [
        lambda pull: pull.pulls_with(6.0),
        lambda pull: pull.bench.grasper.fault(),
        lambda pull: pull.table.gate.revoke(pull.lease),
        lambda pull: setattr(pull.bench, "pressed", True),
    ],
    ids=["tension trips", "fault", "revoked", "emergency stop"],
)
def test_a_lost_lease_is_a_failure_that_keeps_what_was_pulled(act):
    outcome = from_step(5, act).finish()

    assert outcome.code is outcome.stopped_by is Code.LEASE_REVOKED
    assert len(outcome.path) == 4


def test_a_step_out_of_the_workspace_is_a_failure():
    pull = Pull(ScriptedSteering(lambda number: STEP if number < 3 else np.array([0.0, 0.0, 1.0])))

    outcome = pull.finish()

    assert outcome.code is outcome.stopped_by is Code.WORKSPACE
    assert len(outcome.path) == 2


def test_closed_at_any_tick_it_leaves_the_arms_holding():
    said: set[str] = set()
    ticks = 0
    running = True
    while running:
        pull = Pull(retracted=6.5e-3, steps=2, settle=0.05)
        pull.bench.cutter.delay = 2 * TICK
        steps = pull.run()
        ticks += 1
        try:
            for _ in range(ticks):
                said.add(next(steps).message)
                pull.bench.advance(TICK)
        except StopIteration:
            running = False
        steps.close()

        assert pull.bench.holding(), f"closed after {ticks} ticks"
        assert pull.exposure.steps_done <= 2

    assert said == {
        "moving the scissors out of sight",
        "relaxing the tissue",
        "letting the tissue settle",
        "scripted: taking the reference",
        "scripted: looking",
        "scripted: planning",
        "exposing: step 1 of 2",
        "exposing: step 2 of 2",
    }


def test_closed_midway_it_says_how_many_steps_were_done():
    pull = Pull()
    steps = pull.run()
    while next(steps).message != "exposing: step 4 of 35":
        pull.bench.advance(TICK)

    steps.close()

    assert pull.exposure.steps_done == 3


def test_the_count_of_steps_begins_anew_with_each_run():
    pull = Pull(steps=3)
    pull.finish()
    pull.grasped = None

    pull.finish()

    assert pull.exposure.steps_done == 0


@pytest.mark.parametrize("broken", ["begin", "step", "report"])
def test_a_steering_that_raises_leaves_the_arms_holding(broken, monkeypatch):
    def breaks(*args):
        raise RuntimeError("the steering broke")

    pull = Pull(steps=2)
    monkeypatch.setattr(pull.steering, broken, breaks)

    with pytest.raises(RuntimeError, match="the steering broke"):
        pull.table.finish(pull.run())

    assert pull.bench.motions()
    assert pull.bench.holding()


def test_a_steering_that_raises_midway_leaves_the_arms_holding():
    def breaks(pull: Pull) -> None:
        raise RuntimeError("the steering broke")

    pull = from_step(4, breaks)

    with pytest.raises(RuntimeError, match="the steering broke"):
        pull.table.finish(pull.run())

    assert len(sent(pull.bench, GRASPER)) > 3
    assert pull.bench.holding()
    assert pull.exposure.steps_done == 3


def test_each_step_is_stamped_when_it_was_done():
    pull = Pull(steps=7)
    looks = pull.note_looks()

    outcome = pull.finish()

    assert outcome.stamps.tolist() == looks[-7:]  # one look at the goal after each step


@pytest.mark.parametrize(
    "wrong",
    [
        {"step": 0.0},
        {"step": float("nan")},
        {"speed": -1e-3},
        {"relaxed": 0.0},
        {"settle": 0.0},
        {"slip_tension": 0.0},
        {"steps": 0},
        {"slip_drop": 0.0},
        {"slip_drop": 1.0},
    ],
    ids=str,
)
def test_settings_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValueError, match="must be positive"):
        PullConfig(**wrong)
