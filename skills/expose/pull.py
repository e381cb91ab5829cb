"""What every exposure does: get ready, take the reference image (t_d), pull step by step, leave the tissue stretched (t_e).

Where each step goes is the business of a `Steering`: a fixed direction, or the controller that plans.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from hardware.codes import Code
from hardware.gate import Lease
from hardware.interface import CUTTER, GRASPER, Array, MoveReport, MoveStatus, Pose
from skills.estimate.grid import Grid
from skills.expose.felt import Touch, TouchConfig, felt_line
from skills.expose.outcome import ExposeOutcome, Forecast
from skills.grasp import Grasped
from skills.motion import pause, servo_line, wait
from skills.skill import Steps
from skills.tracking.tracks import TrackedGoal


@dataclass(frozen=True)
class PullConfig:
    """Settings of every exposure. Lengths [m], speeds [m/s]."""

    step: float = 0.5e-3
    steps: int = 35
    speed: float = 5e-3
    relaxed: float = 6e-3  # retraction of the grasp at which the reference image is taken
    settle: float = 0.3  # [s] before the reference and after the pull
    slip_drop: float = 0.6  # share of the greatest tension so far that is lost when the tissue has left the jaws
    slip_tension: float = 0.5  # [N] below this tension says nothing about slip
    # Steps in a row refused for tension after which a pull ends that can turn elsewhere. The gate lets a step that turns begin at the
    # limit; by touch it goes no farther than can be felt.
    refusals: int = 3
    touch: TouchConfig = field(default_factory=TouchConfig)

    def __post_init__(self) -> None:
        lengths = (self.step, self.speed, self.relaxed, self.settle, self.slip_tension)
        counts = (self.steps, self.refusals)
        if not all(value > 0 for value in lengths) or min(counts) < 1 or not 0 < self.slip_drop < 1:
            raise ValueError("lengths, speeds, times and counts of a pull must be positive, and slip_drop a share")


@dataclass(frozen=True)
class Stop:
    """Why a pull goes no further. `code` OK: as far as it should go; anything else is a failure."""

    code: Code
    message: str
    stopped_by: Code


class Steering(Protocol):
    """Says where a pull goes. One run, one thread."""

    @property
    def turns(self) -> bool:
        """Whether the next step may go elsewhere when one was refused for tension; a straight pull ends there."""
        ...

    def begin(self, lease: Lease, goal: TrackedGoal, grid: Grid, grasped: Grasped) -> Steps[Stop | None]:
        """Look at the tissue at t_d and get ready; or say why nothing can be pulled."""
        ...

    def step(self, lease: Lease, here: Array, number: int) -> Steps[Array | Stop]:
        """Displacement (3,) [m] of step `number` (from 1) of the jaws that are at `here` (3,) [m], or why there is none."""
        ...

    def forecast(self) -> Forecast | None:
        """What the steps of the newest run so far should have done to the edges; None where nothing is expected."""
        ...

    def report(self, outcome: ExposeOutcome) -> ExposeOutcome:
        """Add to the outcome what only the steering knows."""
        ...


MarkReference = Callable[[], Steps[Grid | None]]
LeaveAt = Callable[[int], int]
"""After which of the steps done (at least 1) the tissue should be left: the last one, or one to go back to."""


def where_it_ends(steps: int) -> int:
    """The `LeaveAt` that never goes back."""
    return steps


class Exposure:
    """Pulls where its steering says."""

    def __init__(self, config: PullConfig, steering: Steering) -> None:
        self._config = config
        self._steering = steering
        self.steps_done = 0  # of the newest run
        self.pulling = False  # between t_d and t_e
        self._begun = False  # whether the steering has looked at this run's tissue

    def forecast(self) -> Forecast | None:
        """What the newest pull so far should have done to the edges; None where nothing is expected."""
        return self._steering.forecast() if self._begun else None

    def not_begun(self, code: Code, message: str) -> ExposeOutcome:
        """The outcome of a run that cannot begin: nothing is pulled, and nothing expected."""
        self.steps_done, self._begun = 0, False
        return _Log().outcome(_failed(code, message))

    def run(
        self,
        lease: Lease,
        tracked: Callable[[], TrackedGoal | None],
        grasped: Grasped | None,
        park: Pose,
        mark_reference: MarkReference,
        leave_at: LeaveAt = where_it_ends,
    ) -> Steps[ExposeOutcome]:
        """Park the scissors at `park`, relax, take the reference image (t_d), pull, go back to where the tissue is left (t_e)."""
        config, log = self._config, _Log()
        self.steps_done, self._begun = 0, False
        try:
            stop = yield from self._ready(lease, tracked, grasped, park, mark_reference)
            number, here = 0, lease.setpoint_cp(GRASPER)
            touch = Touch(config.touch, lease.limits.tension_stop, lease.tension())
            self.pulling = stop is None
            while stop is None and number < config.steps:
                number += 1
                stop, here = yield from self._step(lease, tracked, number, here, touch, log)
                self.steps_done = log.steps
            if stop is None:
                stop = Stop(Code.OK, f"pulled all {config.steps} steps", Code.EXPOSURE_STEPS_DONE)
            if stop.code is Code.OK:
                yield from pause(lease, config.settle, "letting the tissue settle")
                stop = yield from self._ease(lease, log, leave_at, stop)
            outcome = log.outcome(stop)
            return self._steering.report(outcome) if self._begun else outcome
        finally:
            self.pulling = False
            lease.hold()

    def _ready(
        self,
        lease: Lease,
        tracked: Callable[[], TrackedGoal | None],
        grasped: Grasped | None,
        park: Pose,
        mark_reference: MarkReference,
    ) -> Steps[Stop | None]:
        """Everything up to t_d."""
        if grasped is None:
            return _failed(Code.GRASP_EMPTY, "no tissue is grasped, so nothing can be exposed")
        report = yield from wait(lease.move_cp(CUTTER, park), "moving the scissors out of sight")
        if report.status is MoveStatus.FAILED:
            return _failed(report.code, report.message)
        report = yield from self._relax(lease, grasped)
        if report.status is MoveStatus.FAILED:
            return _failed(report.code, report.message)
        yield from pause(lease, self._config.settle, "letting the tissue settle")
        goal = tracked()
        if goal is None or goal.lost:
            return _failed(Code.GOAL_LOST, "the goal cannot be seen well enough to judge an exposure")
        grid = yield from mark_reference()
        if grid is None:
            return _failed(Code.GOAL_LOST, "the tracker gave no reference image")
        goal = tracked() or goal
        if goal.lost:
            return _failed(Code.GOAL_LOST, "the goal was lost from sight while the reference image was taken")
        self._begun = True
        return (yield from self._steering.begin(lease, goal, grid, grasped))

    def _relax(self, lease: Lease, grasped: Grasped) -> Steps[MoveReport]:
        """Come back along the last pull until the grasp is `relaxed` from where it closed."""
        here = lease.setpoint_cp(GRASPER)
        out = here.position - grasped.origin.position
        distance = float(np.linalg.norm(out))
        if distance <= self._config.relaxed + 1e-6:
            return MoveReport(MoveStatus.DONE)
        target = here.at(grasped.origin.position + out * (self._config.relaxed / distance))
        return (yield from servo_line(lease, GRASPER, target, self._config.speed, "relaxing the tissue"))

    def _ease(self, lease: Lease, log: "_Log", leave_at: LeaveAt, stop: Stop) -> Steps[Stop]:
        """Go back along the path to where the tissue is to be left."""
        back = leave_at(log.steps) if log.steps else 0
        if back == log.steps:
            return stop
        for position in log.positions[back - 1 : -1][::-1]:
            target = lease.setpoint_cp(GRASPER).at(position)
            report = yield from servo_line(lease, GRASPER, target, self._config.speed, f"easing back to step {back}")
            if report.status is MoveStatus.FAILED:
                return _failed(report.code, report.message)
        yield from pause(lease, self._config.settle, "letting the tissue settle")
        self.steps_done = back
        return replace(stop, message=f"{stop.message}; eased back to step {back}, where more of what is undecided is in sight")

    def _step(
        self,
        lease: Lease,
        tracked: Callable[[], TrackedGoal | None],
        number: int,
        here: Pose,
        touch: Touch,
        log: "_Log",
    ) -> Steps[tuple[Stop | None, Pose]]:
        """One step of the pull from `here`: why to stop, or None, and where the jaws are sent now."""
        config = self._config
        done, doing = f"pulled {number - 1} of {config.steps} steps", f"exposing: step {number} of {config.steps}"
        step = yield from self._steering.step(lease, here.position, number)
        if isinstance(step, Stop):
            return replace(step, message=f"{done}: {step.message}"), here
        target = here.moved(step)
        report = yield from felt_line(lease, target, config.speed, doing, here, touch)
        refused = report.code is Code.TENSION
        if report.code is Code.STRAIN or (refused and not (self._steering.turns and log.refusals + 1 < config.refusals)):
            return Stop(Code.OK, f"{done}: {report.message}", report.code), here
        if refused:
            # A step cut short is a step: the gate has seen to the tension, and the steering plans the next one knowing it.
            target = lease.setpoint_cp(GRASPER)
        elif report.status is MoveStatus.FAILED:
            return _failed(report.code, report.message), here
        log.refusals = log.refusals + 1 if refused else 0
        now = tracked()
        log.add(lease.now(), target.position, lease.tension(), now.strain if now else float("nan"))
        done = f"pulled {number} of {config.steps} steps"
        if now is None or now.lost:
            return Stop(Code.OK, f"{done}: the goal is no longer seen well enough", Code.GOAL_LOST), target
        if log.slipped(config):
            return Stop(Code.OK, f"{done}: the tissue slipped from the jaws", Code.GRASP_SLIPPED), target
        return None, target


class _Log:
    """What happened on the way."""

    def __init__(self) -> None:
        self._stamps: list[float] = []
        self.positions: list[Array] = []
        self._tension: list[float] = []
        self._strain: list[float] = []
        self.refusals = 0  # for tension, in a row

    def add(self, stamp: float, position: Array, tension: float, strain: float) -> None:
        """Note one step."""
        self._stamps.append(stamp)
        self.positions.append(position)
        self._tension.append(tension)
        self._strain.append(strain)

    @property
    def steps(self) -> int:
        """Steps noted."""
        return len(self._stamps)

    def slipped(self, config: PullConfig) -> bool:
        """Whether the tension has fallen so far below its greatest value that little or nothing is held any more."""
        greatest = max(self._tension)
        return greatest > config.slip_tension and self._tension[-1] < (1.0 - config.slip_drop) * greatest

    def outcome(self, stop: Stop) -> ExposeOutcome:
        """Everything noted, with why it ended."""
        path = np.array(self.positions).reshape(-1, 3)
        tension, strain, stamps = np.array(self._tension), np.array(self._strain), np.array(self._stamps)
        return ExposeOutcome(stop.code, stop.message, stop.stopped_by, path, tension, strain, stamps)


def _failed(code: Code, message: str) -> Stop:
    return Stop(code, message, code)
