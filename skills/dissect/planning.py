"""The planning agent (paper, Planning-based Dissection): grasp, retract along the goal's normal, and cut along it snip by snip.

The tracked goal is lifted to 3D by stereo depth; the cut is a series of line segments with the tool oriented along the path; each snip
moves to its pose, inserts to a fixed depth and closes. Each corrective pass goes a little deeper.
"""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.codes import Code
from hardware.gate import Lease
from hardware.interface import CUTTER, GRASPER, Array, MoveReport, MoveStatus, Pose
from skills.dissect.outcome import DissectOutcome, Snip
from skills.grasp import GraspConfig, Grasped, take
from skills.motion import pause, servo_line, wait
from skills.scene.stereo import DepthMap, StereoConfig, depth_at, depth_from_stereo, region_around, surface_normal_at
from skills.skill import Progress, Steps, computed
from skills.tracking.goal_coordinates import from_goal_coordinates, to_goal_coordinates
from skills.tracking.tracks import TrackedGoal

BLADE = 10e-3  # [m], of the scissors


@dataclass(frozen=True)
class PlanningConfig:
    """Settings of the planning agent. Lengths [m], angles [rad], speeds [m/s]."""

    snip: float = 5.0e-3  # advance along the goal from snip to snip
    overlap: float = 1.6e-3  # by which neighbouring snips are meant to overlap
    depth: float = 3.0e-3  # of the closed tip below the surface: the fixed insertion depth
    deeper: float = 0.6e-3  # at each corrective pass: what was cut there and still holds was cut too shallow
    deepest: float = 4.5e-3
    clearance: float = 12e-3  # of the tip above the surface between snips
    least_jaw: float = np.deg2rad(20.0)
    most_jaw: float = np.deg2rad(60.0)
    insertion_speed: float = 10e-3
    retraction: float = 6e-3  # of the grasp before cutting
    lift: float = np.deg2rad(45.0)  # of the retraction out of the surface
    settle: float = 0.12  # [s] before the blades close; three times as long after
    patience: float = 1.0  # [s] to wait for the tracker to see the goal anew
    depth_radius: int = 5  # [px] of the neighbourhood that a depth is read from
    margin: float = 70.0  # [px] around the goal that is matched in stereo


class PlanningAgent:
    """Cuts along a tracked goal. Remembers its grasp from attempt to attempt; `grasped` is None when it has none.

    `clear_view` is False while the scissors move over the goal: what the tracker would see then is the instrument.
    """

    def __init__(self, config: PlanningConfig, grasp: GraspConfig, stereo: StereoConfig, executor: Executor) -> None:
        self._config = config
        self._grasp = grasp
        self._stereo = stereo
        self._executor = executor
        self._depth = config.depth
        self._misses = 0  # times that the jaws closed on nothing
        self.grasped: Grasped | None = None
        self.clear_view = True

    def run(self, lease: Lease, tracked: Callable[[], TrackedGoal | None], segments: Array | None) -> Steps[DissectOutcome]:
        """Cut the whole goal, or the corrective `segments` (S, 2, 2) pixels, which then follow the goal as it moves."""
        snips: list[Snip] = []
        try:
            goal = tracked()
            if goal is None or goal.lost:
                return DissectOutcome(Code.GOAL_LOST, "the goal cannot be seen well enough to cut", ())
            deeper = 0.0 if segments is None else self._depth - self._config.depth + self._config.deeper
            self._depth = min(self._config.depth + deeper, self._config.deepest)
            plan = [np.array([[0.0, 0.0], [1.0, 0.0]])] if segments is None else [_on_goal(goal, s) for s in segments]
            if self.grasped is None:
                report = yield from self.take_hold(lease, goal, self._config.retraction)
                if report.status is MoveStatus.FAILED:
                    return DissectOutcome(report.code, report.message, ())
            for number, segment in enumerate(plan):
                name = f"segment {number + 1} of {len(plan)}"
                report = yield from self._cut_segment(lease, tracked, segment, segments is not None, name, snips)
                if report.status is MoveStatus.FAILED:
                    return DissectOutcome(report.code, report.message, tuple(snips))
            missed = [snip for snip in snips if snip.code is not Code.OK]
            if missed and len(missed) == len(snips):
                return DissectOutcome(missed[-1].code, missed[-1].message, tuple(snips))
            made = f"{len(snips) - len(missed)} snips made" + (
                f", {len(missed)} left out: {missed[-1].message}" if missed else ""
            )
            return DissectOutcome(Code.OK, made, tuple(snips))
        finally:
            self.clear_view = True
            lease.hold()

    # ------------------------------------------------------------ grasp and retraction

    def take_hold(self, lease: Lease, goal: TrackedGoal, retraction: float) -> Steps[MoveReport]:
        """Grasp at the tracked grasp pixel, then retract along the goal's normal by `retraction` [m], lifting."""
        depth = yield from self._look(lease, goal)
        camera = lease.endoscope.camera
        z = depth_at(depth, goal.grasp[None], self._config.depth_radius)
        middle_z = depth_at(depth, goal.polyline[len(goal.polyline) // 2][None], self._config.depth_radius)
        if not (goal.grasp_visible and np.isfinite(z).all() and np.isfinite(middle_z).all()):
            return MoveReport(MoveStatus.FAILED, Code.DEPTH_INVALID, "the depth at the grasp point cannot be seen")
        point = camera.unproject(goal.grasp[None], z)[0]
        middle = camera.unproject(goal.polyline[len(goal.polyline) // 2][None], middle_z)[0]
        normal = surface_normal_at(depth, camera, goal.grasp, 20)
        if not np.isfinite(normal).all():
            return MoveReport(MoveStatus.FAILED, Code.DEPTH_INVALID, "the surface at the grasp point cannot be seen")
        grasp = replace(self._grasp, bite=self._grasp.bite + self._misses * self._grasp.deeper)
        report, self.grasped = yield from take(lease, point, normal, point - middle, grasp)
        self._misses += report.code is Code.GRASP_EMPTY
        if self.grasped is None or retraction <= 0.0:
            return report
        direction = retraction_direction(point - middle, normal, self._config.lift)
        target = self.grasped.origin.moved(retraction * direction)
        report = yield from servo_line(lease, GRASPER, target, self._grasp.pull_speed, "retracting along the goal's normal")
        if report.code in (Code.TENSION, Code.STRAIN):
            # As far as the limits allow is far enough to cut under tension.
            return MoveReport(MoveStatus.DONE)
        return report

    # ------------------------------------------------------------ cutting

    def _cut_segment(
        self,
        lease: Lease,
        tracked: Callable[[], TrackedGoal | None],
        segment: Array,
        corrective: bool,
        name: str,
        snips: list[Snip],
    ) -> Steps[MoveReport]:
        """Cut one segment, given in goal coordinates (2, 2), as a row of snips planned on the goal as it lies now."""
        count = None
        done = 0
        while count is None or done < count:
            goal = yield from self._fresh(lease, tracked)
            if goal is None or goal.lost:
                return MoveReport(MoveStatus.FAILED, Code.GOAL_LOST, "the goal was lost from sight while cutting")
            depth = yield from self._look(lease, goal)
            path = self._lift(lease, goal, depth, segment)
            if path is None:
                return MoveReport(MoveStatus.FAILED, Code.DEPTH_INVALID, f"the depth along {name} cannot be seen")
            # The blades reach over the ends of what they are to cut; at the goal's own ends a corrective cut keeps inside.
            before, after = (self._config.overlap / 2 if corrective and end in (0.0, 1.0) else 0.0 for end in segment[:, 0])
            before, after = (min(inset, path.length / 4) for inset in (before, after))
            length = path.length - before - after
            if count is None:
                count = max(1, int(np.ceil(length / self._config.snip - 0.05)))
            stretch = length / count
            doing = f"{name}: snip {done + 1} of {count}"
            report, pose = yield from self._snip(lease, path, before + (done + 0.5) * stretch, stretch, doing)
            start, end = path.pixels_at((before + done * stretch, before + (done + 1) * stretch))
            if report.status is MoveStatus.FAILED and report.code in FATAL:
                return report
            snips.append(Snip(lease.now(), tuple(start), tuple(end), pose, report.code, report.message))  # type: ignore[arg-type]
            done += 1
        return MoveReport(MoveStatus.DONE)

    def _snip(self, lease: Lease, path: "Path", at: float, stretch: float, doing: str) -> Steps[tuple[MoveReport, Pose]]:
        """One snip centred at arc length `at` [m]: go above, open, insert to the depth of this pass, close, come back."""
        config, depth = self._config, self._depth
        point, tangent, normal = path.frame_at(at, stretch)
        pose = Pose.looking(point - depth * normal, -normal, tangent)
        above = pose.moved((depth + config.clearance) * normal)
        reach = BLADE - depth
        jaw = float(np.clip(2 * np.arctan((stretch + config.overlap) / 2 / reach), config.least_jaw, config.most_jaw))
        self.clear_view = False
        try:
            report = yield from self._close_at(lease, pose, above, jaw, doing)
        finally:
            # However the snip ended, the next one needs to see the goal.
            self.clear_view = True
        return report, pose

    def _close_at(self, lease: Lease, pose: Pose, above: Pose, jaw: float, doing: str) -> Steps[MoveReport]:
        """Go above, open, insert, close, come back above; the first motion that fails is the answer."""
        config = self._config
        report = yield from wait(lease.move_cp(CUTTER, above), doing)
        if report.status is MoveStatus.FAILED:
            return report
        report = yield from wait(lease.move_jaw(CUTTER, jaw), doing)
        if report.status is MoveStatus.FAILED:
            return report
        report = yield from servo_line(lease, CUTTER, pose, config.insertion_speed, doing)
        if report.status is not MoveStatus.FAILED:
            # The cut springs open within a few tenths of a second: the tracker has to watch, though the blades are in its view.
            self.clear_view = True
            yield from pause(lease, config.settle, doing)
            report = yield from wait(lease.move_jaw(CUTTER, 0.0), doing)
            yield from pause(lease, 3 * config.settle, doing)
            self.clear_view = False
        back = yield from wait(lease.move_cp(CUTTER, above), doing)
        return report if report.status is MoveStatus.FAILED else back

    # ------------------------------------------------------------ seeing

    def _fresh(self, lease: Lease, tracked: Callable[[], TrackedGoal | None]) -> Steps[TrackedGoal | None]:
        """The goal as it lies after all motion so far; the last one known if the tracker gives none in time."""
        now = lease.now()
        while (goal := tracked()) is not None and goal.stamp < now and lease.now() < now + self._config.patience:
            yield Progress("waiting for the tracker")
        return goal if goal is not None and goal.stamp >= now else None

    def _look(self, lease: Lease, goal: TrackedGoal) -> Steps[DepthMap]:
        """Stereo depth around the goal and the grasp."""
        yield Progress("looking")
        camera = lease.endoscope.camera
        around = np.vstack([goal.near, goal.far, goal.grasp])
        region = region_around(around, self._config.margin, (camera.width, camera.height))
        stereo = lease.endoscope.stereo()
        return (yield from computed(self._executor, "measuring depth", depth_from_stereo, stereo, camera, self._stereo, region))

    def _lift(self, lease: Lease, goal: TrackedGoal, depth: DepthMap, segment: Array) -> "Path | None":
        """The segment in 3D: the depth is read on both rows beside the goal, since the goal's own line may lie in an open gap."""
        camera = lease.endoscope.camera
        count = 25
        along = np.linspace(segment[0], segment[1], count)
        lifted = []
        for side in (1.0, -1.0):
            beside = from_goal_coordinates(goal, np.column_stack([along[:, 0], np.full(count, side)]))
            lifted.append(camera.unproject(beside, depth_at(depth, beside, self._config.depth_radius)))
        near, far = lifted
        share = (1.0 + along[:, 1:]) / 2.0
        points = share * near + (1.0 - share) * far
        known: NDArray[np.bool_] = np.asarray(np.isfinite(points).all(axis=1))
        if known.sum() < max(4, 0.3 * count):
            return None
        across = near - far
        return Path.through(points, across, from_goal_coordinates(goal, along), known)


@dataclass(frozen=True)
class Path:
    """A segment lifted to 3D: `points` (N, 3) [m], `across` (N, 3) towards the grasp's side, `pixels` (N, 2), arc length (N,) [m]."""

    points: Array
    across: Array
    pixels: Array
    arc: Array

    @staticmethod
    def through(points: Array, across: Array, pixels: Array, known: NDArray[np.bool_]) -> "Path":
        """Smooth points with gaps: a cubic in the parameter for each coordinate keeps single bad depths from bending the path."""
        t = np.linspace(-1.0, 1.0, len(points))
        degree = 3 if known.sum() > 8 else 1

        def smooth(values: Array) -> Array:
            weights = known.astype(float)
            for _ in range(3):
                fit = np.polynomial.polynomial.polyfit(t[known], values[known], degree, w=weights[known])
                fitted = np.polynomial.polynomial.polyval(t, fit).T
                error = np.linalg.norm(values - fitted, axis=1)
                scale = max(float(np.nanmedian(error[known])), 5e-5)
                weights = np.where(known, 1.0 / (1.0 + (error / (2.5 * scale)) ** 2), 0.0)
            return np.asarray(fitted)

        points, across = smooth(points), smooth(across)
        arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        return Path(points, across, pixels, arc)

    @property
    def length(self) -> float:
        """[m]."""
        return float(self.arc[-1])

    def pixels_at(self, arcs: tuple[float, ...]) -> Array:
        """Pixels (K, 2) at arc lengths [m]."""
        return np.column_stack([np.interp(arcs, self.arc, self.pixels[:, i]) for i in range(2)])

    def frame_at(self, at: float, stretch: float) -> tuple[Array, Array, Array]:
        """Point, unit tangent over `stretch` [m], and unit surface normal towards the camera, at arc length `at` [m]."""

        def read(values: Array, s: float) -> Array:
            return np.array([np.interp(s, self.arc, values[:, i]) for i in range(3)])

        point = read(self.points, at)
        tangent = read(self.points, min(self.length, at + stretch / 2)) - read(self.points, max(0.0, at - stretch / 2))
        tangent = tangent / np.linalg.norm(tangent)
        normal = np.cross(tangent, read(self.across, at))
        normal = normal / np.linalg.norm(normal)
        if normal @ point > 0:
            normal = -normal
        return point, tangent, normal


def _on_goal(goal: TrackedGoal, segment: Array) -> Array:
    """A corrective `segment` (2, 2) pixels in goal coordinates, no longer than to the goal's ends: what lies beyond is to stay whole."""
    coordinates = to_goal_coordinates(goal, segment)
    return np.column_stack([np.clip(coordinates[:, 0], 0.0, 1.0), coordinates[:, 1]])


def retraction_direction(away: Array, normal: Array, lift: float) -> Array:
    """Unit vector (3,): along `away` from the goal in the surface, raised by `lift` [rad] out of it."""
    flat = away - normal * (away @ normal)
    flat = flat / np.linalg.norm(flat)
    return np.asarray(np.cos(lift) * flat + np.sin(lift) * normal)


FATAL = frozenset(
    {
        Code.ARM_FAULT,
        Code.ARM_NOT_READY,
        Code.ARM_DATA_STALE,
        Code.CAMERA_STALE,
        Code.LEASE_REVOKED,
        Code.TRIPPED,
        Code.EMERGENCY_STOP,
        Code.CUT_NOT_APPROVED,
        Code.CUT_LIMIT,
        Code.MOVE_TIMEOUT,
        Code.MOVE_REJECTED,
        Code.NOT_FINITE,
    }
)
