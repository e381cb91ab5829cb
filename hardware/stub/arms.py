"""A simulated patient-side manipulator: CRTK's state machine, rate-limited motion, latency, and the errors of real arms.

Three poses differ, as on a robot. The setpoint is what the controller aims at; the encoders follow it at limited speed and are
what is measured; the tip, which tissue and camera see, lags the encoders by backlash and is off by the calibration's bias.
Commands take effect after the latency, except `hold`, which a deadman beside the robot executes at once. Not thread-safe.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from hardware.codes import Code, InputError
from hardware.interface import ArmState, Array, MoveReport, MoveStatus, OperatingState, Pose, Stamped

FAULTS = ("fault", "power_off", "stale", "freeze")
RUNNING = MoveReport(MoveStatus.RUNNING)
BEGIN_WITHIN = 0.5  # [s] after the latency; a motion that has not begun by then was dropped
FRESH_WITHIN = 0.1  # [s]; older measurements prove no arrival
INSTANT = 1e-9  # [s]


@dataclass(frozen=True)
class ArmConfig:
    """Speeds and imperfections of one arm. Bias and noise are in the left camera frame; noise is a standard deviation.

    Raises:
        InputError: a value is not finite, or out of range.
    """

    free_speed: float = 0.05  # [m/s]
    turn_speed: float = 1.5  # [rad/s]
    jaw_speed: float = 2.0  # [rad/s]
    latency: float = 0.05  # [s]
    bias: tuple[float, ...] = (0.0, 0.0, 0.0)  # [m], tip minus encoders: what calibration left
    bias_rotation: tuple[float, ...] = (0.0, 0.0, 0.0)  # [rad], rotation vector, likewise
    backlash: float = 0.2e-3  # [m], play per axis when the direction reverses
    encoder_noise: float = 5e-6  # [m]
    jaw_noise: float = 1e-3  # [rad]
    force_noise: float = 0.05  # [N]
    position_tolerance: float = 0.3e-3  # [m], of a finished motion, on measured
    turn_tolerance: float = 0.02  # [rad]
    jaw_tolerance: float = 0.02  # [rad]
    homing_time: float = 0.5  # [s]
    start_jaw: float = 0.7  # [rad], full opening at start-up

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, tuple):
                if len(value) != 3 or not all(map(math.isfinite, value)):
                    raise InputError(f"arm setting {item.name} is {value}; it must be three finite numbers")
            elif not (math.isfinite(value) and value >= 0 and (value > 0 or not item.name.endswith("speed"))):
                raise InputError(f"arm setting {item.name} is {value}; it must be finite and not negative, speeds above 0")


class StubMove:
    """One commanded motion; the arm writes its report as it goes."""

    def __init__(self, goal: Pose | float, begin_by: float, deadline: float) -> None:
        self.goal, self.begin_by, self.deadline = goal, begin_by, deadline
        self.began = False
        self._report = RUNNING

    def report(self) -> MoveReport:
        """Give the state of this motion now."""
        return self._report

    def end(self, code: Code, message: str = "") -> None:
        """Settle the report, once."""
        if self._report is RUNNING:
            self._report = MoveReport(MoveStatus.DONE if code is Code.OK else MoveStatus.FAILED, code, message)


class StubArm:
    """Implements `hardware.interface.Arm`. The bench calls `step` in each physics step, before its clock moves on."""

    def __init__(self, name: str, config: ArmConfig, rng: np.random.Generator, home: Pose, clock: Callable[[], float]) -> None:
        self._name, self._config, self._rng, self._clock = name, config, rng, clock
        self._state, self._homed, self._error = OperatingState.DISABLED, False, ""
        self._homing_until: float | None = None
        self._faults: set[str] = set()
        self._setpoint = self._encoders = home
        self._tip = np.array(home.position, dtype=np.float64)
        self._jaw = self._jaw_setpoint = config.start_jaw
        self._bias = np.array(config.bias)
        self._bias_turn = _turn(np.array(config.bias_rotation))
        self._cp_move: StubMove | None = None
        self._jaw_move: StubMove | None = None
        self._queue: deque[tuple[float, Callable[[], None]]] = deque()
        self._waiting: list[StubMove] = []
        self._measure(clock(), np.zeros(3))

    # ------------------------------------------------------------ interface.Arm

    @property
    def name(self) -> str:
        """The arm's name."""
        return self._name

    def operating_state(self) -> ArmState:
        """Give the state now; busy while homing or moving, which says nothing about success."""
        moving = self._cp_move is not None and self._encoders is not self._cp_move.goal
        turning = self._jaw_move is not None and self._jaw != self._jaw_move.goal
        busy = moving or turning or self._homing_until is not None
        return ArmState(self._state, self._homed, busy, self._clock(), self._error)

    def state_command(self, command: str) -> None:
        """Obey one of enable, disable, home, unhome, pause, resume where CRTK allows it; any other changes nothing."""
        state = OperatingState
        if command == "enable" and self._state in (state.DISABLED, state.FAULT):
            if "power_off" in self._faults:
                self._enter_fault("failed to enable power")
            else:
                self._state, self._error = state.ENABLED, ""
        elif command == "disable":
            self._stop(Code.MOVE_NOT_REACHED, f"{self._name} was disabled")
            self._state, self._error, self._homing_until = state.DISABLED, "", None
        elif command == "pause" and self._state is state.ENABLED:
            self._stop(Code.MOVE_NOT_REACHED, f"{self._name} was paused")
            self._state, self._homing_until = state.PAUSED, None
        elif command == "resume" and self._state is state.PAUSED:
            self._state = state.ENABLED
        elif command == "home" and self._state is state.ENABLED and not self._homed:
            self._homing_until = self._clock() + self._config.homing_time
        elif command == "unhome":
            self._stop(Code.MOVE_NOT_REACHED, f"{self._name} was unhomed")
            self._homed, self._homing_until = False, None

    def measured_cp(self) -> Stamped[Pose]:
        """Give the encoders' pose with noise; it knows nothing of bias and backlash."""
        return self._measured_cp

    def setpoint_cp(self) -> Pose:
        """Give the pose that the controller aims at now; a command shows here after the latency."""
        return self._setpoint

    def measured_jaw(self) -> Stamped[float]:
        """Give the full jaw opening with noise [rad]."""
        return self._measured_jaw

    def measured_cf(self) -> Stamped[Array]:
        """Give the tip force with noise (3,) [N]."""
        return self._measured_cf

    def servo_cp(self, pose: Pose) -> None:
        """Aim at `pose` after the latency; the encoders follow at limited speed. Ignored, as on the robot, unless ready."""
        if self._hears():
            self._send(lambda: self._begin_servo(pose))

    def move_cp(self, pose: Pose) -> StubMove:
        """Go to `pose` in a straight line at the free speed."""
        duration = _duration(self._setpoint, pose, self._config)
        return self._command(pose, duration, self._begin_move)

    def move_jaw(self, angle: float) -> StubMove:
        """Go to the full opening `angle` [rad]."""
        return self._command(float(angle), abs(angle - self._jaw) / self._config.jaw_speed, self._begin_jaw)

    def hold(self) -> None:
        """Stop at once where the arm is, jaw too; commands still on their way are dropped."""
        if "freeze" not in self._faults:
            self._stop(Code.MOVE_NOT_REACHED, "the motion was stopped by a hold")

    # ------------------------------------------------------------ what the bench does and sees

    def step(self, dt: float, force: Array) -> None:
        """Go on by `dt` [s] under the true force on the tip (3,) [N]; the clock still shows the step's beginning."""
        now = self._clock() + dt
        if "fault" in self._faults and self._state in (OperatingState.ENABLED, OperatingState.PAUSED):
            self._enter_fault("injected fault")
        while self._queue and self._queue[0][0] <= now + INSTANT:
            self._queue.popleft()[1]()
        if self._homing_until is not None and now >= self._homing_until - INSTANT:
            self._homed, self._homing_until = True, None
        if self._state is OperatingState.ENABLED:
            self._advance(dt)
        half = 0.5 * self._config.backlash
        encoders = self._encoders.position
        self._tip = np.minimum(np.maximum(self._tip, encoders - half), encoders + half)
        if "stale" not in self._faults:
            self._measure(now, force)
        self._settle(now)

    def true_pose(self) -> Pose:
        """Give the tip where tissue and camera see it: encoders, lagging by backlash, plus bias."""
        return Pose(self._tip + self._bias, _product(self._bias_turn, self._encoders.quaternion))

    def true_jaw(self) -> float:
        """Give the true full opening [rad]."""
        return self._jaw

    @property
    def faults(self) -> frozenset[str]:
        """The injected faults that are in effect."""
        return frozenset(self._faults)

    def inject(self, fault: str) -> None:
        """Put a fault in effect until `clear`, which ends all; the state stays as the fault left it.

        `fault`: FAULT, again after each enable. `power_off`: DISABLED where it stands (brakes), cannot be enabled. `stale`:
        measured values and stamps stand still while the arm goes on. `freeze`: motion commands and holds are silently dropped.

        Raises:
            InputError: there is no such fault.
        """
        if fault == "clear":
            self._faults.clear()
            return
        if fault not in FAULTS:
            raise InputError(f"there is no arm fault {fault!r}; the faults are {', '.join(FAULTS)}, and clear ends them")
        self._faults.add(fault)
        if fault == "fault":
            self._enter_fault("injected fault")
        elif fault == "power_off":
            self._stop(Code.MOVE_NOT_REACHED, f"{self._name} lost its power")
            self._state, self._homing_until = OperatingState.DISABLED, None

    # ------------------------------------------------------------ commands

    def _ready(self) -> bool:
        return self._state is OperatingState.ENABLED and self._homed

    def _hears(self) -> bool:
        return self._ready() and "freeze" not in self._faults

    def _send(self, begin: Callable[[], None]) -> None:
        self._queue.append((self._clock() + self._config.latency, begin))

    def _command(self, goal: Pose | float, duration: float, begin: Callable[[StubMove], None]) -> StubMove:
        arrives = self._clock() + self._config.latency
        move = StubMove(goal, arrives + BEGIN_WITHIN, arrives + 2.0 * duration + 1.0)
        if not self._ready():
            move.end(Code.MOVE_REJECTED, f"{self._name} ignored the command: it is {self._state.value.lower()} or not homed")
            return move
        self._waiting.append(move)
        if self._hears():
            self._send(lambda: begin(move))
        return move

    def _begin_servo(self, pose: Pose) -> None:
        self._replace(self._cp_move)
        self._cp_move, self._setpoint = None, pose

    def _begin_move(self, move: StubMove) -> None:
        self._replace(self._cp_move)
        self._cp_move, move.began = move, True

    def _begin_jaw(self, move: StubMove) -> None:
        self._replace(self._jaw_move)
        self._jaw_move, move.began = move, True

    def _replace(self, move: StubMove | None) -> None:
        if move:
            move.end(Code.MOVE_NOT_REACHED, "another command took this motion's place")

    def _enter_fault(self, error: str) -> None:
        self._stop(Code.ARM_FAULT, f"{self._name} has a fault: {error}")
        self._state, self._error, self._homing_until = OperatingState.FAULT, error, None

    def _stop(self, code: Code, message: str) -> None:
        """Stand still here and end every motion, those still on their way too."""
        for move in self._waiting:
            move.end(code, message)
        self._queue.clear()
        self._waiting.clear()
        self._cp_move = self._jaw_move = None
        self._setpoint, self._jaw_setpoint = self._encoders, self._jaw

    # ------------------------------------------------------------ motion

    def _advance(self, dt: float) -> None:
        if self._cp_move and isinstance(self._cp_move.goal, Pose):
            self._setpoint = _approach(self._setpoint, self._cp_move.goal, dt, self._config)
        if self._encoders is not self._setpoint:
            self._encoders = _approach(self._encoders, self._setpoint, dt, self._config)
        if self._jaw_move and isinstance(self._jaw_move.goal, float):
            self._jaw_setpoint = self._jaw_move.goal
        reach = self._config.jaw_speed * dt
        self._jaw += min(max(self._jaw_setpoint - self._jaw, -reach), reach)

    def _measure(self, now: float, force: Array) -> None:
        config, noise = self._config, self._rng.standard_normal(7)
        position = self._encoders.position + config.encoder_noise * noise[:3]
        self._measured_cp = Stamped(Pose(position, self._encoders.quaternion), now)
        self._measured_jaw = Stamped(self._jaw + config.jaw_noise * float(noise[3]), now)
        self._measured_cf = Stamped(force + config.force_noise * noise[4:], now)

    def _settle(self, now: float) -> None:
        """End motions that arrived, were dropped, or took too long. Stopping is no proof of arrival: measured must be there."""
        if not self._waiting:
            return
        for move in self._waiting:
            if move.began and now - self._measured_cp.stamp <= FRESH_WITHIN and self._arrived(move):
                move.end(Code.OK)
            elif not move.began and now > move.begin_by:
                move.end(
                    Code.MOVE_REJECTED, f"{self._name} did not begin the motion within {BEGIN_WITHIN} s: the command was lost"
                )
            elif now > move.deadline:
                move.end(Code.MOVE_TIMEOUT, f"{self._name} did not arrive in the time that the way should take")
        self._waiting = [move for move in self._waiting if move.report() is RUNNING]
        if self._cp_move and self._cp_move.report() is not RUNNING:
            self._cp_move, self._setpoint = None, self._encoders
        if self._jaw_move and self._jaw_move.report() is not RUNNING:
            self._jaw_move, self._jaw_setpoint = None, self._jaw

    def _arrived(self, move: StubMove) -> bool:
        if isinstance(move.goal, Pose):
            if self._encoders is not move.goal:
                return False
            measured = self._measured_cp.value
            distance = float(np.linalg.norm(measured.position - move.goal.position))
            return distance <= self._config.position_tolerance and measured.angle_to(move.goal) <= self._config.turn_tolerance
        return self._jaw == move.goal and abs(self._measured_jaw.value - move.goal) <= self._config.jaw_tolerance


def _duration(start: Pose, goal: Pose, config: ArmConfig) -> float:
    """Time [s] from `start` to `goal`, position and orientation together."""
    offset = goal.position - start.position
    angle = 2.0 * math.acos(min(abs(float(start.quaternion @ goal.quaternion)), 1.0))
    return max(math.sqrt(float(offset @ offset)) / config.free_speed, angle / config.turn_speed)


def _approach(pose: Pose, goal: Pose, dt: float, config: ArmConfig) -> Pose:
    """One step of `dt` [s] on the straight way to `goal`; gives `goal` itself on arrival."""
    duration = _duration(pose, goal, config)
    if duration <= dt * (1.0 + 1e-9):
        return goal
    fraction = dt / duration
    position = pose.position + fraction * (goal.position - pose.position)
    cosine = float(pose.quaternion @ goal.quaternion)
    half = math.acos(min(abs(cosine), 1.0))
    if half < 1e-6:
        return Pose(position, pose.quaternion)
    share = math.copysign(math.sin(fraction * half), cosine)
    quaternion = (math.sin((1.0 - fraction) * half) * pose.quaternion + share * goal.quaternion) / math.sin(half)
    return Pose(position, quaternion / math.sqrt(float(quaternion @ quaternion)))


def _turn(vector: Array) -> Array:
    """Quaternion (4,), order (x, y, z, w), of the rotation vector (3,) [rad]."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.array([0.0, 0.0, 0.0, 1.0])
    return np.array([*(np.sin(angle / 2) / angle * vector), np.cos(angle / 2)])


def _product(a: Array, b: Array) -> Array:
    """Quaternion product: first `b`, then `a`."""
    vector = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return np.array([*vector, a[3] * b[3] - float(a[:3] @ b[:3])])
