"""Grasping and holding tissue with PSM1: approach, close, and see by the force whether something was caught."""

from dataclasses import dataclass

import numpy as np

from hardware.codes import Code
from hardware.gate import Lease
from hardware.interface import GRASPER, Array, MoveReport, MoveStatus, Pose
from skills.motion import pause, servo_line, wait
from skills.skill import Progress, Steps


@dataclass(frozen=True)
class GraspConfig:
    """How the grasper takes tissue. Lengths [m], angles [rad], speeds [m/s]."""

    jaw_open: float = np.deg2rad(50.0)
    jaw_closed: float = 0.0
    clearance: float = 12e-3  # above the tissue, where the free motion ends
    bite: float = 0.5e-3  # below the surface seen, where the jaws close
    deeper: float = 0.5e-3  # more for each time that they closed on nothing
    approach_speed: float = 10e-3
    pull_speed: float = 5e-3
    shaft_tilt: float = np.deg2rad(30.0)  # of the shaft from the surface normal, away from the goal
    test_pull: float = 2e-3
    test_pulls: int = 3  # one after the other, until the force is felt: soft tissue that lies loose comes along at first
    # Single readings of the force are as noisy (0.05 N on the bench) as soft tissue is light (0.09 N): only their mean tells them apart.
    test_pause: float = 0.2  # [s] after each pull, over which the force is averaged
    least_tension: float = 0.05  # [N] against a test pull of caught tissue


@dataclass(frozen=True)
class Grasped:
    """Tissue in the jaws: the pose `origin` at which they closed and the surface `normal` (3,) there, towards the camera.

    `test_tension` [N] is what a pull of `test_pull` [m] along the normal met, against it: it tells soft tissue from stiff.
    """

    origin: Pose
    normal: Array
    test_pull: float = 0.0
    test_tension: float = 0.0


def take(lease: Lease, point: Array, normal: Array, away: Array, config: GraspConfig) -> Steps[tuple[MoveReport, Grasped | None]]:
    """Grasp the tissue at `point` (3,) [m] with surface `normal` (3,); the shaft leans towards `away` (3,), off the goal."""
    away = away - normal * (away @ normal)
    away = away / np.linalg.norm(away)
    shaft = np.cos(config.shaft_tilt) * normal + np.sin(config.shaft_tilt) * away
    pose = Pose.looking(point - config.bite * normal, -shaft, np.cross(normal, away))
    above = pose.moved(config.clearance * shaft)
    for motion in (
        wait(lease.move_jaw(GRASPER, config.jaw_open), "opening the grasper"),
        wait(lease.move_cp(GRASPER, above), "moving the grasper above the tissue"),
    ):
        report = yield from motion
        if report.status is MoveStatus.FAILED:
            return report, None
    report = yield from servo_line(lease, GRASPER, pose, config.approach_speed, "lowering the grasper")
    if report.status is MoveStatus.FAILED:
        return report, None
    report = yield from wait(lease.move_jaw(GRASPER, config.jaw_closed), "closing the grasper")
    if report.status is MoveStatus.FAILED:
        return report, None
    yield from pause(lease, 0.1, "closing the grasper")
    origin = lease.setpoint_cp(GRASPER)
    for number in range(1, config.test_pulls + 1):
        pulled = number * config.test_pull
        report = yield from servo_line(lease, GRASPER, origin.moved(pulled * normal), config.pull_speed, "testing the grasp")
        if report.status is MoveStatus.FAILED:
            return report, None
        tension = yield from _tension_along(lease, normal, config.test_pause)
        if tension >= config.least_tension:
            return report, Grasped(origin, normal, pulled, tension)
    # Empty jaws left over the grasp point would hide it from whoever tries again. They open first: what is held too loosely to be felt
    # must not be dragged along.
    for motion in (
        wait(lease.move_jaw(GRASPER, config.jaw_open), "opening the empty jaws"),
        wait(lease.move_cp(GRASPER, above), "backing off"),
    ):
        backed = yield from motion
        if backed.status is MoveStatus.FAILED:
            break
    found = f"a pull of {pulled * 1e3:.0f} mm met {tension:.2f} N"
    return MoveReport(MoveStatus.FAILED, Code.GRASP_EMPTY, f"the grasper closed but holds nothing: {found}"), None


def _tension_along(lease: Lease, normal: Array, duration: float) -> Steps[float]:
    """Mean force [N] on the jaws against `normal` (3,), over `duration` [s]; NaN where one reading is."""
    readings: dict[float, float] = {}
    until = lease.now() + duration - 1e-9
    while lease.now() < until:
        yield Progress("testing the grasp")
        force = lease.measured_cf(GRASPER)
        readings[force.stamp] = -float(force.value @ normal)
    return float(np.mean(list(readings.values())))
