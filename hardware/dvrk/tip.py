"""The tip of one arm on its way: setpoints streamed along straight lines, watched until the arm has followed them.

Servoing makes no arm busy and no `goal_reached`, so a streamed motion has a rule of its own, as strict as that for the robot's motions: the
robot's setpoint must follow what is sent, measured must follow the setpoint, and at the end both must be near the goal for some samples
in a row. Poses are the tool's, in the left camera frame. Not thread-safe: the arm calls it under its lock.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hardware.codes import Code
from hardware.dvrk.config import RobotConfig
from hardware.dvrk.moves import Move
from hardware.dvrk.setpoints import Setpoints
from hardware.dvrk.streaming import Line, Pace, line, servo_line
from hardware.interface import Pose
from hardware.verdicts import Refusal

SESSION_STEP = 1.0 / 30.0  # [s] between two servo commands of the session; each is spread over this
SERVO_PACE = Pace(0.05, 1.5)  # at most, for those that come further apart than they should
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
    """Streams one line at a time through `publish`; `sent` knows what went out."""

    def __init__(self, publish: Callable[[Pose], None], config: RobotConfig, name: str) -> None:
        self._publish, self._config, self._name = publish, config, name
        self._pace = Pace(config.speeds.linear, config.speeds.angular)
        self._run: Run | None = None
        self.sent = Setpoints(config.tolerances)
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
        start = self.start(setpoint)
        if self._run and self._run.move:
            self._run.move.end(Code.MOVE_NOT_REACHED, "another command took this motion's place")
        if not self._run:
            self._leave(start, now)
        self._run = Run(servo_line(start, goal, SERVO_PACE, SESSION_STEP), None)

    def start(self, setpoint: Pose) -> Pose:
        """Where the next motion begins: where the one going on is, what was sent last and is still under way, or the robot's `setpoint`."""
        if self._run:
            return self._run.line.at(self._run.elapsed)
        return setpoint if self.sent.settled or self.sent.last is None else self.sent.last

    def stop(self, code: Code, message: str) -> None:
        """Send no more."""
        if self._run and self._run.move:
            self._run.move.end(code, message)
        self._run = None
        self.sent.rest()

    def forget(self) -> None:
        """Where the setpoint should be is not known: the arm was not ours for a while."""
        self.sent.forget()
        self._stood, self._away_at = None, math.inf

    def sent_away(self, moved: float) -> float:
        """When [s] the arm, which moved at `moved` [s] last, was first sent anywhere else since; inf while it is to stand still."""
        if self._away_at <= moved:
            self._stood, self._away_at = self.sent.last, math.inf
        return self._away_at

    def step(self, now: float, dt: float, setpoint: Pose, measured: Pose, stamp: float) -> Refusal | None:
        """Go on by `dt` [s]; gives how a motion ended. Where it failed, the arm is to be told to hold."""
        run = self._run
        if run is None:
            return None
        if run.elapsed < run.line.duration:
            run.elapsed += dt
            pose = run.line.at(run.elapsed)
            self.sent.send(now, pose)
            self._publish(pose)
            if self._away_at == math.inf and self._stood is not None and self._differs(pose, self._stood):
                self._away_at = now
            return None
        return self._settle(run, setpoint, measured, stamp, dt)

    # ------------------------------------------------------------ inside

    def _leave(self, start: Pose, now: float) -> None:
        self.sent.send(now, start)
        if self._away_at == math.inf:
            self._stood = start

    def _differs(self, a: Pose, b: Pose) -> bool:
        return _off(a, b) > self._config.tolerances.foreign or a.angle_to(b) > self._config.tolerances.rotation

    def _settle(self, run: Run, setpoint: Pose, measured: Pose, stamp: float, dt: float) -> Refusal | None:
        """All is sent: a servo step is over; a motion waits for the arm."""
        run.elapsed += dt
        self.sent.rest()
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
            return Refusal(Code.OK, "")
        if run.elapsed <= run.line.duration + SETTLE_WITHIN:
            return None
        what = (
            f"its setpoint stayed {_off(setpoint, goal) * 1e3:.1f} mm" if not followed else f"{_off(measured, goal) * 1e3:.1f} mm"
        )
        return Refusal(Code.MOVE_NOT_REACHED, f"{self._name} came to rest, but {what} from its goal")


def _off(a: Pose, b: Pose) -> float:
    return float(np.linalg.norm(a.position - b.position))
