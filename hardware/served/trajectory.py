"""Joint trajectories as the dVRK makes them: synchronised, limited in speed and acceleration, at rest at the end, and pre-emptive.

Each joint speeds up at its full acceleration, cruises, and slows down; the slowest one sets the time for all, and the others
cruise slower to arrive with it. A new goal is approached from the position and velocity at that instant.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hardware.interface import Array

# At ratio 1, of yaw, pitch, insertion, roll, wrist pitch, wrist yaw and jaw: reference/dvrk.md section 5
SPEED = np.array([math.pi / 2, math.pi / 2, 0.2, 6 * math.pi, 6 * math.pi, 6 * math.pi, 6 * math.pi])  # [rad/s, m/s]
ACCELERATION = np.array([math.pi / 2, math.pi / 2, 0.2, 4 * math.pi, 4 * math.pi, 4 * math.pi, 4 * math.pi])  # [rad/s², m/s²]
HALVINGS = 60


@dataclass(frozen=True)
class Profile:
    """One joint's way: from `start` at `speed` to `cruise` speed, on, and to rest, at `acceleration`, each phase for some time [s]."""

    start: float
    speed: float
    cruise: float
    acceleration: float
    change: float
    coast: float
    brake: float

    @property
    def duration(self) -> float:
        """How long it takes [s]."""
        return self.change + self.coast + self.brake

    def at(self, time: float) -> tuple[float, float]:
        """Position and velocity `time` [s] after the start; at rest from the end on."""
        t = min(max(time, 0.0), self.change)
        rate = math.copysign(self.acceleration, self.cruise - self.speed)
        position, velocity = self.start + self.speed * t + 0.5 * rate * t * t, self.speed + rate * t
        t = min(max(time - self.change, 0.0), self.coast)
        position += self.cruise * t
        t = min(max(time - self.change - self.coast, 0.0), self.brake)
        rate = -math.copysign(self.acceleration, self.cruise)
        position += self.cruise * t + 0.5 * rate * t * t
        if time > self.change:
            velocity = self.cruise + rate * t
        return position, velocity


@dataclass(frozen=True)
class Trajectory:
    """A synchronised motion of all joints to `goal` (7,) that takes `duration` [s]."""

    profiles: tuple[Profile, ...]
    goal: Array
    duration: float

    def at(self, time: float) -> tuple[Array, Array]:
        """Positions and velocities (7,) `time` [s] after the start; exactly the goal, at rest, from the end on."""
        if time >= self.duration:
            return self.goal.copy(), np.zeros(len(self.goal))
        states = [profile.at(time) for profile in self.profiles]
        return np.array([state[0] for state in states]), np.array([state[1] for state in states])


def plan(start: Array, velocity: Array, goal: Array, speed: Array, acceleration: Array) -> Trajectory:
    """The trajectory (n,) joints from `start` at `velocity` to rest at `goal`, within `speed` and `acceleration`."""
    rows = [tuple(map(float, row)) for row in zip(start, velocity, goal, speed, acceleration, strict=True)]
    fastest = [_fastest(*row) for row in rows]
    duration = max(profile.duration for profile in fastest)
    profiles = tuple(_stretched(profile, row[2], duration) for profile, row in zip(fastest, rows, strict=True))
    return Trajectory(profiles, np.array(goal, dtype=np.float64), duration)


def _fastest(start: float, velocity: float, goal: float, speed: float, acceleration: float) -> Profile:
    """The joint's own fastest way."""
    way = goal - start
    sign = math.copysign(1.0, way - velocity * abs(velocity) / (2.0 * acceleration))  # which way once it could have stopped
    peak = math.sqrt(max(acceleration * sign * way + 0.5 * velocity * velocity, 0.0))
    return _profile(start, velocity, goal, sign * min(peak, speed), acceleration)


def _profile(start: float, velocity: float, goal: float, cruise: float, acceleration: float) -> Profile:
    change, brake = abs(cruise - velocity) / acceleration, abs(cruise) / acceleration
    rest = goal - start - 0.5 * (velocity + cruise) * change - 0.5 * cruise * brake
    coast = max(rest / cruise, 0.0) if abs(cruise) > 1e-12 else 0.0
    return Profile(start, velocity, cruise, acceleration, change, coast, brake)


def _stretched(fastest: Profile, goal: float, duration: float) -> Profile:
    """The same way in `duration` [s], by cruising slower; time falls as the cruising speed rises, so halving finds it."""
    if duration - fastest.duration < 1e-9 or abs(fastest.cruise) < 1e-12:
        return fastest
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        share = 0.5 * (low + high)
        profile = _profile(fastest.start, fastest.speed, goal, share * fastest.cruise, fastest.acceleration)
        low, high = (low, share) if profile.duration < duration else (share, high)
    return _profile(fastest.start, fastest.speed, goal, high * fastest.cruise, fastest.acceleration)
