"""Straight lines in Cartesian space, streamed as short setpoints: the robot's own `move_cp` interpolates joints and bends the tip's path.

A line is run through with limited speed and acceleration, position and orientation together. A follower spreads each short servo step
of the session over the time until the next one, as the robot takes setpoints as they come, without interpolation of its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hardware.interface import Pose

SLOWEST = 1e-9


@dataclass(frozen=True)
class Pace:
    """How fast: `linear` [m/s], `angular` [rad/s], and the time [s] in which full speed is reached."""

    linear: float
    angular: float
    ramp: float = 0.2


@dataclass(frozen=True)
class Line:
    """From `start` to `goal`; at full speed it would take `cruise` [s], with speeding up and slowing down `duration` [s]."""

    start: Pose
    goal: Pose
    cruise: float
    ramp: float

    @property
    def duration(self) -> float:
        """How long the line takes [s]: a trapezoid of speed, or a triangle where it is short."""
        return self.cruise + self.ramp if self.cruise >= self.ramp else 2.0 * math.sqrt(self.cruise * self.ramp)

    def at(self, elapsed: float) -> Pose:
        """The setpoint `elapsed` [s] after the start; the goal itself from `duration` on."""
        if elapsed >= self.duration:
            return self.goal
        return between(self.start, self.goal, self._fraction(max(elapsed, 0.0)))

    def _fraction(self, t: float) -> float:
        """Share of the way, with constant acceleration at both ends."""
        total, rise = self.duration, min(self.ramp, 0.5 * self.duration)
        share = 1.0 / (self.cruise * self.ramp)  # acceleration of the share [1/s²]
        if t < rise:
            return 0.5 * share * t * t
        if t > total - rise:
            return 1.0 - 0.5 * share * (total - t) ** 2
        return 0.5 * share * rise * rise + share * rise * (t - rise)


def line(start: Pose, goal: Pose, pace: Pace) -> Line:
    """The straight line from `start` to `goal`, at `pace`."""
    distance = float(np.linalg.norm(goal.position - start.position))
    cruise = max(distance / pace.linear, turn(start, goal) / pace.angular, SLOWEST)
    return Line(start, goal, cruise, pace.ramp)


def servo_line(start: Pose, goal: Pose, pace: Pace, period: float) -> Line:
    """One servo step of the session spread evenly over `period` [s], longer where `pace` asks for it."""
    even = line(start, goal, Pace(pace.linear, pace.angular, SLOWEST))
    return Line(start, goal, max(even.cruise, period), SLOWEST)


def waypoints(path: Line, spacing: float) -> list[Pose]:
    """Poses along the line, at most `spacing` [m] and a tenth of a radian apart, the goal last."""
    distance = float(np.linalg.norm(path.goal.position - path.start.position))
    count = max(1, math.ceil(distance / spacing), math.ceil(turn(path.start, path.goal) / 0.1))
    return [between(path.start, path.goal, (k + 1) / count) for k in range(count)]


def between(start: Pose, goal: Pose, fraction: float) -> Pose:
    """The pose at `fraction` of the way, turning evenly about one axis, the short way round."""
    position = start.position + fraction * (goal.position - start.position)
    cosine = float(start.quaternion @ goal.quaternion)
    end = goal.quaternion if cosine >= 0.0 else -goal.quaternion
    half = math.acos(min(abs(cosine), 1.0))
    if half < 1e-6:
        quaternion = (1.0 - fraction) * start.quaternion + fraction * end
    else:
        quaternion = (math.sin((1.0 - fraction) * half) * start.quaternion + math.sin(fraction * half) * end) / math.sin(half)
    return Pose(position, quaternion / np.linalg.norm(quaternion))


def turn(a: Pose, b: Pose) -> float:
    """Angle [rad] between two orientations; `Pose.angle_to` loses small ones to rounding."""
    q, r = a.quaternion, b.quaternion
    vector = r[3] * q[:3] - q[3] * r[:3] + np.cross(q[:3], r[:3])
    return 2.0 * math.atan2(float(np.linalg.norm(vector)), abs(float(q @ r)))
