"""The skills of a session that sees nothing: real motions of grasp, cut and exposure at known places, without tracker and planner.

Faults of a robot are about motion, not about sight. So the tissue's place is taken from the simulated bench, the pictures may stay
empty, and what is left are the very motions that the skills of a session make, under the same lease.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar, cast

import numpy as np

from hardware.codes import Code
from hardware.gate import Lease, SafetyGate
from hardware.interface import CUTTER, GRASPER, Array, MoveReport, MoveStatus, Pose
from hardware.stub.bench import StubBench
from hardware.stub.sheet_solver import bed_height
from skills.checklist import checklist
from skills.checklist_outcome import CheckOutcome
from skills.dissect.outcome import DissectOutcome
from skills.dissect.planning import retraction_direction
from skills.estimate.graph import ConnectivityGraph, EdgeState
from skills.estimate.grid import Grid
from skills.expose.outcome import ExposeOutcome, Forecast
from skills.expose.pull import Exposure, PullConfig, Stop
from skills.grasp import Grasped, take
from skills.motion import pause, servo_line, wait
from skills.replan.next_goal import NextGoal
from skills.retreat import retreat
from skills.retreat_outcome import RetreatOutcome
from skills.scene.goal import Goal
from skills.skill import Progress, Steps
from skills.tracking.outcome import TrackOutcome
from skills.tracking.tracks import TrackedGoal
from supervisor.skillset import SkillConfig

T = TypeVar("T")

RETRACTING = "retracting the tissue"
SNIPPING = "closing the scissors"
ESTIMATING = "estimating with the arms at rest"
PULL = PullConfig(steps=8)
LOOK = 1.0  # [s] that an estimate takes here


@dataclass(frozen=True)
class Place:
    """Where tissue is grasped and cut, (3,) each [m], left camera frame: `middle` and `tangent` of the goal, `normal` of the sheet."""

    grasp: Array
    middle: Array
    tangent: Array
    normal: Array


def place_of(bench: StubBench) -> Place:
    """The scene's own goal and grasp."""
    line, scene = np.asarray(bench.scene.line), bench.scene
    flat = np.vstack([scene.goal.grasp, line[len(line) // 2], line[0], line[-1]])
    height = bed_height(flat, scene.bump) + scene.tissue.thickness
    grasp, middle, start, end = bench.to_camera(np.column_stack([flat, height]))
    up = bench.to_camera(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]))
    return Place(grasp, middle, (end - start) / np.linalg.norm(end - start), up[0] - up[1])


class Straight:
    """A `Steering` that pulls evenly along `direction` (3,)."""

    turns = False

    def __init__(self, direction: Array) -> None:
        self._step = PULL.step * direction

    def begin(self, lease: Lease, goal: TrackedGoal, grid: Grid, grasped: Grasped) -> Steps[Stop | None]:
        """Nothing to get ready."""
        yield Progress("exposing")
        return None

    def step(self, lease: Lease, here: Array, number: int) -> Steps[Array | Stop]:
        """The same step again."""
        yield Progress(f"exposing: step {number}")
        return self._step

    def forecast(self) -> Forecast | None:
        """Nothing is expected."""
        return None

    def report(self, outcome: ExposeOutcome) -> ExposeOutcome:
        """Nothing to add."""
        return outcome


class PhaseSkills:
    """A `SkillSet`. `doing` is what is under way and since when [s]; `begun` counts skills that move the arms."""

    def __init__(self, gate: SafetyGate, place: Place, goal: Goal, config: SkillConfig) -> None:
        self._gate, self._place, self._goal, self._config = gate, place, goal, config
        self._grasped: Grasped | None = None
        away = place.grasp - place.middle
        self._out = retraction_direction(away, place.normal, config.planning.lift)
        self._exposure = Exposure(PULL, Straight(self._out))
        self._park: Pose | None = None
        self.doing: tuple[str, float] = ("", 0.0)
        self.begun = 0

    def checklist(self) -> Steps[CheckOutcome]:
        """The real one."""
        outcome = yield from self._told(checklist(self._gate, "hand-eye of the served stub", None))
        if outcome.code is Code.OK and self._park is None:
            self._park = self._gate.bench.arms[CUTTER].measured_cp().value
        return outcome

    def start_tracking(self, goal: Goal) -> Steps[TrackOutcome]:
        """The goal stays where it was drawn."""
        yield Progress("looking at the goal")
        return TrackOutcome(Code.OK, "the goal is where it was drawn")

    def track(self) -> Steps[None]:
        """Without end."""
        while True:
            yield Progress("following the goal")

    def tracked(self) -> TrackedGoal:
        """The goal as drawn, seen just now."""
        line = self._goal.polyline
        rows, seen = np.array([0.0, 8.0]), np.ones(len(line), dtype=np.bool_)
        return TrackedGoal(self._gate.bench.now(), line, line - rows, line + rows, seen, self._goal.grasp, True, False, 0.0)

    def dissect(self, lease: Lease, segments: Array | None) -> Steps[DissectOutcome]:
        """Grasp, retract, snip once."""
        self.begun += 1
        try:
            report = yield from self._told(self._dissect(lease))
            return DissectOutcome(report.code, report.message or "one snip made", ())
        finally:
            lease.hold()

    def expose(self, lease: Lease) -> Steps[ExposeOutcome]:
        """The real exposure, with a straight pull."""
        self.begun += 1
        park = self._park or lease.measured_cp(CUTTER).value
        return (yield from self._told(self._exposure.run(lease, self.tracked, self._grasped, park, self._mark)))

    def estimate(self) -> Steps[ConnectivityGraph]:
        """Look for a while with the arms at rest, and find everything severed."""
        until = self._gate.bench.now() + LOOK
        while self._gate.bench.now() < until:
            self._say(ESTIMATING)
            yield Progress(ESTIMATING)
        return _severed()

    def replan(self, graph: ConnectivityGraph) -> Steps[NextGoal]:
        """Never needed: the estimate finds nothing left."""
        yield Progress("planning")
        return NextGoal(Code.NO_CANDIDATE, "nothing is planned here", np.zeros((0, 2, 2)), ())

    def retreat(self, lease: Lease) -> Steps[RetreatOutcome]:
        """The real one."""
        self.begun += 1
        return (yield from self._told(retreat(lease, self._park or lease.measured_cp(CUTTER).value)))

    # ------------------------------------------------------------ inside

    def _dissect(self, lease: Lease) -> Steps[MoveReport]:
        place, config = self._place, self._config
        if self._grasped is None:
            away = place.grasp - place.middle
            report, self._grasped = yield from take(lease, place.grasp, place.normal, away, config.grasp)
            if self._grasped is None:
                return report
            target = self._grasped.origin.moved(config.planning.retraction * self._out)
            report = yield from servo_line(lease, GRASPER, target, config.grasp.pull_speed, RETRACTING)
            if report.status is MoveStatus.FAILED:
                return report
        return (yield from self._snip(lease))

    def _snip(self, lease: Lease) -> Steps[MoveReport]:
        """As the planning agent makes one: above, open, insert, close, back."""
        place, planning = self._place, self._config.planning
        pose = Pose.looking(place.middle - planning.depth * place.normal, -place.normal, place.tangent)
        above = pose.moved((planning.depth + planning.clearance) * place.normal)
        motions: tuple[Callable[[], Steps[MoveReport]], ...] = (
            lambda: wait(lease.move_cp(CUTTER, above), "moving the scissors above the tissue"),
            lambda: wait(lease.move_jaw(CUTTER, planning.most_jaw), "opening the scissors"),
            lambda: servo_line(lease, CUTTER, pose, planning.insertion_speed, "inserting the scissors"),
            lambda: wait(lease.move_jaw(CUTTER, 0.0), SNIPPING),
            lambda: wait(lease.move_cp(CUTTER, above), "lifting the scissors"),
        )
        report = MoveReport(MoveStatus.DONE)
        for motion in motions:
            report = yield from motion()
            if report.status is MoveStatus.FAILED:
                return report
        yield from pause(lease, planning.settle, "letting the cut open")
        return report

    def _mark(self) -> Steps[Grid | None]:
        """A reference that nobody looks at: the steering here has none to plan with."""
        yield Progress("taking the reference image")
        return cast(Grid, object())

    def _told(self, steps: Steps[T]) -> Steps[T]:
        """The same steps, remembering what each says that it does."""
        try:
            while True:
                progress = next(steps)
                self._say(progress.message)
                yield progress
        except StopIteration as finished:
            return cast(T, finished.value)
        finally:
            steps.close()

    def _say(self, doing: str) -> None:
        if self.doing[0] != doing:
            self.doing = (doing, self._gate.bench.now())


def fitted_grasp(config: SkillConfig) -> SkillConfig:
    """With a test pull that any catch passes: a coarse sheet is softer, and whether it was caught is not the question here."""
    return replace(config, grasp=replace(config.grasp, least_tension=-math.inf))


def _severed() -> ConnectivityGraph:
    """One edge across the goal, severed."""
    points = np.array([[300.0, 232.0], [300.0, 248.0]])
    edges, one = np.array([[0, 1]]), np.ones(1)
    state = np.array([int(EdgeState.SEVERED)])
    crosses = np.ones(1, dtype=np.bool_)
    return ConnectivityGraph(Code.OK, "nothing is attached", points, points, edges, one, state, one, crosses, 0.5 * one)
