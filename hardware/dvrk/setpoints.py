"""What was sent to one arm, held against the setpoint that it tells: whether it obeys, and whether somebody else drives it.

A robot takes a streamed setpoint as it comes, without interpolation, and keeps the last one. So its setpoint is always on the way that was
sent, never far behind, and comes to rest at its end. Behind is a robot that does not obey; beside the way is one that somebody else
drives, or that altered what it got. Poses are the tool's, in the left camera frame. Not thread-safe: the arm calls it under its lock.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from hardware.codes import Code
from hardware.dvrk.config import ToleranceConfig
from hardware.dvrk.preconditions import FINE, distance_to_path
from hardware.interface import Pose
from hardware.verdicts import Verdict

FOLLOWS_WITHIN = 0.1  # [s] after it was sent, in which a setpoint is the robot's
RESTS_WITHIN = 0.3  # [s] after the last one was sent, likewise; what is under way has then arrived
KEPT = 0.3  # [s] of the way that the setpoint may still be on
# Shares of the tolerance of foreign motion: on the way, at rest where nothing moves the setpoint at all, and for how long what it takes
# to tell a stranger whose commands ours take the place of at once.
MOVING, RESTING, SLIGHT = 0.5, 0.2, 0.04
SLIGHTLY = 5  # readings in a row
LEVER = 0.01  # [m], by which a turn counts as a shift
ROUNDING = 1e-9  # [m]


class Setpoints:
    """`sent` and `rest` tell what goes out, `judge` what came of it."""

    def __init__(self, tolerances: ToleranceConfig) -> None:
        self._tolerances = tolerances
        self._sent: deque[tuple[float, Pose]] = deque()
        self._moving = False
        self._settled = True
        self._looked = -math.inf  # stamp of the reading that was judged last
        self._off = 0

    @property
    def settled(self) -> bool:
        """Whether the setpoint was seen at the end of what was sent, or nothing was sent that is known of."""
        return self._settled

    @property
    def last(self) -> Pose | None:
        """Where the arm is to be; None while that is not known."""
        return self._sent[-1][1] if self._sent else None

    def send(self, now: float, pose: Pose) -> None:
        """`pose` goes out at `now` [s], or is where a way begins."""
        self._sent.append((now, pose))
        self._moving, self._settled = True, False

    def rest(self) -> None:
        """Nothing more will be sent on this way."""
        self._moving = False

    def forget(self) -> None:
        """Where the setpoint should be is not known: the arm was not ours for a while."""
        self._sent.clear()
        self._moving, self._settled, self._off = False, True, 0

    def judge(self, setpoint: Pose, taken: float, jitter: float) -> Verdict:
        """Whether the `setpoint`, as it was at `taken` [s], is what was sent; the frame that it was sent in trembles by `jitter` [m].

        What is not settled yet is no refusal; `settled` says so.
        """
        if not self._sent:
            self._sent.append((taken, setpoint))
            return FINE
        positions = np.array([pose.position for _, pose in self._sent])
        turns = 2.0 * np.arccos(
            np.clip(np.abs(np.array([pose.quaternion for _, pose in self._sent]) @ setpoint.quaternion), 0.0, 1.0)
        )
        if foreign := self._foreign(distance_to_path(setpoint.position, positions), float(turns.min()), taken, jitter):
            return foreign
        away = np.linalg.norm(positions - setpoint.position, axis=1) + LEVER * turns
        here = max(self._slight + 2.0 * jitter, float(away.min()) + ROUNDING)
        reached = int(np.flatnonzero(away <= here)[-1])
        if not self._moving and reached == len(away) - 1:
            self._settle(taken, self._sent[-1][1])
            return FINE
        late = taken - self._sent[-1][0] > RESTS_WITHIN
        if not self._moving and away[-1] <= self._still + 2.0 * jitter:
            if late:  # the last ones were lost, as by a hold that overtook them: it rests where it is
                self._settle(taken, setpoint)
            return FINE
        if not self._moving and late:
            said = f"it does not do what it is told: its setpoint stays {away[-1] * 1e3:.2f} mm from where it was sent"
            return Verdict(False, True, Code.NOT_OBEYED, said)
        ahead = np.flatnonzero(away[reached + 1 :] > here)
        if len(ahead) and taken - self._sent[reached + 1 + int(ahead[0])][0] > FOLLOWS_WITHIN:
            said = f"it has not followed its commands for {FOLLOWS_WITHIN * 1e3:.0f} ms"
            return Verdict(False, False, Code.MOVE_REJECTED, said)
        while len(self._sent) > 1 and self._sent[0][0] < taken - KEPT:
            self._sent.popleft()
        return FINE

    # ------------------------------------------------------------ inside

    @property
    def _slight(self) -> float:
        return SLIGHT * self._tolerances.foreign

    @property
    def _still(self) -> float:
        return RESTING * self._tolerances.foreign

    def _settle(self, taken: float, at: Pose) -> None:
        self._sent.clear()
        self._sent.append((taken, at))
        self._settled = True

    def _foreign(self, away: float, turned: float, taken: float, jitter: float) -> Verdict | None:
        """Beside the way, by `away` [m] or `turned` [rad]: at once by much, or by little for some readings in a row."""
        if taken > self._looked:
            self._looked = taken
            self._off = self._off + 1 if away > self._slight + 2.0 * jitter else 0
        limit = self._still if self._settled else MOVING * self._tolerances.foreign
        if away <= limit + 2.0 * jitter and turned <= self._tolerances.rotation and self._off < SLIGHTLY:
            return None
        return Verdict(
            False,
            True,
            Code.FOREIGN_MOTION,
            f"the setpoint is {away * 1e3:.2f} mm and {math.degrees(turned):.1f} degrees from where it was sent: "
            "somebody else drives the arm, or it altered what we sent",
        )
