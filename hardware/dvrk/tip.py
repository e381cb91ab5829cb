"""The tip of one arm on its way: setpoints streamed along straight lines, watched until the arm has followed them.

Servoing makes no arm busy and no `goal_reached`, so a streamed motion has a rule of its own, as strict as that for the robot's motions: the
robot's setpoint must follow what is sent, measured must follow the setpoint, and at the end both must be near the goal for some samples
in a row. Poses are the tool's, in the left camera frame. Not thread-safe: the arm calls it under its lock.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hardware.codes import Code
from hardware.dvrk.config import RobotConfig
from hardware.dvrk.moves import Move
from hardware.dvrk.preconditions import distance_to_path
from hardware.dvrk.streaming import Line, Pace, line, servo_line
from hardware.interface import Pose
from hardware.verdicts import Refusal

SESSION_STEP = 1.0 / 30.0  # [s] between two servo commands of the session; each is spread over this
SERVO_PACE = Pace(0.05, 1.5)  # at most, for those that come further apart than they should
KEPT = 0.6  # [s] of what was sent that the setpoint may still be at
HOLD_WITHIN = 0.3  # [s] after a hold, in which the setpoint comes to rest somewhere on the way that was sent
SETTLE_WITHIN = 1.0  # [s] after the last setpoint


@dataclass
class Run:
    """A line that is being streamed; `move` is None for a servo step of the session."""

    line: Line
    move: Move | None
    elapsed: float = 0.0
    near: int = 0
    counted: float = -math.inf


class TipStream:
    """Streams one line at a time through `publish`; what it sent in the last moments tells foreign motion from ours."""

    def __init__(self, publish: Callable[[Pose], None], config: RobotConfig, name: str) -> None:
        self._publish, self._config, self._name = publish, config, name
        self._pace = Pace(config.speeds.linear, config.speeds.angular)
        self._run: Run | None = None
        self._sent: deque[tuple[float, Pose]] = deque()
        self._anchor_at = -math.inf
        self._stood: Pose | None = None  # what had been sent when the arm was last known to move
        self._away_at = math.inf

    @property
    def moving(self) -> bool:
        """Whether a line is being streamed or settles."""
        return self._run is not None

    def plan(self, start: Pose, goal: Pose) -> Line:
        """The line of a motion to `goal`."""
        return line(start, goal, self._pace)

    def begin(self, path: Line, now: float, move: Move) -> None:
        """Set out along `path`; `move` is told how it ends."""
        self.stop(Code.MOVE_NOT_REACHED, "another command took this motion's place")
        self._run = Run(path, move)
        self._leave(path.start, now)

    def servo(self, goal: Pose, setpoint: Pose, now: float) -> None:
        """Go on to `goal`, a short step away, from what was sent last."""
        start = self._run.line.at(self._run.elapsed) if self._run else setpoint
        if self._run and self._run.move:
            self._run.move.end(Code.MOVE_NOT_REACHED, "another command took this motion's place")
        if not self._run:
            self._leave(start, now)
        self._run = Run(servo_line(start, goal, SERVO_PACE, SESSION_STEP), None)

    def start(self, setpoint: Pose) -> Pose:
        """Where the next motion begins: where the one going on is, or the robot's `setpoint`."""
        return self._run.line.at(self._run.elapsed) if self._run else setpoint

    def stop(self, code: Code, message: str) -> None:
        """Send no more."""
        if self._run and self._run.move:
            self._run.move.end(code, message)
        self._run = None

    def held(self, now: float) -> None:
        """A hold was sent: the setpoint stays on the way, and from `HOLD_WITHIN` on where it then is."""
        self._anchor_at = now + HOLD_WITHIN

    def forget(self) -> None:
        """Where the setpoint should be is not known: the arm was not ours for a while."""
        self._sent.clear()
        self._anchor_at = -math.inf
        self._stood, self._away_at = None, math.inf

    def sent_away(self, moved: float) -> float:
        """When [s] the arm, which moved at `moved` [s] last, was first sent anywhere else since; inf while it is to stand still."""
        if self._away_at <= moved:
            self._stood, self._away_at = (self._sent[-1][1] if self._sent else None), math.inf
        return self._away_at

    def ours(self, setpoint: Pose | None, now: float) -> list[Pose]:
        """Where the setpoint may be by what we sent; empty while that is not known."""
        if self._run is None and now >= self._anchor_at and setpoint is not None:
            known = [pose for _, pose in self._sent]
            self._anchor_at = math.inf
            if not known or distance_to_path(setpoint.position, np.array([pose.position for pose in known])) <= self._foreign:
                self._sent.clear()
                self._sent.append((now, setpoint))
        while len(self._sent) > 1 and self._sent[0][0] < now - KEPT and self._anchor_at == math.inf:
            self._sent.popleft()
        return [pose for _, pose in self._sent]

    def step(self, now: float, dt: float, setpoint: Pose, measured: Pose, stamp: float) -> Refusal | None:
        """Go on by `dt` [s]; gives why the motion failed, if it did. The arm is then to be told to hold."""
        run = self._run
        if run is None:
            return None
        if self._ignored(now, setpoint):
            within = self._config.rates.busy_within
            return Refusal(Code.MOVE_REJECTED, f"{self._name} has not followed its commands for {within:.1f} s")
        if run.elapsed < run.line.duration:
            run.elapsed += dt
            pose = run.line.at(run.elapsed)
            self._sent.append((now, pose))
            self._publish(pose)
            if self._away_at == math.inf and self._stood is not None and self._differs(pose, self._stood):
                self._away_at = now
            return None
        return self._settle(run, setpoint, measured, stamp, dt)

    # ------------------------------------------------------------ inside

    @property
    def _foreign(self) -> float:
        return self._config.tolerances.foreign

    def _leave(self, start: Pose, now: float) -> None:
        self._anchor_at = math.inf
        self._sent.append((now, start))
        if self._away_at == math.inf:
            self._stood = start

    def _differs(self, a: Pose, b: Pose) -> bool:
        return _off(a, b) > self._foreign or a.angle_to(b) > self._config.tolerances.rotation

    def _ignored(self, now: float, setpoint: Pose) -> bool:
        """Whether the setpoint is still at what was sent too long ago."""
        if float(np.linalg.norm(self._sent[-1][1].position - setpoint.position)) <= self._foreign:
            return False
        away = np.linalg.norm(np.array([pose.position for _, pose in self._sent]) - setpoint.position, axis=1)
        return now - self._sent[int(np.argmin(away))][0] > self._config.rates.busy_within

    def _settle(self, run: Run, setpoint: Pose, measured: Pose, stamp: float, dt: float) -> Refusal | None:
        """All is sent: a servo step is over; a motion waits for the arm."""
        run.elapsed += dt
        if run.move is None:
            self._run = None
            return None
        tolerances, goal = self._config.tolerances, run.line.goal
        followed = _off(setpoint, goal) <= tolerances.foreign and setpoint.angle_to(goal) <= tolerances.rotation
        if stamp > run.counted:
            near = _off(measured, goal) <= tolerances.position and measured.angle_to(goal) <= tolerances.rotation
            run.near, run.counted = (run.near + 1 if near and followed else 0), stamp
        if run.near >= tolerances.samples:
            run.move.end(Code.OK)
            self._run = None
            return None
        if run.elapsed <= run.line.duration + SETTLE_WITHIN:
            return None
        what = (
            f"its setpoint stayed {_off(setpoint, goal) * 1e3:.1f} mm" if not followed else f"{_off(measured, goal) * 1e3:.1f} mm"
        )
        return Refusal(Code.MOVE_NOT_REACHED, f"{self._name} came to rest, but {what} from its goal")


def _off(a: Pose, b: Pose) -> float:
    return float(np.linalg.norm(a.position - b.position))
