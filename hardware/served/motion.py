"""The seven setpoints of one arm, six joints and the jaw, and the one control mode that they share.

That they share it is the source of two traps (reference 7.6 and 7.7): a servo command ends a jaw's trajectory and the other way round;
and a trajectory of the arm takes the jaw along to the last goal that a trajectory of the jaw had, however long ago.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from hardware.dvrk.instruments import Instrument
from hardware.interface import Array
from hardware.served.plant import FOLLOWS
from hardware.served.trajectory import ACCELERATION, SPEED, Trajectory, plan

JAW = 6  # index of the jaw among the seven
BEFORE_CLOSING = 1e-9


class Mode(StrEnum):
    """Who decides the setpoints."""

    POSITION = "position"  # the last servo command
    TRAJECTORY = "trajectory"  # a trajectory to the last goal
    EFFORT = "effort"  # nobody: the arm is limp


class JointMotion:
    """Setpoint, velocity and goal are (7,) [rad, m]. `moving` is whether a trajectory is under way."""

    def __init__(self, instrument: Instrument, joints: Array, jaw: float) -> None:
        self.mode = Mode.POSITION
        self.ratio_v = self.ratio_a = 1.0
        self.setpoint = np.append(joints, jaw)
        self.velocity = np.zeros(7)
        self.goal = self.setpoint.copy()
        self.stuck = False  # a goal was taken without a trajectory to it: busy until something else is commanded
        self._trajectory: Trajectory | None = None
        self._elapsed = 0.0
        self.set_instrument(instrument)

    @property
    def moving(self) -> bool:
        """Whether the arm is busy with a goal."""
        return self._trajectory is not None or self.stuck

    def set_instrument(self, instrument: Instrument) -> None:
        """Take another instrument's limits."""
        self._lower = np.append(instrument.lower, instrument.jaw_lower)
        self._upper = np.append(instrument.upper, instrument.jaw_upper)

    def stay(self, mode: Mode = Mode.POSITION) -> bool:
        """Stop at the setpoint; gives whether that ended a motion."""
        ended = self.moving
        self._trajectory, self.stuck, self.mode = None, False, mode
        self.velocity = np.zeros(7)
        return ended

    def put(self, joints: Array, jaw: float) -> None:
        """The arm was moved without a command: its setpoint is where it stands now."""
        self.setpoint = np.append(joints, jaw)

    def servo(self, joints: Array) -> bool:
        """Make `joints` (6,) the setpoint at once, clipped without a word. The jaw stays where its own setpoint is now."""
        ended = self.stay()
        self.setpoint[:JAW] = np.clip(joints, self._lower[:JAW], self._upper[:JAW])
        return ended

    def servo_jaw(self, angle: float) -> bool:
        """Make `angle` [rad] the jaw's setpoint at once; nobody clips it (reference 7.7)."""
        ended = self.stay()
        self.setpoint[JAW] = angle
        return ended

    def move(self, joints: Array) -> bool:
        """Set out to `joints` (6,); the jaw goes along to its last goal. Gives whether another motion was ended before its goal."""
        self.goal[:JAW] = np.clip(joints, self._lower[:JAW], self._upper[:JAW])
        return self._set_out()

    def move_jaw(self, angle: float) -> bool:
        """Set out to the jaw's `angle` [rad]; the arm stays, or goes on to the goal of its own trajectory."""
        if self.mode is not Mode.TRAJECTORY or self._trajectory is None:
            self.goal[:JAW] = self.setpoint[:JAW]
        self.goal[JAW] = np.clip(angle, self._lower[JAW], self._upper[JAW])
        return self._set_out()

    def take_goal(self, joints: Array) -> None:
        """A goal for a mode that could not be entered: in a trajectory it counts, else it only makes the arm busy (reference 5)."""
        if self.mode is Mode.TRAJECTORY:
            self.move(joints)
        else:
            self.goal[:JAW] = np.clip(joints, self._lower[:JAW], self._upper[:JAW])
            self.stuck = True

    def step(self, dt: float) -> bool:
        """Go on by `dt` [s]; gives whether the goal was reached in this step."""
        if self._trajectory is None:
            return False
        self._elapsed += dt
        self.setpoint, self.velocity = self._trajectory.at(self._elapsed)
        if self._elapsed < self._trajectory.duration - BEFORE_CLOSING:
            return False
        self.setpoint, self._trajectory = self._trajectory.goal.copy(), None
        self.velocity = np.zeros(7)
        return True

    def _set_out(self) -> bool:
        ended, self.stuck = self.moving, False
        if self.mode is not Mode.TRAJECTORY:
            self.mode, self.velocity = Mode.TRAJECTORY, np.zeros(7)
        speed = np.minimum(self.ratio_v * SPEED, FOLLOWS)
        self._trajectory = plan(self.setpoint, self.velocity, self.goal, speed, self.ratio_a * ACCELERATION)
        self._elapsed = 0.0
        return ended
