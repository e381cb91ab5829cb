"""One patient-side manipulator of the dVRK over CRTK topics, as `hardware.interface.Arm`.

The robot checks next to nothing: it takes commands of any age from anybody, clips what it cannot reach, lets 5 cm of error pass, and
goes on for ever where its client dies. What it does not check is checked here, at each look of the monitor and before each command;
as soon as something is wrong, what is under way ends with its code and the arm is told to hold.

The tip moves by setpoints that we stream (`tip`), the jaw by the robot's own motion while the arm stands still (`jaw`): the two share one
mode and are never mixed. Only `servo_cp`, `jaw/move_jp`, `hold`, `state_command` and `trajectory_j/set_ratio` are ever sent. Thread-safe.
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hardware.codes import Code
from hardware.dvrk import messages as m
from hardware.dvrk import preconditions as must
from hardware.dvrk.arm_guard import ArmGuard
from hardware.dvrk.arm_readings import ArmReadings, ArmTopics, pose_of
from hardware.dvrk.calibration import ArmFrames, as_matrix, as_pose, force_to_camera, to_base, to_camera
from hardware.dvrk.config import ArmConfig, RobotConfig
from hardware.dvrk.energy import Energy
from hardware.dvrk.jaw import EnergyTip, Jaw
from hardware.dvrk.moves import Move, refused
from hardware.dvrk.obedience import Part
from hardware.dvrk.reach import unreachable
from hardware.dvrk.streaming import waypoints
from hardware.dvrk.tare import Tare
from hardware.dvrk.telemetry import Sample, TopicFigures
from hardware.dvrk.tip import TipStream
from hardware.dvrk.transport import Publisher, Transport
from hardware.interface import GRASPER, ArmState, Array, OperatingState, Pose, Stamped
from hardware.verdicts import Verdict

log = logging.getLogger(__name__)

COMMANDS = ("enable", "disable", "home", "unhome", "pause", "resume")
CHECKED_EVERY = 3e-3  # [m] along a line, where the arm's limits are asked for
UNSEEN = 0.2  # [s] without a look of the monitor, after which nothing is known to be well
LONGEST_STEP = 0.03  # [s]; a monitor that was late does not make up for it with a long step
OWN_RULE = (Code.MOVE_REJECTED, Code.MOVE_TIMEOUT, Code.MOVE_NOT_REACHED)  # by which a motion fails while nothing else is wrong
UNKNOWN = Pose(np.full(3, np.nan), np.full(4, np.nan))


@dataclass(frozen=True)
class Known:
    """What the monitor saw at its last look, at `at` [s]."""

    readings: ArmReadings
    guard: Verdict
    at: float


class ArmDVRK:
    """Implements `hardware.interface.Arm`; `step` is to be called by the bench's monitor at its rate.

    `role` is its name in the session (`GRASPER`, `CUTTER`), `outside` what stands in the way; until `opened` it sends nothing unasked.
    """

    def __init__(
        self,
        role: str,
        config: RobotConfig,
        arm: ArmConfig,
        frames: ArmFrames,
        transport: Transport,
        now: Callable[[], float],
        outside: Callable[[], Verdict],
        opened: Callable[[], bool],
        energy: Energy,
    ) -> None:
        self._role, self._config, self._arm, self._frames = role, config, arm, frames
        self._transport, self._now, self._opened = transport, now, opened
        self._lock = threading.RLock()
        namespace = config.topic(arm.name)
        epoch = transport.clock() - now()
        self._topics = ArmTopics(transport, namespace, epoch, arm.instrument.has_jaw)
        self._servo = transport.publisher(f"{namespace}/servo_cp", m.PoseStamped)
        self._hold = transport.publisher(f"{namespace}/hold", m.Empty)
        self._command = transport.publisher(f"{namespace}/state_command", m.StringStamped, queue=10)
        self._ratio = transport.publisher(f"{namespace}/trajectory_j/set_ratio", m.Float64)
        turns = transport.publisher(f"{namespace}/jaw/move_jp", m.JointState) if arm.instrument.has_jaw else None
        self._turns = turns
        self._jaw: Jaw | EnergyTip = (
            EnergyTip(arm, energy) if turns is None else Jaw(turns, self._topics, arm, config, role == GRASPER)
        )
        self._tip = TipStream(self._publish, config, arm.name)
        self.tare = Tare(arm.called, config.tolerances.force_at_rest)
        self._waiting: tuple[Callable[[Move], None], Move] | None = None  # of tip or jaw, until the other's motion is over
        self._judge = ArmGuard(config, arm, self._topics, self._tip, self._jaw, self._setpoint, outside)
        self._paused = False
        self._commanded_at = -math.inf
        self._ratio_sent = -math.inf
        unseen = Verdict(False, False, Code.ARM_NOT_READY, "the arm was not looked at yet")
        self._known = Known(self._topics.read(), unseen, -math.inf)

    # ------------------------------------------------------------ interface.Arm

    @property
    def name(self) -> str:
        """The arm's name in the session."""
        return self._role

    def operating_state(self) -> ArmState:
        """The robot's state. Homed is an arm only with its instrument engaged and its pose known; `guard` says what else is wrong."""
        known, now = self._known, self._now()
        state = known.readings.state
        if state is None:
            return ArmState(OperatingState.DISABLED, False, False, -math.inf, f"{self._arm.called} has not told its state")
        message = state.message
        named = message.state in OperatingState.__members__
        value = OperatingState(message.state) if named else OperatingState.DISABLED
        busy = message.is_busy or self._busy_with_ours() or self._waiting is not None or not self._tip.sent.settled
        return ArmState(
            value, message.is_homed and self._judge.engaged, busy, state.received, self._error(known), self._guard(now)
        )

    def state_command(self, command: str) -> None:
        """Send one of enable, disable, home, unhome, pause, resume; any other changes nothing. What enables a paused arm is `resume`."""
        if command in COMMANDS:
            state = self._known.readings.state
            if command == "enable" and state is not None and state.message.state == OperatingState.PAUSED:
                command = "resume"
            self._commanded_at = self._now()
            self._command.publish(m.StringStamped(self._transport.stamp(), command))

    def measured_cp(self) -> Stamped[Pose]:
        """The tool tip by encoders and calibration; unknown (NaN, stamp -inf) before the first good reading."""
        return self._stamped(self._topics.local.sample())

    def setpoint_cp(self) -> Pose:
        """The robot's own setpoint, whoever set it."""
        return self._setpoint().value

    def measured_jaw(self) -> Stamped[float]:
        """Full opening of the jaws [rad]; the last commanded one of an instrument without a jaw."""
        return Stamped(*self._jaw.measured(self._topics.read()))

    def measured_cf(self) -> Stamped[Array]:
        """Force on the tip (3,) [N] by motor currents: an estimate with friction in it, no force sensor. The grasper's is tared."""
        raw = self._raw_force()
        return Stamped(self.tare.corrected(raw.value), raw.stamp)

    def _raw_force(self) -> Stamped[Array]:
        force, local = self._topics.force.sample().good, self._topics.local.sample().good
        if force is None or local is None:
            return Stamped(np.full(3, np.nan), -math.inf)
        return Stamped(force_to_camera(self._frames, pose_of(local.message), force.message.force), force.taken)

    def servo_cp(self, pose: Pose) -> None:
        """Go on to `pose`, a short step away. A pose that the arm would alter is not sent, and keeps the arm from moving for a moment."""
        with self._lock:
            now = self._now()
            reason = self._why_not(now) or unreachable(self._arm, self._frames, self._topics.read(), [pose])
            if self._jaw.moving or self._waiting:
                reason = f"the jaw of {self._arm.called} moves: the arm moves only while its jaw stands still"
            if reason:
                self._judge.refuse(reason, now)
                return
            self.tare.close()
            if not self._tip.moving:
                self._commanded_at = now
            self._tip.servo(pose, self.setpoint_cp(), now)

    def move_cp(self, pose: Pose) -> Move:
        """Go to `pose` along a straight line of the tip, at the configured speed; if the jaw moves, as soon as that is over."""
        if not pose.is_finite():
            return refused("the commanded pose is not finite", Code.NOT_FINITE)
        return self._take_up(lambda move: self._set_out(pose, move), self._jaw)

    def move_jaw(self, angle: float) -> Move:
        """Go to the full jaw opening `angle` [rad]; if the arm moves, as soon as that is over, as both share one mode."""
        if not math.isfinite(angle):
            return refused("the commanded jaw opening is not finite", Code.NOT_FINITE)
        return self._take_up(lambda move: self._turn_jaw(float(angle), move), self._tip)

    def hold(self) -> None:
        """Stay where the arm is told to be now; ends any motion."""
        with self._lock:
            self._stop(Code.MOVE_NOT_REACHED, "the motion was stopped by a hold")

    # ------------------------------------------------------------ for the bench

    def step(self) -> None:
        """Look at everything once, send the next setpoint, and hold where something is wrong."""
        with self._lock:
            now = self._now()
            dt = min(max(now - self._known.at, 0.0), LONGEST_STEP)
            readings = self._topics.read()
            self._keep_ratio(readings, now)
            guard = self._judge.judge(readings, now, self._commanded_at)
            if self._role == GRASPER and guard.ok and self._ready(readings) and not readings.busy:
                self.tare.look(self._raw_force(), self.measured_cp(), self.measured_jaw().value)
                guard = self.tare.verdict()
            self._known = Known(readings, guard, now)
            if guard.code is Code.FOREIGN_MOTION and self._opened():
                self._fend_off(guard)
            if self._busy_with_ours() and (not guard.ok or not self._ready(readings)):
                self._stop(*self._trouble(readings, guard))
                return
            if jaw := self._jaw.step(readings, self._verdict_of(readings, guard), now):
                self._ended(Part.JAW, jaw.code, jaw.message, jaw.swallowed)
            if self._waiting and not self._busy_with_ours():
                (start, move), self._waiting = self._waiting, None
                start(move)
            measured = self.measured_cp()
            if tip := self._tip.step(now, dt, self.setpoint_cp(), measured.value, measured.stamp):
                said = self._topics.said_since(self._commanded_at)
                self._ended(Part.TIP, tip.code, f"{tip.message}: {said}" if said else tip.message)

    def figures(self) -> list[TopicFigures]:
        """How the arm's periodic topics came in."""
        return self._topics.figures()

    def sources(self) -> dict[str, int]:
        """How many nodes publish each of the arm's periodic topics."""
        return self._topics.sources()

    def missing(self) -> list[str]:
        """Topics of the arm that nobody publishes, and commands that nobody hears."""
        namespace = self._config.topic(self._arm.name)
        links: dict[str, Publisher[Any]] = {
            "servo_cp": self._servo,
            "hold": self._hold,
            "state_command": self._command,
            "trajectory_j/set_ratio": self._ratio,
        }
        if self._turns is not None:
            links["jaw/move_jp"] = self._turns
        deaf = [f"{namespace}/{name} (nobody listens)" for name, link in links.items() if link.listeners() == 0]
        return [*self._topics.missing(), *deaf]

    @property
    def driven_by_others(self) -> bool:
        """Whether somebody else was seen to drive the arm."""
        return self._known.guard.code is Code.FOREIGN_MOTION

    @property
    def readings(self) -> ArmReadings:
        """Everything the arm said last."""
        return self._topics.read()

    @property
    def config(self) -> ArmConfig:
        """What is expected of the arm."""
        return self._arm

    # ------------------------------------------------------------ what is wrong

    def _guard(self, now: float) -> Verdict:
        """The last look's verdict, if somebody still looks."""
        if now - self._known.at > UNSEEN:
            return Verdict(False, False, Code.ARM_DATA_STALE, "the driver's monitor does not look at the arm any more")
        return self._known.guard

    def _keep_ratio(self, readings: ArmReadings, now: float) -> None:
        """Ask for the configured ratio, once a second until the robot says so; not before a session begins."""
        wanted = self._config.speeds.ratio
        faster = readings.ratio is None or readings.ratio > wanted + must.RATIO_ROUNDING
        if faster and self._opened() and now - self._ratio_sent > 1.0:
            self._ratio_sent = now
            self._ratio.publish(m.Float64(wanted))

    def _ready(self, readings: ArmReadings) -> bool:
        state = readings.state
        return state is not None and state.message.state == OperatingState.ENABLED and self._judge.engaged

    def _trouble(self, readings: ArmReadings, guard: Verdict) -> tuple[Code, str]:
        """Code and sentence of what ends a motion."""
        state = "UNKNOWN" if readings.state is None else readings.state.message.state
        if not guard.ok and state != OperatingState.FAULT:
            return guard.code, f"{self._arm.called}: {guard.message}"
        said = self._topics.said_since(self._commanded_at)
        code = Code.ARM_FAULT if state == OperatingState.FAULT else Code.ARM_NOT_READY
        return code, f"{self._arm.called} is {state.lower()}" + (f": {said}" if said else "")

    def _verdict_of(self, readings: ArmReadings, guard: Verdict) -> Verdict:
        if guard.ok and self._ready(readings):
            return guard
        return Verdict(False, False, *self._trouble(readings, guard))

    def _error(self, known: Known) -> str:
        """The robot's own last error; why the arm does not count as homed although it says so."""
        state = known.readings.state
        if state is not None and state.message.state == OperatingState.FAULT:
            newest = self._topics.error.newest()
            return "" if newest is None else newest.message.data
        if state is not None and state.message.is_homed and not self._judge.engaged:
            data = must.data_fresh(known.readings, self._now(), self._config.rates, self._arm.instrument.has_jaw)
            return must.worst([must.tool_as_configured(known.readings, self._arm), data]).message
        return ""

    def _why_not(self, now: float) -> str:
        """Why no motion may begin now; "" when one may."""
        guard = self._guard(now)
        if not guard.ok:
            return f"{self._arm.called}: {guard.message}"
        if not self._ready(self._topics.read()):
            return f"{self._arm.called} is not enabled, homed and engaged"
        return ""

    # ------------------------------------------------------------ sending

    def _busy_with_ours(self) -> bool:
        return self._tip.moving or self._jaw.moving

    def _take_up(self, start: Callable[[Move], None], other: Jaw | EnergyTip | TipStream) -> Move:
        """Start a motion, now or once the `other` part of the arm stands still."""
        with self._lock:
            if reason := self._why_not(self._now()):
                return refused(reason)
            self.tare.close()
            self._forget_waiting(Code.MOVE_NOT_REACHED, "another command took this motion's place")
            move = Move()
            if other.moving:
                self._waiting = (start, move)
            else:
                start(move)
            return move

    def _turn_jaw(self, angle: float, move: Move) -> None:
        self._commanded_at = self._now()
        self._jaw.move(angle, self._topics.read(), self._transport.stamp(), self._commanded_at, move)

    def _set_out(self, pose: Pose, move: Move) -> None:
        """Begin a line from where the arm is told to be now, if all of it can be reached."""
        now = self._now()
        path = self._tip.plan(self._tip.start(self.setpoint_cp()), pose)
        if reason := unreachable(self._arm, self._frames, self._topics.read(), waypoints(path, CHECKED_EVERY)):
            move.end(Code.MOVE_REJECTED, reason)
            return
        self._commanded_at = now
        self._tip.begin(path, now, move)

    def _forget_waiting(self, code: Code, message: str) -> None:
        if self._waiting:
            self._waiting[1].end(code, message)
            self._waiting = None

    def _publish(self, pose: Pose) -> None:
        """One setpoint, in the arm's reference frame: the robot reads goals in it, whatever the header says."""
        base = self._known.readings.base
        if base is None:
            return
        goal = as_pose(base @ as_matrix(to_base(self._frames, pose)))
        self._servo.publish(m.PoseStamped(self._transport.stamp(), self._arm.frame_id, goal.position, goal.quaternion))

    def _ended(self, part: Part, code: Code, message: str, swallowed: bool = False) -> None:
        """A motion came to its end. One that failed by its own rule is a hold, and stands in the way until the arm was quiet."""
        if code is Code.OK:
            self._judge.obedience.obeyed(part)
            return
        self._stop(code, message)
        if code in OWN_RULE:
            self._judge.obedience.failed(part, code, message, swallowed)
            self._known = replace(self._known, guard=Verdict(False, False, code, message))  # until the next look

    def _fend_off(self, guard: Verdict) -> None:
        """Somebody else drives the arm. A hold does not keep it from the next command of theirs; a paused arm takes none (6.1)."""
        if self._paused:
            return
        self._paused = True
        self._stop(guard.code, guard.message)
        self._command.publish(m.StringStamped(self._transport.stamp(), "pause"))

    def _stop(self, code: Code, message: str) -> None:
        """Hold first, tell after."""
        try:
            self._hold.publish(m.Empty())
        finally:
            self._tip.stop(code, message)
            self._jaw.stop(code, message)
            self._forget_waiting(code, message)
            self._commanded_at = self._now()

    def _setpoint(self) -> Stamped[Pose]:
        return self._stamped(self._topics.setpoint.sample())

    def _stamped(self, sample: Sample[m.PoseStamped]) -> Stamped[Pose]:
        if sample.good is None:
            return Stamped(UNKNOWN, -math.inf)
        return Stamped(to_camera(self._frames, pose_of(sample.good.message)), sample.good.taken)
