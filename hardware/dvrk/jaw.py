"""The jaw of one arm, by the robot's own `jaw/move_jp` while the arm stands still: jaw and arm share one mode and one busy flag.

Never by effort, which would let the whole arm go limp. A closing on tissue ends where the tissue stops it. An instrument without a jaw has
an angle that only this program knows of: to close it is to have energy applied. Angles are ours: 0 closed, the full opening in rad.
Not thread-safe: the arm calls it under its lock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hardware.codes import Code
from hardware.dvrk.arm_readings import ArmReadings, ArmTopics
from hardware.dvrk.config import ArmConfig, RobotConfig
from hardware.dvrk.energy import Application, Energy
from hardware.dvrk.messages import JointState
from hardware.dvrk.motion import Look, Motion, Phase, begin, follow
from hardware.dvrk.moves import Move
from hardware.dvrk.transport import Publisher
from hardware.interface import MoveStatus
from hardware.verdicts import Verdict

FASTEST, QUICKEST = 6.0 * math.pi, 4.0 * math.pi  # [rad/s], [rad/s²] of the jaw at ratio 1 (reference 5)
BLOCKED = 0.20  # [rad]; a grasper that tissue keeps further open than this has not closed on it
OBEYED = 0.02  # [rad] that the jaw's setpoint may be from what was sent: some releases clip it to wrong limits
ROUNDING = 1e-6


@dataclass(frozen=True)
class Ended:
    """How a motion of the jaw ended; `swallowed`: the robot never began it."""

    code: Code
    message: str = ""
    swallowed: bool = False


class Jaw:
    """Implements the jaw's part of an arm."""

    def __init__(
        self, publisher: Publisher[JointState], topics: ArmTopics, arm: ArmConfig, config: RobotConfig, grasps: bool
    ) -> None:
        self._publisher, self._topics, self._arm, self._config, self._grasps = publisher, topics, arm, config, grasps
        self._motion: tuple[Motion, Move, float] | None = None
        self._commanded: float | None = None  # [rad], the robot's angle that the setpoint must keep; None while not known

    @property
    def moving(self) -> bool:
        """Whether a motion of ours is under way."""
        return self._motion is not None

    def commanded(self, readings: ArmReadings) -> float | None:
        """The robot's angle that the setpoint must keep [rad]; None while the jaw moves. Never commanded, it is to stay where it is."""
        if self._motion is not None:
            return None
        if self._commanded is None and readings.jaw_setpoint.good is not None:
            self._commanded = float(readings.jaw_setpoint.good.message.position[0])
        return self._commanded

    def measured(self, readings: ArmReadings) -> tuple[float, float]:
        """Full opening [rad], NaN before the first reading, and its bench time [s]."""
        good = readings.jaw.good
        if good is None:
            return math.nan, -math.inf
        opening = float(good.message.position[0]) - self._arm.jaw_zero
        return (0.0 if opening < 0.0 else opening), good.taken  # pressed together they are no more than closed

    def move(self, angle: float, readings: ArmReadings, stamp: float, now: float, move: Move) -> None:
        """Send the jaw to the full opening `angle` [rad], and tell `move` how it ends; 0 presses the jaws together."""
        goal = self._arm.jaw_closed if angle <= ROUNDING else angle + self._arm.jaw_zero
        tool = self._arm.instrument
        if not tool.jaw_lower - ROUNDING <= goal <= tool.jaw_upper + ROUNDING:
            widest = math.degrees(tool.jaw_upper - self._arm.jaw_zero)
            said = f"an opening of {math.degrees(angle):.0f} degrees is more than the {widest:.0f} degrees of {tool.name}"
            move.end(Code.MOVE_REJECTED, said)
            return
        if readings.jaw.good is None:
            move.end(Code.ARM_DATA_STALE, "the jaw's angle is not known")
            return
        self.stop(Code.MOVE_NOT_REACHED, "another command took this motion's place")
        way = abs(goal - float(readings.jaw.good.message.position[0]))
        self._motion = (begin(now, _duration(way, self._config.speeds.ratio)), move, goal)
        self._commanded = None
        self._publisher.publish(JointState(stamp, ("jaw",), np.array([goal])))

    def step(self, readings: ArmReadings, guard: Verdict, now: float) -> Ended | None:
        """Look at the motion under way; gives how it ended. Where it failed, the arm is to be told to hold."""
        if self._motion is None or readings.jaw.good is None or readings.jaw_setpoint.good is None:
            return None
        motion, move, goal = self._motion
        measured = float(readings.jaw.good.message.position[0])
        told = float(readings.jaw_setpoint.good.message.position[0])
        reached = self._topics.goal_reached.since(motion.sent)
        look = Look(
            now=now,
            trouble=guard.code,
            why=guard.message,
            busy=readings.busy,
            busy_at=readings.busy_at,
            goal_reached=None if reached is None else reached.data,
            said=self._topics.said_since(motion.sent),
            setpoint_near=abs(told - goal) <= OBEYED,
            measured_near=self._near(measured, goal),
            stamp=readings.jaw.good.taken,
        )
        name = f"the jaw of {self._arm.called}"
        motion = follow(motion, look, name, self._config.rates.busy_within, self._config.tolerances.samples)
        self._motion = (motion, move, goal)
        if motion.report.status is MoveStatus.RUNNING:
            return None
        self._motion = None
        if motion.report.status is MoveStatus.DONE:
            self._commanded = goal
            move.end(Code.OK)
            return Ended(Code.OK)
        code, message = motion.report.code, motion.report.message
        if code is Code.MOVE_NOT_REACHED:
            said = f"it stands at {math.degrees(measured):.0f} degrees, its setpoint at {math.degrees(told):.0f}"
            message = f"{message}; {said} where {math.degrees(goal):.0f} were sent"
        move.end(code, message)
        return Ended(code, message, swallowed=motion.phase is Phase.SENT and code is Code.MOVE_REJECTED)

    def stop(self, code: Code, message: str) -> None:
        """The motion under way is over; the jaw stays where it is."""
        if self._motion is not None:
            self._motion[1].end(code, message)
            self._motion = None
            self._commanded = None

    def forget(self) -> None:
        """Where the jaw should be is not known: the arm was not ours for a while."""
        self._commanded = None

    def unrest(self, readings: ArmReadings) -> str:
        """Why the jaw at rest is not where the robot wants it, "" where it is."""
        if readings.jaw.good is None or readings.jaw_setpoint.good is None:
            return f"the jaw of {self._arm.called} does not say where it is"
        measured, told = (float(one.good.message.position[0]) for one in (readings.jaw, readings.jaw_setpoint) if one.good)
        if self._near(measured, told):
            return ""
        return f"the jaw of {self._arm.called} stands at {math.degrees(measured):.0f} degrees, its setpoint at {math.degrees(told):.0f}"

    def _near(self, measured: float, goal: float) -> bool:
        """Whether the jaw is where it was sent; a closing is over where the jaws meet, or the tissue between them."""
        if goal > self._arm.jaw_zero:
            return abs(measured - goal) <= self._config.tolerances.jaw
        return measured - self._arm.jaw_zero <= (BLOCKED if self._grasps else self._config.tolerances.jaw)


class EnergyTip:
    """Stands in for the jaw of an instrument that has none: closing is one application of energy."""

    def __init__(self, arm: ArmConfig, energy: Energy, open_angle: float = 0.5) -> None:
        self._arm, self._energy = arm, energy
        self._angle = open_angle
        self._asked: tuple[Application, Move] | None = None
        self._stamp = -math.inf

    @property
    def moving(self) -> bool:
        """Whether energy was asked for and nobody has answered."""
        return self._asked is not None

    def commanded(self, readings: ArmReadings) -> float | None:
        """There is no jaw whose setpoint could move."""
        return None

    def measured(self, readings: ArmReadings) -> tuple[float, float]:
        """The angle that was commanded, as fresh as the arm."""
        good = readings.local.good
        return self._angle, -math.inf if good is None else good.taken

    def move(self, angle: float, readings: ArmReadings, stamp: float, now: float, move: Move) -> None:
        """Open: nothing happens. Close: energy is asked for."""
        self.stop(Code.MOVE_NOT_REACHED, "another command took this one's place")
        closes = angle < self._angle - ROUNDING
        self._angle = angle
        if closes:
            self._asked = (self._energy.apply(self._arm.name), move)
        else:
            move.end(Code.OK)

    def step(self, readings: ArmReadings, guard: Verdict, now: float) -> Ended | None:
        """Look for the answer; that nobody applied energy is no fault of the robot."""
        if self._asked is None:
            return None
        application, move = self._asked
        if not guard.ok:
            self.stop(guard.code, guard.message)
            return Ended(guard.code, guard.message)
        applied = application.applied()
        if applied is None:
            return None
        self._asked = None
        if applied:
            move.end(Code.OK)
        else:
            move.end(Code.MOVE_NOT_REACHED, f"no energy was applied at {self._arm.called}")
        return Ended(Code.OK)

    def stop(self, code: Code, message: str) -> None:
        """A late answer will not count."""
        if self._asked is not None:
            self._asked[1].end(code, message)
            self._asked = None

    def forget(self) -> None:
        """Nothing to forget."""

    def unrest(self, readings: ArmReadings) -> str:
        """There is no jaw that could be elsewhere."""
        return ""


def _duration(way: float, ratio: float) -> float:
    """How long [s] the robot's trajectory takes for `way` [rad] at `ratio` of its speed and acceleration."""
    speed, acceleration = FASTEST * ratio, QUICKEST * ratio
    ramp = speed / acceleration
    cruise = way / speed
    return cruise + ramp if cruise >= ramp else 2.0 * math.sqrt(way / acceleration)
