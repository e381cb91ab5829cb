"""When a motion of the robot is done: a pure state machine over what was seen since the command was sent.

"No longer busy" is no success: an interrupted motion and a fault end busy too, and a busy pulse may be anybody's. Done is done only by
all of: the command made the arm busy, it came to rest, `goal_reached` said yes since, and setpoint and measured are near the goal for
some samples in a row. Everything else is a failure with a code and, where the robot gave one, its own last text.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum

from hardware.codes import Code
from hardware.interface import MoveReport, MoveStatus

RUNNING = MoveReport(MoveStatus.RUNNING)
SETTLE_WITHIN = 0.5  # [s] after the arm came to rest, for goal_reached and measurements to follow
PATIENCE = 2.0  # times the computed duration, and this many seconds on top, before a motion is too late
ALLOWANCE = 1.0  # [s]


class Phase(StrEnum):
    """How far a motion has come."""

    SENT = "sent"
    MOVING = "moving"
    SETTLING = "settling"


@dataclass(frozen=True)
class Motion:
    """One motion sent at `sent` [s] that must be over by `deadline` [s]; `near` samples in a row were near the goal."""

    sent: float
    deadline: float
    phase: Phase = Phase.SENT
    rested: float = math.nan  # [s], when the arm was seen at rest
    near: int = 0
    counted: float = -math.inf  # [s], stamp of the last sample counted
    report: MoveReport = RUNNING


@dataclass(frozen=True)
class Look:
    """What is known at `now` [s]. `goal_reached` is the robot's answer received since the command, None while there is none."""

    now: float
    trouble: Code  # OK while the arm is ready and its data are good
    why: str
    busy: bool  # now
    busy_at: float  # [s], when busy was last received: a short motion is over before anybody looks
    goal_reached: bool | None
    said: str  # the robot's error or warning received since the command
    setpoint_near: bool
    measured_near: bool
    stamp: float  # [s], of the measured sample


def begin(now: float, duration: float) -> Motion:
    """A motion sent `now` [s] that should take `duration` [s]."""
    return Motion(now, now + PATIENCE * duration + ALLOWANCE)


def follow(motion: Motion, look: Look, name: str, busy_within: float, samples: int) -> Motion:
    """Take one more look at the motion of `name`: accepted within `busy_within` [s], near for `samples` in a row."""
    if motion.report is not RUNNING:
        return motion
    if look.trouble is not Code.OK:
        return _failed(motion, look.trouble, look.why)
    if look.goal_reached is False:
        return _failed(motion, Code.MOVE_NOT_REACHED, f"{name} ended the motion before its goal{_quoted(look.said)}")
    if look.now > motion.deadline:
        took = look.now - motion.sent
        return _failed(motion, Code.MOVE_TIMEOUT, f"{name} did not arrive within {took:.1f} s{_quoted(look.said)}")
    if motion.phase is Phase.SENT:
        if look.busy_at < motion.sent:
            if look.now <= motion.sent + busy_within:
                return motion
            said = _quoted(look.said) or ": the command was lost or refused"
            return _failed(motion, Code.MOVE_REJECTED, f"{name} did not begin the motion within {busy_within:.1f} s{said}")
        motion = replace(motion, phase=Phase.MOVING)
    if look.busy:  # still, or again
        return replace(motion, phase=Phase.MOVING, near=0)
    if motion.phase is Phase.MOVING:
        motion = replace(motion, phase=Phase.SETTLING, rested=look.now)
    return _settle(motion, look, name, samples)


def _settle(motion: Motion, look: Look, name: str, samples: int) -> Motion:
    """At rest: count the samples that are near the goal."""
    if look.goal_reached and look.setpoint_near and look.stamp > max(motion.counted, motion.rested):
        motion = replace(motion, near=motion.near + 1 if look.measured_near else 0, counted=look.stamp)
    if motion.near >= samples:
        return replace(motion, report=MoveReport(MoveStatus.DONE))
    if look.now <= motion.rested + SETTLE_WITHIN:
        return motion
    if look.goal_reached is None:
        missing = "without saying that the goal was reached"
    elif not look.setpoint_near:
        missing = "with a setpoint that is not the goal"
    else:
        missing = "away from the goal"
    return _failed(motion, Code.MOVE_NOT_REACHED, f"{name} came to rest {missing}{_quoted(look.said)}")


def _failed(motion: Motion, code: Code, message: str) -> Motion:
    return replace(motion, report=MoveReport(MoveStatus.FAILED, code, message))


def _quoted(said: str) -> str:
    return f": {said}" if said else ""
