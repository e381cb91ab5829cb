"""The skills of one session, put together: what the tree asks for by name, with the tracker, the agent and the settings they share."""

from __future__ import annotations

import shutil
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path

import numpy as np

from hardware.codes import Code
from hardware.gate import Lease, SafetyGate
from hardware.interface import CUTTER, Array, Frame, MoveReport, MoveStatus, Pose
from skills.checklist import checklist
from skills.checklist_outcome import CheckOutcome
from skills.dissect.outcome import DissectOutcome
from skills.dissect.planning import PlanningAgent, PlanningConfig
from skills.estimate.elongation import ElongationConfig
from skills.estimate.elongation import estimate_connectivity as by_elongation
from skills.estimate.graph import ConnectivityGraph
from skills.estimate.grid import Grid
from skills.estimate.in_sight import last_in_sight
from skills.estimate.likelihood import LikelihoodConfig
from skills.estimate.likelihood import estimate_connectivity as by_likelihood
from skills.estimate.look import Look
from skills.estimate.rule import Rule
from skills.estimate.stretches import located
from skills.expose.foreseen import SteeringForeseen
from skills.expose.instead import SteeringInstead
from skills.expose.optimal import OptimalConfig, SteeringOptimal, View, sight_config
from skills.expose.outcome import ExposeOutcome
from skills.expose.pull import Exposure, PullConfig, Steering
from skills.expose.straight import Direction, SteeringStraight
from skills.grasp import GraspConfig, Grasped
from skills.replan.candidates import ReplanConfig
from skills.replan.next_goal import NextGoal
from skills.replan.plan import next_goal
from skills.retreat import retreat
from skills.retreat_outcome import RetreatOutcome
from skills.scene.goal import Goal
from skills.scene.stereo import DepthMap, StereoConfig, depth_at, depth_from_stereo, region_around
from skills.scene.tissue import TissueConfig, hidden_mask, tissue_mask, tissue_outline
from skills.skill import Progress, Steps, computed
from skills.tracking.choose import TrackerChoice, make_tracker
from skills.tracking.goal_tracker import GoalTracker, GoalTrackerConfig
from skills.tracking.outcome import TrackOutcome
from skills.tracking.strain import StrainConfig, StrainGauge
from skills.tracking.tracks import TrackedGoal


class ExposureKind(StrEnum):
    """How the tissue is pulled to see the cut."""

    OPTIMAL = "optimal"
    NAIVE = "naive"
    GOAL_NORMAL = "goal-normal"


@dataclass(frozen=True)
class SkillConfig:
    """Settings of every skill; written into the record as they are."""

    exposure: ExposureKind = ExposureKind.OPTIMAL
    rule: Rule = Rule.LIKELIHOOD
    choice: TrackerChoice = field(default_factory=TrackerChoice)
    planning: PlanningConfig = field(default_factory=PlanningConfig)
    grasp: GraspConfig = field(default_factory=GraspConfig)
    stereo: StereoConfig = field(default_factory=StereoConfig)
    pull: PullConfig = field(default_factory=PullConfig)
    optimal: OptimalConfig = field(default_factory=OptimalConfig)
    tracker: GoalTrackerConfig = field(default_factory=GoalTrackerConfig)
    elongation: ElongationConfig = field(default_factory=ElongationConfig)
    likelihood: LikelihoodConfig = field(default_factory=LikelihoodConfig)
    replan: ReplanConfig = field(default_factory=ReplanConfig)
    tissue: TissueConfig = field(default_factory=TissueConfig)
    strain: StrainConfig = field(default_factory=StrainConfig)
    track_period: float = 0.1  # [s] between looks of the tracker
    reference_patience: float = 2.0  # [s] for the tracker to take a reference image


class SessionSkills:
    """Implements `behaviours.services.SkillSet` with the real skills. One session, one thread."""

    def __init__(
        self, gate: SafetyGate, config: SkillConfig, executor: Executor, seed: int, calibration: str, record: Path | None
    ) -> None:
        self._gate = gate
        self._config = config
        self._executor = executor
        self._seed = seed
        self._rng = np.random.default_rng([seed, 3])
        self._calibration = calibration
        self._record = record
        self._agent = PlanningAgent(config.planning, config.grasp, config.stereo, executor)
        self._planned: SteeringOptimal | None = None
        self._exposure = Exposure(config.pull, self._steering())
        self._tracker: GoalTracker | None = None
        self._tracked: TrackedGoal | None = None
        self._reference_wanted = False
        self._due = -np.inf
        self._gauge: StrainGauge | None = None
        self._looks: list[Look] = []  # at the grid's keypoints, since the newest reference
        self._newest: tuple[Look, Array] | None = None  # the newest finished look, with the openings that are decided
        self._goal_length: float | None = None  # [m] at the newest reference
        self._strain, self._strain_seen, self._strain_due = float("nan"), -np.inf, -np.inf
        self._park: Pose | None = None
        self.frame: Frame | None = None

    def checklist(self) -> Steps[CheckOutcome]:
        """Arms, camera, calibration, limits and disk; remembers where the scissors waited as the place to park them."""
        free = None if self._record is None else float(shutil.disk_usage(self._record).free)
        outcome = yield from checklist(self._gate, self._calibration, free)
        if outcome.code is Code.OK and self._park is None:
            self._park = self._gate.bench.arms[CUTTER].measured_cp().value
        return outcome

    def start_tracking(self, goal: Goal) -> Steps[TrackOutcome]:
        """Begin to follow the approved goal on the newest frame."""
        yield Progress("looking at the goal")
        tracker = GoalTracker(self._config.tracker, make_tracker(self._config.choice, self._config.tracker.tracker))
        self.frame = self._gate.bench.endoscope.left()
        self._tracked = tracker.start(self.frame, goal)
        if self._tracked.lost:
            return TrackOutcome(Code.GOAL_LOST, "the goal cannot be followed: too little of it is seen")
        self._tracker, self._newest = tracker, None
        return TrackOutcome(Code.OK, f"following {len(self._tracked.polyline)} stations along the goal")

    def track(self) -> Steps[None]:
        """Look at a new frame every `track_period` while the view of the goal is clear; take the reference when asked."""
        while True:
            bench = self._gate.bench
            if self._tracker is not None and bench.now() >= self._due and self._agent.clear_view:
                self._due = bench.now() + self._config.track_period - 1e-6
                self.frame = bench.endoscope.left()
                if self._reference_wanted:
                    yield from computed(self._executor, "taking the reference", self._tracker.mark_reference, self.frame)
                    self._tracked = self._tracker.tracked()
                    self._finish_look()
                    yield from computed(self._executor, "measuring depth", self._begin_strain)
                    self._tracked = replace(self._tracked, strain=self._strain)
                    self._reference_wanted = False
                else:
                    self._tracked = yield from computed(self._executor, "following the goal", self._tracker.update, self.frame)
                    self._finish_look()
                    if self._exposure.pulling and bench.now() >= self._strain_due:
                        yield from computed(self._executor, "measuring strain", self._read_strain)
                    self._tracked = replace(self._tracked, strain=self._strain)
                    self._keep_look()
            yield Progress("following the goal")

    def tracked(self) -> TrackedGoal | None:
        """The goal as last seen."""
        return self._tracked

    def dissect(self, lease: Lease, segments: Array | None) -> Steps[DissectOutcome]:
        """The planning agent cuts the goal or the corrective segments."""
        return (yield from self._agent.run(lease, self.tracked, segments))

    def take_hold(self, lease: Lease) -> Steps[MoveReport]:
        """Grasp at the goal's grasp point and stay there: for exposures of a goal that was cut before."""
        assert self._tracked is not None, "tracking starts before anything is grasped"
        return (yield from self._agent.take_hold(lease, self._tracked, 0.0))

    def expose(self, lease: Lease) -> Steps[ExposeOutcome]:
        """Pull the tissue, with a reference image (t_d) before it; grasp it anew first if it slipped from the jaws."""
        park = self._park or lease.measured_cp(CUTTER).value
        try:
            if self._agent.slipped and self._tracked is not None and not self._tracked.lost:
                report = yield from self._agent.take_hold(lease, self._tracked, self._config.planning.retraction)
                if report.status is MoveStatus.FAILED:
                    return self._exposure.not_begun(report.code, report.message)
            run = self._exposure.run
            outcome = yield from run(lease, self.tracked, self._agent.grasped, park, self._mark_reference, self._leave_at)
            if outcome.stopped_by is Code.GRASP_SLIPPED:
                self._agent.lose_grasp()
            return outcome
        finally:
            lease.hold()

    @property
    def grasped(self) -> Grasped | None:
        """Tissue in the jaws."""
        return self._agent.grasped

    @property
    def exposure_step(self) -> int:
        """Steps of the newest exposure that are done."""
        return self._exposure.steps_done

    @property
    def exposure_view(self) -> View | None:
        """What the controller had in mind at the newest step it planned; None before the first, and for a straight pull."""
        return None if self._planned is None else self._planned.view

    def grid(self) -> Grid | None:
        """The keypoint grid of the newest reference; None before the first."""
        return None if self._tracker is None else self._tracker.grid()

    def judge_now(self) -> ConnectivityGraph:
        """The estimate as it would be now, on the newest frame."""
        assert self._tracker is not None, "the tree estimates only after tracking has started"
        return self._estimate(self._tracker)

    def estimate(self) -> Steps[ConnectivityGraph]:
        """Judge every edge of the keypoint grid by the rule chosen."""
        yield Progress("estimating what is still attached")
        assert self._tracker is not None, "the tree estimates only after tracking has started"
        return (yield from computed(self._executor, "estimating what is still attached", self._estimate, self._tracker))

    def replan(self, graph: ConnectivityGraph) -> Steps[NextGoal]:
        """The fewest segments that sever what is left, on the tissue; nothing is cut unseen."""
        yield Progress("planning the corrective cuts")
        return (yield from computed(self._executor, "planning the corrective cuts", self._replan, graph))

    def retreat(self, lease: Lease) -> Steps[RetreatOutcome]:
        """Scissors to where they waited, both arms hold."""
        return (yield from retreat(lease, self._park or lease.measured_cp(CUTTER).value))

    def _steering(self) -> Steering:
        config, executor = self._config, self._executor

        def along(direction: Direction) -> Steering:
            return SteeringStraight(direction, config.pull.step, config.stereo, executor)

        if config.exposure is ExposureKind.OPTIMAL:
            rng = np.random.default_rng([self._seed, 4])
            self._planned = SteeringOptimal(config.optimal, config.stereo, config.tissue, executor, rng, self._gaps)
            return SteeringInstead(self._planned, along(Direction.GOAL_NORMAL))
        straight = along(Direction(config.exposure.value))
        sight = sight_config(config.optimal, config.stereo, config.tissue)
        return SteeringForeseen(straight, sight, config.optimal.separation, executor, self._gaps)

    def _begin_strain(self) -> None:
        """From now on strain counts from here."""
        assert self._tracker is not None
        grid = self._tracker.grid()
        if grid is None:
            return
        self._looks = []
        self._goal_length = self._measured_length()
        self._gauge = StrainGauge(grid, self._depth(grid.points), self._gate.bench.endoscope.camera, self._config.strain)
        self._strain, self._strain_seen = 0.0, self._gate.bench.now()
        self._gate.report_strain(0.0, self._strain_seen)

    def _read_strain(self) -> None:
        """Tell the gate how far the tissue is stretched; that it is unknown when it could not be measured for too long."""
        assert self._tracker is not None and self._gauge is not None
        now, config = self._gate.bench.now(), self._config.strain
        self._strain_due = now + config.period - 1e-6
        _, tracks, _ = self._tracker.grid_tracks()
        strain = self._gauge.read(tracks.points, tracks.visible, tracks.confidence, self._depth(tracks.points))
        if np.isfinite(strain):
            self._strain, self._strain_seen = strain, now
        elif now - self._strain_seen > config.patience:
            self._strain = float("nan")
        self._gate.report_strain(self._strain, now)

    def _keep_look(self) -> None:
        """Keep what is seen after each step of a pull: the history of each edge."""
        step = self._exposure.steps_done
        if self._exposure.pulling and step > (self._looks[-1].step if self._looks else 0):
            self._looks.append(self._newest_look())

    def _finish_look(self) -> None:
        """Keep what the tracker has found for whoever asks while it works on the next frame, in another thread."""
        assert self._tracker is not None
        gaps = self._tracker.gaps()
        self._newest = None if gaps is None else (self._look_now(self._tracker), gaps.decided())

    def _newest_look(self) -> Look:
        """The newest finished look, as one after the steps done by now."""
        assert self._newest is not None, "there is a look at the grid only after the reference"
        return replace(self._newest[0], step=self._exposure.steps_done)

    def _look_now(self, tracker: GoalTracker) -> Look:
        gaps = tracker.gaps()
        assert gaps is not None, "there is a look at the grid only after the reference"
        steps, tracks = self._exposure.steps_done, tracker.grid_tracks()[1]
        return Look(steps, tracks, tracker.placed(), gaps.parted(), gaps.bed(), gaps.slit(), gaps.stranded())

    def _leave_at(self, steps: int) -> int:
        """Where the tissue is left after a pull: where enough is in sight; straight pulls, and those of all steps, end as in the paper."""
        config, grid = self._config, self.grid()
        if config.exposure is not ExposureKind.OPTIMAL or not config.optimal.stop_early:
            return steps
        assert grid is not None, "a pull is looked at"
        looks = [*(look for look in self._looks if look.step < steps), self._newest_look()]
        return last_in_sight(grid, looks, config.likelihood.min_confidence, config.optimal.least_steps)

    def _depth(self, points: Array) -> DepthMap:
        """Stereo depth around `points` (N, 2), those that are finite; of the whole picture if none is."""
        endoscope = self._gate.bench.endoscope
        camera = endoscope.camera
        finite = points[np.isfinite(points).all(axis=1)]
        size = (camera.width, camera.height)
        region = region_around(finite, self._config.strain.margin, size) if len(finite) else None
        return depth_from_stereo(endoscope.stereo(), camera, self._config.stereo, region)

    def _gaps(self) -> Array | None:
        return None if self._newest is None else self._newest[1]

    def _mark_reference(self) -> Steps[Grid | None]:
        """Ask the tracker, which runs beside, for a reference: its grid, or None if it was not taken in time."""
        self._reference_wanted = True
        until = self._gate.bench.now() + self._config.reference_patience
        while self._reference_wanted:
            if self._gate.bench.now() > until:
                self._reference_wanted = False
                return None
            yield Progress("taking the reference image")
        return self.grid()

    def _replan(self, graph: ConnectivityGraph) -> NextGoal:
        assert self._tracked is not None and self._tracker is not None and self.frame is not None
        config, image = self._config, self.frame.image
        outline = tissue_outline(tissue_mask(image, config.tissue) | hidden_mask(image, config.tissue))
        seen = self._tracker.grid_tracks()[1].visible
        return next_goal(graph, self._tracked, config.replan, self._rng, outline, seen, graph.goal_length)

    def _measured_length(self) -> float | None:
        """Length [m] of the goal as tracked, by stereo along its nearer and its farther row; None where too little depth is seen."""
        assert self._tracker is not None
        tracked = self._tracker.tracked()
        rows = [tracked.near, tracked.far]
        depth, camera = self._depth(np.vstack(rows)), self._gate.bench.endoscope.camera
        lengths = []
        for row in rows:
            points = camera.unproject(row, depth_at(depth, row, self._config.strain.radius))
            steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
            known = np.isfinite(steps)
            if known.mean() > 0.5:
                lengths.append(float(np.median(steps[known])) * len(steps))
        return min(lengths) if lengths else None

    def _estimate(self, tracker: GoalTracker) -> ConnectivityGraph:
        reference, tracks, grid = tracker.grid_tracks()
        if self._config.rule is Rule.ELONGATION:
            return located(by_elongation(grid, reference, tracks, self._config.elongation), self._goal_length)
        looks = [*self._looks, self._look_now(tracker)]
        graph = by_likelihood(grid, reference, looks, self._exposure.forecast(), self._config.likelihood)
        return located(graph, self._goal_length)
