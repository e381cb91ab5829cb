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
from hardware.interface import CUTTER, GRASPER, Array, CameraModel, MoveReport, MoveStatus, Pose, StereoFrame
from skills.dissect.outcome import DissectOutcome, Snip
from skills.dissect.path import DEPTH_RADIUS, Path, between_rows, held_part, on_tissue
from skills.grasp import GraspConfig, Grasped, take
from skills.motion import pause, servo_line, wait
from skills.scene.stereo import DepthMap, Region, StereoConfig, depth_at, depth_from_stereo, region_around, surface_normal_at
from skills.scene.tissue import hidden_mask, tissue_mask
from skills.skill import Progress, Steps, computed
from skills.tracking.goal_coordinates import to_goal_coordinates
from skills.tracking.tracks import TrackedGoal

BLADE = 10e-3  # [m], of the scissors


@dataclass(frozen=True)
class PlanningConfig:
    """Settings of the planning agent. Lengths [m], angles [rad], speeds [m/s]."""

    snip: float = 5.0e-3  # advance along the goal from snip to snip
    overlap: float = 1.6e-3  # by which neighbouring snips are meant to overlap
    # Tissue that is slack, as it is far from the grasp, escapes at both ends of a closing jaw: strands were left between snips, pass after
    # pass. Corrective snips are denser and reach farther over each other.
    corrective_snip: float = 3.6e-3
    corrective_overlap: float = 3.0e-3
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
    well_seen: float = 0.8  # share of a corrective segment's stations below which the scissors make way for a look,
    least_seen: float = 0.5  # and below which, with the scissors away, it is not cut
    patience: float = 1.0  # [s] to wait for the tracker to see the goal anew
    margin: float = 70.0  # [px] around the goal that is matched in stereo


@dataclass(frozen=True)
class Seen:
    """Depth, and where tissue is seen (H, W), on one pair of images."""

    depth: DepthMap
    tissue: NDArray[np.bool_]


class PlanningAgent:
    """Cuts along a tracked goal. Remembers its grasp from attempt to attempt.

    `grasped` is None when it has none, `slipped` whether the jaws are closed on what has left them. `clear_view` is False while the
    scissors move over the goal: what the tracker would see then is the instrument.
    """

    def __init__(self, config: PlanningConfig, grasp: GraspConfig, stereo: StereoConfig, executor: Executor) -> None:
        self._config = config
        self._grasp = grasp
        self._stereo = stereo
        self._executor = executor
        self._depth = config.depth
        self._waiting: Pose | None = None  # where the scissors were before they cut
        self._misses = 0  # times that the jaws closed on nothing
        self.slipped = False  # what the jaws closed on has left them, or most of it
        self.grasped: Grasped | None = None
        self.clear_view = True

    def run(self, lease: Lease, tracked: Callable[[], TrackedGoal | None], segments: Array | None) -> Steps[DissectOutcome]:
        """Cut the whole goal, or the corrective `segments` (S, 2, 2) pixels, which then follow the goal as it moves.

        A corrective segment that cannot be seen is left out, or what is left of it; the others are cut all the same.
        """
        snips: list[Snip] = []
        unseen: list[MoveReport] = []
        self._waiting = lease.measured_cp(CUTTER).value
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
                    goal = tracked()
                    if segments is None or report.code not in UNSEEN or goal is None or goal.lost:
                        return DissectOutcome(report.code, report.message, tuple(snips))
                    unseen.append(report)
            missed = [snip for snip in snips if snip.code is not Code.OK]
            failures: list[Snip | MoveReport] = [*missed, *unseen]
            if failures and len(missed) == len(snips):
                return DissectOutcome(failures[-1].code, failures[-1].message, tuple(snips))
            made = [f"{len(snips) - len(missed)} snips made"]
            made += [f"{len(missed)} left out: {missed[-1].message}"] if missed else []
            made += [f"{len(unseen)} of {len(plan)} segments not finished: {unseen[-1].message}"] if unseen else []
            return DissectOutcome(Code.OK, ", ".join(made), tuple(snips))
        finally:
            self.clear_view = True
            lease.hold()

    # ------------------------------------------------------------ grasp and retraction

    def lose_grasp(self) -> None:
        """The tissue has slipped from the jaws: whoever needs it next grasps anew."""
        self.grasped, self.slipped = None, True

    def take_hold(self, lease: Lease, goal: TrackedGoal, retraction: float) -> Steps[MoveReport]:
        """Grasp at the tracked grasp pixel, then retract along the goal's normal by `retraction` [m], lifting."""
        depth = (yield from self._look(lease, goal)).depth
        camera = lease.endoscope.camera
        z = depth_at(depth, goal.grasp[None], DEPTH_RADIUS)
        middle_z = depth_at(depth, goal.polyline[len(goal.polyline) // 2][None], DEPTH_RADIUS)
        if not (goal.grasp_visible and np.isfinite(z).all() and np.isfinite(middle_z).all()):
            return MoveReport(MoveStatus.FAILED, Code.DEPTH_INVALID, "the depth at the grasp point cannot be seen")
        point = camera.unproject(goal.grasp[None], z)[0]
        middle = camera.unproject(goal.polyline[len(goal.polyline) // 2][None], middle_z)[0]
        normal = surface_normal_at(depth, camera, goal.grasp, 20)
        if not np.isfinite(normal).all():
            return MoveReport(MoveStatus.FAILED, Code.DEPTH_INVALID, "the surface at the grasp point cannot be seen")
        if self.slipped:
            # What is still between them goes first: a loaded grasper must not move freely.
            report = yield from wait(
                lease.move_jaw(GRASPER, self._grasp.jaw_open), "opening the jaws that the tissue slipped from"
            )
            if report.status is MoveStatus.FAILED:
                return report
            self.slipped = False
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
        advance, overlap = (
            (self._config.corrective_snip, self._config.corrective_overlap)
            if corrective
            else (self._config.snip, self._config.overlap)
        )
        count = None
        done = 0
        while count is None or done < count:
            goal = yield from self._fresh(lease, tracked)
            if goal is None or goal.lost:
                return MoveReport(MoveStatus.FAILED, Code.GOAL_LOST, "the goal was lost from sight while cutting")
            if corrective and _share_seen(goal, segment) < self._config.well_seen:
                goal = yield from self._unhidden(lease, tracked)
                if goal is None or goal.lost or _share_seen(goal, segment) < self._config.least_seen:
                    return MoveReport(MoveStatus.FAILED, Code.GOAL_LOST, f"the goal along {name} was hidden while cutting")
            seen = yield from self._look(lease, goal)
            if corrective and count is None:
                segment = held_part(goal, seen.depth, lease.endoscope.camera, segment, seen.tissue)
            # What is cut lies open and may be pulled anywhere, so a corrective segment is lifted anew from where it still holds.
            first = done if corrective else 0
            path = self._lift(lease, goal, seen, _rest(segment, first / (count or 1)), corrective)
            if path is None:
                return MoveReport(MoveStatus.FAILED, Code.DEPTH_INVALID, f"the depth along {name} cannot be seen")
            if count is None:
                before, after = _insets(segment, path.length, overlap / 2) if corrective else (0.0, 0.0)
                count = max(1, int(np.ceil((path.length - before - after) / advance - 0.05)))
                inside = np.array([before, path.length - after])[:, None] / path.length
                segment = segment[0] + inside * (segment[1] - segment[0])
            else:
                before, after = 0.0, 0.0
            stretch = (path.length - before - after) / (count - first)
            begin = before + (done - first) * stretch
            doing = f"{name}: snip {done + 1} of {count}"
            frame = path.frame_at(begin + 0.5 * stretch, stretch)
            report, pose = yield from self._snip(lease, frame, stretch + overlap, doing)
            start, end = path.pixels_at((begin, begin + stretch))
            if report.status is MoveStatus.FAILED and report.code in FATAL:
                return report
            snips.append(Snip(lease.now(), tuple(start), tuple(end), pose, report.code, report.message))  # type: ignore[arg-type]
            done += 1
        return MoveReport(MoveStatus.DONE)

    def _snip(self, lease: Lease, frame: tuple[Array, Array, Array], mouth: float, doing: str) -> Steps[tuple[MoveReport, Pose]]:
        """One snip with a `mouth` [m] at the surface: go above, open, insert to the depth of this pass, close, come back.

        `frame` is its centre on the surface, the direction of the cut, and the surface's normal, (3,) each.
        """
        config, depth = self._config, self._depth
        point, tangent, normal = frame
        pose = Pose.looking(point - depth * normal, -normal, tangent)
        above = pose.moved((depth + config.clearance) * normal)
        jaw = float(np.clip(2 * np.arctan(mouth / 2 / (BLADE - depth)), config.least_jaw, config.most_jaw))
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

    def _unhidden(self, lease: Lease, tracked: Callable[[], TrackedGoal | None]) -> Steps[TrackedGoal | None]:
        """The goal as it lies once the scissors, which hide it, are back where they came from; where they are if they cannot go."""
        if self._waiting is not None:
            yield from wait(lease.move_cp(CUTTER, self._waiting), "moving the scissors out of sight")
        return (yield from self._fresh(lease, tracked))

    def _look(self, lease: Lease, goal: TrackedGoal) -> Steps[Seen]:
        """Stereo depth around the goal and the grasp, and where tissue is."""
        yield Progress("looking")
        camera = lease.endoscope.camera
        around = np.vstack([goal.near, goal.far, goal.grasp])
        region = region_around(around, self._config.margin, (camera.width, camera.height))
        stereo = lease.endoscope.stereo()
        return (yield from computed(self._executor, "measuring depth", _seen, stereo, camera, self._stereo, region))

    def _lift(self, lease: Lease, goal: TrackedGoal, seen: Seen, segment: Array, corrective: bool) -> Path | None:
        """The segment in 3D; a corrective one on what still holds, if enough of that is seen."""
        camera = lease.endoscope.camera
        held = on_tissue(goal, seen.depth, camera, segment, seen.tissue) if corrective else None
        return held or between_rows(goal, seen.depth, camera, segment)


def _seen(stereo: StereoFrame, camera: CameraModel, config: StereoConfig, region: Region) -> Seen:
    depth = depth_from_stereo(stereo, camera, config, region)
    return Seen(depth, tissue_mask(stereo.left.image) & ~hidden_mask(stereo.left.image))


def _rest(segment: Array, done: float) -> Array:
    """What is left of a `segment` (2, 2) in goal coordinates of which the share `done` is cut."""
    return np.array([segment[0] + done * (segment[1] - segment[0]), segment[1]])


def _insets(segment: Array, length: float, beyond: float) -> tuple[float, float]:
    """By how much [m] to begin later and end sooner on a `segment` (2, 2) in goal coordinates, `length` [m] long.

    The blades reach `beyond` [m] over the ends of what they are to cut; past the goal's own ends nothing is to be cut.
    """
    share = max(float(abs(segment[1, 0] - segment[0, 0])), 1e-6)
    to_end = np.minimum(segment[:, 0], 1.0 - segment[:, 0]) * length / share
    before, after = np.clip(beyond - to_end, 0.0, length / 4)
    return float(before), float(after)


def _share_seen(goal: TrackedGoal, segment: Array) -> float:
    """Share of the stations that a `segment` (2, 2) in goal coordinates lies at, which are seen on both sides of the goal."""
    place, last = np.sort(segment[:, 0]), len(goal.visible) - 1
    first = int(np.clip(np.floor(place[0] * last), 0, last))
    return float(goal.visible[first : int(np.clip(np.ceil(place[1] * last), first, last)) + 1].mean())


def _on_goal(goal: TrackedGoal, segment: Array) -> Array:
    """A corrective `segment` (2, 2) pixels in goal coordinates, no longer than to the goal's ends: what lies beyond is to stay whole."""
    coordinates = to_goal_coordinates(goal, segment)
    return np.column_stack([np.clip(coordinates[:, 0], 0.0, 1.0), coordinates[:, 1]])


def retraction_direction(away: Array, normal: Array, lift: float) -> Array:
    """Unit vector (3,): along `away` from the goal in the surface, raised by `lift` [rad] out of it."""
    flat = away - normal * (away @ normal)
    flat = flat / np.linalg.norm(flat)
    return np.asarray(np.cos(lift) * flat + np.sin(lift) * normal)


UNSEEN = frozenset({Code.GOAL_LOST, Code.DEPTH_INVALID})

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
