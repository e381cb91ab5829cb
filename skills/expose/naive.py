"""The naive exposure of the paper's comparison: a straight pull from the goal's middle towards the grasp, 0.5 mm a step, 35 steps."""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from hardware.codes import Code
from hardware.gate import Lease
from hardware.interface import CUTTER, GRASPER, Array, MoveReport, MoveStatus, Pose
from skills.expose.outcome import ExposeOutcome
from skills.grasp import Grasped
from skills.motion import pause, servo_line, wait
from skills.scene.stereo import StereoConfig, depth_at, depth_from_stereo, region_around
from skills.skill import Progress, Steps, computed
from skills.tracking.tracks import TrackedGoal


@dataclass(frozen=True)
class NaiveConfig:
    """Settings of the naive exposure. Lengths [m], speeds [m/s]."""

    step: float = 0.5e-3
    steps: int = 35
    speed: float = 5e-3
    relaxed: float = 6e-3  # retraction of the grasp at which the reference image is taken
    settle: float = 0.3  # [s] before the reference and after the pull


class ExposureNaive:
    """Pulls straight, then leaves the tissue stretched for the estimate."""

    def __init__(self, config: NaiveConfig, stereo: StereoConfig, executor: Executor) -> None:
        self._config = config
        self._stereo = stereo
        self._executor = executor

    def run(
        self,
        lease: Lease,
        tracked: Callable[[], TrackedGoal | None],
        grasped: Grasped | None,
        park: Pose,
        mark_reference: Callable[[], Steps[bool]],
    ) -> Steps[ExposeOutcome]:
        """Park the scissors at `park`, relax, take the reference image (t_d), pull (to t_e)."""
        config = self._config
        path: list[Array] = []
        tension: list[float] = []
        strain: list[float] = []

        def ended(code: Code, message: str, stopped_by: Code) -> ExposeOutcome:
            rows = np.array(path).reshape(-1, 3)
            return ExposeOutcome(code, message, stopped_by, rows, np.array(tension), np.array(strain))

        try:
            if grasped is None:
                return ended(Code.GRASP_EMPTY, "no tissue is grasped, so nothing can be exposed", Code.GRASP_EMPTY)
            report = yield from wait(lease.move_cp(CUTTER, park), "moving the scissors out of sight")
            if report.status is MoveStatus.FAILED:
                return ended(report.code, report.message, report.code)
            report = yield from self._relax(lease, grasped)
            if report.status is MoveStatus.FAILED:
                return ended(report.code, report.message, report.code)
            yield from pause(lease, config.settle, "letting the tissue settle")
            goal = tracked()
            if goal is None or goal.lost:
                return ended(Code.GOAL_LOST, "the goal cannot be seen well enough to judge an exposure", Code.GOAL_LOST)
            direction = yield from self._direction(lease, goal)
            if direction is None:
                return ended(Code.DEPTH_INVALID, "the depth of the goal cannot be seen", Code.DEPTH_INVALID)
            if not (yield from mark_reference()):
                return ended(Code.GOAL_LOST, "the tracker gave no reference image", Code.GOAL_LOST)
            start = lease.setpoint_cp(GRASPER)
            for number in range(1, config.steps + 1):
                target = start.moved(number * config.step * direction)
                doing = f"exposing: step {number} of {config.steps}"
                report = yield from servo_line(lease, GRASPER, target, config.speed, doing)
                if report.code in (Code.TENSION, Code.STRAIN):
                    yield from pause(lease, config.settle, doing)
                    return ended(Code.OK, f"pulled {number - 1} of {config.steps} steps: {report.message}", report.code)
                if report.status is MoveStatus.FAILED:
                    return ended(report.code, report.message, report.code)
                path.append(target.position)
                tension.append(lease.tension())
                now = tracked()
                strain.append(now.strain if now else float("nan"))
            yield from pause(lease, config.settle, "letting the tissue settle")
            return ended(Code.OK, f"pulled all {config.steps} steps", Code.EXPOSURE_STEPS_DONE)
        finally:
            lease.hold()

    def _relax(self, lease: Lease, grasped: Grasped) -> Steps[MoveReport]:
        """Come back along the last pull until the grasp is `relaxed` from where it closed."""
        here = lease.setpoint_cp(GRASPER)
        out = here.position - grasped.origin.position
        distance = float(np.linalg.norm(out))
        if distance <= self._config.relaxed + 1e-6:
            return MoveReport(MoveStatus.DONE)
        target = here.at(grasped.origin.position + out * (self._config.relaxed / distance))
        return (yield from servo_line(lease, GRASPER, target, self._config.speed, "relaxing the tissue"))

    def _direction(self, lease: Lease, goal: TrackedGoal) -> Steps[Array | None]:
        """Unit vector (3,) from the goal's midpoint to the grasping point (paper, Evaluation of Exposure Maximization Control)."""
        yield Progress("looking")
        camera = lease.endoscope.camera
        rows = np.vstack([goal.near[goal.visible], goal.far[goal.visible]])
        region = region_around(rows, 70.0, (camera.width, camera.height))
        stereo = lease.endoscope.stereo()
        depth = yield from computed(self._executor, "measuring depth", depth_from_stereo, stereo, camera, self._stereo, region)
        third = len(goal.polyline) // 3
        middle = np.vstack([goal.near[third:-third], goal.far[third:-third]])
        points = camera.unproject(middle, depth_at(depth, middle, 5))
        points = points[np.isfinite(points).all(axis=1)]
        if len(points) < 3:
            return None
        vector = lease.measured_cp(GRASPER).value.position - np.median(points, axis=0)
        return np.asarray(vector / np.linalg.norm(vector))
