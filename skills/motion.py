"""Motions that skills share, as generators: wait for a motion, servo along a straight line, let time pass.

Each gives a `MoveReport`: a refusal by the gate or a failed motion comes back as its code and sentence, never as an exception.
"""

import numpy as np

from hardware.codes import Code
from hardware.gate import Lease
from hardware.interface import MoveHandle, MoveReport, MoveStatus, Pose
from skills.skill import Progress, Steps

DONE = MoveReport(MoveStatus.DONE)
ARRIVED = 0.6e-3  # [m], between the measured and the wanted position at the end of a servoed line
TURN_PER_TICK = np.deg2rad(3.0)
ARRIVAL_TIME = 1.0  # [s] allowed for the arm to follow its last setpoint


def wait(handle: MoveHandle, doing: str) -> Steps[MoveReport]:
    """Wait until `handle` is done or has failed."""
    while (report := handle.report()).status is MoveStatus.RUNNING:
        yield Progress(doing)
    return report


def pause(lease: Lease, duration: float, doing: str) -> Steps[None]:
    """Let `duration` [s] of bench time pass."""
    until = lease.now() + duration - 1e-9
    while lease.now() < until:
        yield Progress(doing)


def servo_line(lease: Lease, arm: str, target: Pose, speed: float, doing: str, start: Pose | None = None) -> Steps[MoveReport]:
    """Move `arm` straight to `target` at `speed` [m/s], one short step a tick, turning evenly on the way.

    A motion that continues another one begins at `start`, where that one was sent: the setpoint lags behind by the arm's latency.
    """
    start = start or lease.setpoint_cp(arm)
    travel = float(np.linalg.norm(target.position - start.position))
    turning = start.angle_to(target)
    fraction, last = 0.0, lease.now()
    while fraction < 1.0:
        yield Progress(doing, fraction)
        now = lease.now()
        # A late tick must not become a long step.
        step = min(speed * (now - last), 0.9 * lease.limits.max_step)
        fraction = min(1.0, fraction + min(step / max(travel, 1e-9), TURN_PER_TICK / max(turning, 1e-9)))
        report = lease.servo_cp(arm, _between(start, target, fraction))
        # From after the command to before the next: on a robot time goes on in between, and by the gate's clock, which looks within the
        # call, a step is never faster than this.
        last = lease.now()
        if report.status is MoveStatus.FAILED:
            return report
    until = lease.now() + ARRIVAL_TIME
    while np.linalg.norm(lease.measured_cp(arm).value.position - target.position) > ARRIVED:
        if lease.now() > until:
            left = np.linalg.norm(lease.measured_cp(arm).value.position - target.position)
            return MoveReport(MoveStatus.FAILED, Code.MOVE_NOT_REACHED, f"{arm} stayed {left * 1e3:.1f} mm away from its goal")
        yield Progress(doing, 1.0)
    return DONE


def _between(start: Pose, end: Pose, fraction: float) -> Pose:
    """Straight in position, normalised linear in rotation."""
    q0 = start.quaternion
    q1 = end.quaternion if q0 @ end.quaternion >= 0 else -end.quaternion
    q = (1 - fraction) * q0 + fraction * q1
    return Pose((1 - fraction) * start.position + fraction * end.position, q / np.linalg.norm(q))
