"""A scripted bench for unit tests: obeys the protocols of `hardware.interface`, at once or after a set delay, and logs all.

No physics: an arm is where its last command said, forces and frames are what the test sets. `MockBench.at` scripts events in
bench time. Every command that reaches an arm is in `MockBench.log`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hardware.codes import Code
from hardware.interface import (
    CUTTER,
    GRASPER,
    ArmState,
    Array,
    CameraModel,
    Frame,
    Image,
    MoveReport,
    MoveStatus,
    OperatingState,
    Pose,
    Stamped,
    StereoFrame,
)

FRAME_PERIOD = 1 / 30  # [s]
CAMERA = CameraModel(width=640, height=480, focal=620.0, cu=319.5, cv=239.5, baseline=4.3e-3)
HOMES = {
    GRASPER: Pose.looking(np.array([-0.015, 0.0, 0.06]), np.array([0.3, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])),
    CUTTER: Pose.looking(np.array([0.015, 0.0, 0.06]), np.array([-0.3, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])),
}


@dataclass(frozen=True)
class Command:
    """One command as the arm got it, at bench time `stamp` [s]."""

    stamp: float
    arm: str
    name: str
    target: Pose | float | str | None = None


class MockMove:
    """A motion that ends at `finish` [s], `inf` for never; the arm ends it early by setting `ended`."""

    def __init__(self, arm: MockArm, finish: float, arrive: Callable[[], None], failure: MoveReport | None) -> None:
        self._arm, self._finish, self._arrive, self._failure = arm, finish, arrive, failure
        self.ended: MoveReport | None = None

    def update(self) -> None:
        """Arrive or fail, if it is time."""
        if self.ended is None and self._arm.bench.now() >= self._finish:
            self.ended = self._failure or MoveReport(MoveStatus.DONE)
            if not self._failure:
                self._arrive()

    def report(self) -> MoveReport:
        """Give the state of this motion now."""
        self.update()
        return self.ended or MoveReport(MoveStatus.RUNNING)


class MockArm:
    """Set `force`, `stale`, `delay`, `pose`, `jaw` and call `fault`, `power_off`, `fail_next` as the test needs."""

    def __init__(self, bench: MockBench, name: str) -> None:
        self.bench = bench
        self._name = name
        self.pose = HOMES[name]
        self.jaw = 0.6 if name == GRASPER else 0.0
        self.force: Array = np.zeros(3)
        self.delay = 0.0  # [s], how long each motion takes; inf: it never ends
        self._state = ArmState(OperatingState.ENABLED, is_homed=True, is_busy=False, stamp=bench.now())
        self._stale_since: float | None = None
        self._moves: list[MockMove] = []
        self._next_failure: MoveReport | None = None

    # What a test does to the arm

    @property
    def stale(self) -> bool:
        """Whether the stamps of the measured data stand still."""
        return self._stale_since is not None

    @stale.setter
    def stale(self, value: bool) -> None:
        self._stale_since = self.bench.now() if value else None

    def fault(self, error: str = "motor current too high") -> None:
        """Put the arm in FAULT; motions end without success."""
        self._set(OperatingState.FAULT, homed=self._state.is_homed, error=error)
        self._end_moves(Code.ARM_FAULT, error)

    def power_off(self) -> None:
        """Take the power: DISABLED."""
        self._set(OperatingState.DISABLED, homed=self._state.is_homed)
        self._end_moves(Code.MOVE_NOT_REACHED, "the arm lost its power")

    def unhome(self) -> None:
        """Leave the arm disabled and not homed, as after start-up."""
        self._set(OperatingState.DISABLED, homed=False)

    def recover(self) -> None:
        """Be enabled, homed, fresh again."""
        self.stale = False
        self._set(OperatingState.ENABLED, homed=True)

    def fail_next(self, code: Code, message: str = "scripted failure") -> None:
        """Let the next motion fail with `code`."""
        self._next_failure = MoveReport(MoveStatus.FAILED, code, message)

    # Arm

    @property
    def name(self) -> str:
        """The arm's name."""
        return self._name

    def operating_state(self) -> ArmState:
        """Give the newest state; busy while a motion runs."""
        return replace(self._state, is_busy=any(move.report().status is MoveStatus.RUNNING for move in self._moves))

    def state_command(self, command: str) -> None:
        """Obey enable, disable, home, unhome, pause and resume where CRTK allows them."""
        self.bench.record(self._name, "state_command", command)
        state, homed = self._state.state, self._state.is_homed
        if command == "enable" and state is not OperatingState.PAUSED:
            self._set(OperatingState.ENABLED, homed)
        elif command == "disable":
            self._set(OperatingState.DISABLED, homed)
        elif command == "pause" and state is OperatingState.ENABLED:
            self._set(OperatingState.PAUSED, homed)
        elif command == "resume" and state is OperatingState.PAUSED:
            self._set(OperatingState.ENABLED, homed)
        elif command == "home" and state is OperatingState.ENABLED:
            self._set(state, True)
        elif command == "unhome":
            self._set(state, False)

    def measured_cp(self) -> Stamped[Pose]:
        """Where the last command said."""
        self._update()
        return Stamped(self.pose, self._stamp())

    def setpoint_cp(self) -> Pose:
        """Give the same as measured."""
        self._update()
        return self.pose

    def measured_jaw(self) -> Stamped[float]:
        """Give what the last command said [rad]."""
        self._update()
        return Stamped(self.jaw, self._stamp())

    def measured_cf(self) -> Stamped[Array]:
        """Give what the test set [N]."""
        return Stamped(self.force, self._stamp())

    def servo_cp(self, pose: Pose) -> None:
        """Be there at once."""
        self.bench.record(self._name, "servo_cp", pose)
        self.pose = pose

    def move_cp(self, pose: Pose) -> MockMove:
        """Be there after `delay`."""
        self.bench.record(self._name, "move_cp", pose)
        return self._start(lambda: setattr(self, "pose", pose))

    def move_jaw(self, angle: float) -> MockMove:
        """Open to `angle` after `delay`."""
        self.bench.record(self._name, "move_jaw", angle)
        return self._start(lambda: setattr(self, "jaw", angle))

    def hold(self) -> None:
        """End all motions where they are."""
        self.bench.record(self._name, "hold", None)
        self._end_moves(Code.MOVE_NOT_REACHED, "the motion was stopped by a hold")

    def _start(self, arrive: Callable[[], None]) -> MockMove:
        failure, self._next_failure = self._next_failure, None
        if not self._state.ready:
            failure = MoveReport(MoveStatus.FAILED, Code.MOVE_REJECTED, f"{self._name} is not ready")
        move = MockMove(self, self.bench.now() + (0.0 if failure else self.delay), arrive, failure)
        move.update()
        self._moves.append(move)
        return move

    def _update(self) -> None:
        self._moves = [move for move in self._moves if move.report().status is MoveStatus.RUNNING]

    def _end_moves(self, code: Code, message: str) -> None:
        self._update()
        for move in self._moves:
            move.ended = MoveReport(MoveStatus.FAILED, code, message)
        self._moves = []

    def _set(self, state: OperatingState, homed: bool, error: str = "") -> None:
        self._state = ArmState(state, homed, False, self.bench.now(), error)

    def _stamp(self) -> float:
        return self.bench.now() if self._stale_since is None else self._stale_since


class MockEndoscope:
    """Shows `image` (and `right_image`); `freeze` stops the stamps."""

    def __init__(self, bench: MockBench) -> None:
        self._bench = bench
        self._frozen_at: float | None = None
        self.image: Image = np.full((CAMERA.height, CAMERA.width, 3), 128, dtype=np.uint8)
        self.right_image: Image | None = None

    @property
    def camera(self) -> CameraModel:
        """The stub's default intrinsics."""
        return CAMERA

    def freeze(self) -> None:
        """Give no new frame from now on."""
        self._frozen_at = self._bench.now()

    def thaw(self) -> None:
        """Give new frames again."""
        self._frozen_at = None

    def stamp(self) -> float:
        """Bench time of the newest frame [s]."""
        return self._sequence() * FRAME_PERIOD

    def left(self) -> Frame:
        """Give the newest left frame."""
        return Frame(self._sequence(), self.stamp(), self.image)

    def stereo(self) -> StereoFrame:
        """Give the newest pair; without a right image, the left one twice."""
        return StereoFrame(self.left(), self.image if self.right_image is None else self.right_image)

    def _sequence(self) -> int:
        now = self._bench.now() if self._frozen_at is None else self._frozen_at
        return int(now / FRAME_PERIOD + 1e-6)


class MockBench:
    """Two mock arms, a mock endoscope and a clock that moves only in `advance`, in steps of `step` [s]."""

    def __init__(self, step: float = 0.01) -> None:
        self._now = 0.0
        self._step = step
        self._observers: list[Callable[[], None]] = []
        self._script: list[tuple[float, Callable[[], None]]] = []
        self.log: list[Command] = []
        self.pressed = False  # the emergency stop
        self.closed = False
        self.grasper = MockArm(self, GRASPER)
        self.cutter = MockArm(self, CUTTER)
        self.eye = MockEndoscope(self)

    @property
    def arms(self) -> dict[str, MockArm]:
        """Both arms by name."""
        return {GRASPER: self.grasper, CUTTER: self.cutter}

    @property
    def endoscope(self) -> MockEndoscope:
        """The mock endoscope."""
        return self.eye

    def now(self) -> float:
        """Bench time [s]."""
        return self._now

    def at(self, stamp: float, action: Callable[[], None]) -> None:
        """Let `action` happen at the first step that reaches bench time `stamp` [s], before the observers look."""
        self._script.append((stamp, action))

    def advance(self, duration: float) -> None:
        """Let `duration` [s] pass in equal steps."""
        start, count = self._now, max(1, round(duration / self._step))
        for index in range(1, count + 1):
            self._now = start + duration * index / count
            due = [action for stamp, action in self._script if stamp <= self._now + 1e-9]
            self._script = [(stamp, action) for stamp, action in self._script if stamp > self._now + 1e-9]
            for action in due:
                action()
            for observer in self._observers:
                observer()

    def observe(self, callback: Callable[[], None]) -> None:
        """Call `callback` after every step."""
        self._observers.append(callback)

    def emergency_stop(self) -> bool:
        """Whether the test has pressed it."""
        return self.pressed

    def close(self) -> None:
        """Hold both arms."""
        for arm in self.arms.values():
            arm.hold()
        self.closed = True

    def record(self, arm: str, name: str, target: Pose | float | str | None) -> None:
        """Append one command to the log."""
        self.log.append(Command(self._now, arm, name, target))

    def motions(self, arm: str | None = None) -> list[Command]:
        """Give the motions that reached the arms, without holds and state commands."""
        return [c for c in self.log if c.name in ("servo_cp", "move_cp", "move_jaw") and arm in (None, c.arm)]

    def holding(self) -> bool:
        """Whether the last command to each arm that moved was a hold, and no motion runs."""
        for name, arm in self.arms.items():
            commands = [c.name for c in self.log if c.arm == name and c.name != "state_command"]
            if arm.operating_state().is_busy or (commands and commands[-1] != "hold"):
                return False
        return True
