"""The skills of one session, put together: what the tree asks for by name, with the tracker, the agent and the settings they share."""

from __future__ import annotations

import shutil
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hardware.codes import Code
from hardware.gate import Lease, SafetyGate
from hardware.interface import CUTTER, Array, Frame, Pose
from skills.checklist import checklist
from skills.checklist_outcome import CheckOutcome
from skills.dissect.outcome import DissectOutcome
from skills.dissect.planning import PlanningAgent, PlanningConfig
from skills.estimate.elongation import ElongationConfig, estimate_connectivity, opening_along
from skills.estimate.graph import ConnectivityGraph
from skills.expose.naive import ExposureNaive, NaiveConfig
from skills.expose.outcome import ExposeOutcome
from skills.grasp import GraspConfig
from skills.replan.candidates import ReplanConfig
from skills.replan.greedy import next_goal
from skills.replan.next_goal import NextGoal
from skills.retreat import retreat
from skills.retreat_outcome import RetreatOutcome
from skills.scene.goal import Goal
from skills.scene.stereo import StereoConfig
from skills.scene.tissue import TissueConfig, tissue_mask
from skills.skill import Progress, Steps, computed
from skills.tracking.goal_tracker import GoalTracker, GoalTrackerConfig
from skills.tracking.outcome import TrackOutcome
from skills.tracking.tracks import TrackedGoal


@dataclass(frozen=True)
class SkillConfig:
    """Settings of every skill; written into the record as they are."""

    planning: PlanningConfig = field(default_factory=PlanningConfig)
    grasp: GraspConfig = field(default_factory=GraspConfig)
    stereo: StereoConfig = field(default_factory=StereoConfig)
    naive: NaiveConfig = field(default_factory=NaiveConfig)
    tracker: GoalTrackerConfig = field(default_factory=GoalTrackerConfig)
    elongation: ElongationConfig = field(default_factory=ElongationConfig)
    replan: ReplanConfig = field(default_factory=ReplanConfig)
    tissue: TissueConfig = field(default_factory=TissueConfig)
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
        self._rng = np.random.default_rng([seed, 3])
        self._calibration = calibration
        self._record = record
        self._agent = PlanningAgent(config.planning, config.grasp, config.stereo, executor)
        self._exposure = ExposureNaive(config.naive, config.stereo, executor)
        self._tracker: GoalTracker | None = None
        self._tracked: TrackedGoal | None = None
        self._reference_wanted = False
        self._due = -np.inf
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
        tracker = GoalTracker(self._config.tracker)
        self.frame = self._gate.bench.endoscope.left()
        self._tracked = tracker.start(self.frame, goal)
        if self._tracked.lost:
            return TrackOutcome(Code.GOAL_LOST, "the goal cannot be followed: too little of it is seen")
        self._tracker = tracker
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
                    self._reference_wanted = False
                else:
                    self._tracked = yield from computed(self._executor, "following the goal", self._tracker.update, self.frame)
                if not np.isnan(self._tracked.strain):
                    self._gate.report_strain(self._tracked.strain, self._tracked.stamp)
            yield Progress("following the goal")

    def tracked(self) -> TrackedGoal | None:
        """The goal as last seen."""
        return self._tracked

    def dissect(self, lease: Lease, segments: Array | None) -> Steps[DissectOutcome]:
        """The planning agent cuts the goal or the corrective segments."""
        return (yield from self._agent.run(lease, self.tracked, segments))

    def expose(self, lease: Lease) -> Steps[ExposeOutcome]:
        """The naive straight pull, with a reference image (t_d) before it."""
        park = self._park or lease.measured_cp(CUTTER).value
        return (yield from self._exposure.run(lease, self.tracked, self._agent.grasped, park, self._mark_reference))

    def estimate(self) -> Steps[ConnectivityGraph]:
        """Judge every edge of the keypoint grid from its elongation since the reference."""
        yield Progress("estimating what is still attached")
        assert self._tracker is not None, "the tree estimates only after tracking has started"
        return (yield from computed(self._executor, "estimating what is still attached", self._estimate, self._tracker))

    def replan(self, graph: ConnectivityGraph) -> Steps[NextGoal]:
        """The fewest segments that sever what is left (greedy)."""
        yield Progress("planning the corrective cuts")
        assert self._tracked is not None
        plan = computed(
            self._executor, "planning the corrective cuts", next_goal, graph, self._tracked, self._config.replan, self._rng
        )
        return (yield from plan)

    def retreat(self, lease: Lease) -> Steps[RetreatOutcome]:
        """Scissors to where they waited, both arms hold."""
        return (yield from retreat(lease, self._park or lease.measured_cp(CUTTER).value))

    def _mark_reference(self) -> Steps[bool]:
        """Ask the tracker, which runs beside, for a reference; whether it was taken in time."""
        self._reference_wanted = True
        until = self._gate.bench.now() + self._config.reference_patience
        while self._reference_wanted:
            if self._gate.bench.now() > until:
                self._reference_wanted = False
                return False
            yield Progress("taking the reference image")
        return True

    def _estimate(self, tracker: GoalTracker) -> ConnectivityGraph:
        reference, tracks, grid = tracker.grid_tracks()
        assert self.frame is not None
        tissue = tissue_mask(self.frame.image, self._config.tissue)
        opening = opening_along(tracks.points, grid.edges, tissue)
        return estimate_connectivity(grid, reference, tracks, self._config.elongation, opening)
