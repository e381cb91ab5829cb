"""The safety gate: the only way a command reaches an arm, and the monitor that watches the bench by itself.

A skill gets a `Lease`, never an arm. Every command is checked, the decision is reported (so that nothing moves
unrecorded), and only then sent. The monitor runs at each physics step of the stub, or in a robot's 100 Hz thread, so that safety
never waits for a tick. The gate itself only ever holds: it never opens a jaw and never moves an arm away.

Commands come from one thread (the session's) and the monitor from another; a lock keeps them apart. A lease is
dead before the lock is asked for, so no command can slip in between a revocation and the hold that follows it.
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable

import numpy as np

from hardware.codes import Code
from hardware.grasp_load import GraspLoad
from hardware.interface import CUTTER, GRASPER, Array, Bench, MoveHandle, MoveStatus, Pose
from hardware.lease import Lease
from hardware.limits import Limits
from hardware.motion_checks import finite_pose, inside_workspace, step_length, step_speed, tools_apart
from hardware.readings import FUTURE, Readings
from hardware.verdicts import Approval, Decision, Refusal, Trip, Verdict

__all__ = ["Approval", "Decision", "Lease", "Limits", "SafetyGate", "Trip", "Verdict"]

log = logging.getLogger(__name__)

JAW_ROUNDING = 1e-6  # [rad]
JAW_NOISE = 0.03  # [rad]; closing by more than this below the measured opening is a cut even if it was commanded before


def _ignore(decision: Decision) -> None:
    """Report to nobody."""


class _Channel:
    """What the gate remembers of its commands to one arm."""

    def __init__(self) -> None:
        self.servo: Pose | None = None  # the last servo command of the motion going on
        self.servo_stamp = -math.inf
        self.move: tuple[MoveHandle, Array] | None = None  # the free motion going on and where it ends
        self.jaw: float | None = None  # [rad], the opening commanded last

    def stopped(self) -> None:
        """Forget the motion, not when it was: a hold between two steps must not let them come faster."""
        self.servo, self.move = None, None


class SafetyGate:
    """Wraps a bench; see the module's text. `on_decision` is told every decision before the command is sent.

    If `on_decision` raises, the session cannot be recorded: the gate trips with RECORDER_FAILED.
    """

    def __init__(self, bench: Bench, limits: Limits | None = None, on_decision: Callable[[Decision], None] = _ignore) -> None:
        self._bench = bench
        self._limits = limits or Limits()
        self._on_decision = on_decision
        self._lock = threading.RLock()
        self._lease: Lease | None = None
        self._trip: Trip | None = None
        self._approval: Approval | None = None
        self._cuts_total = 0
        self._cuts_approved = 0
        self._channels = {name: _Channel() for name in bench.arms}
        self._readings = Readings(bench, self._limits)
        self._load = GraspLoad(bench.arms[GRASPER], self._limits)
        self._load.sample()
        bench.observe(self._monitor)

    # Who may move

    @property
    def bench(self) -> Bench:
        """The bench, for reading and for state commands; its motions are for leases only."""
        return self._bench

    @property
    def limits(self) -> Limits:
        """The limits in force."""
        return self._limits

    @property
    def lease(self) -> Lease | None:
        """The live lease, if any."""
        return self._lease if self._lease and self._lease.alive else None

    def grant(self, holder: str) -> Lease:
        """Give `holder` the right to move the arms. While tripped, each of its motions is refused.

        Raises:
            RuntimeError: another lease is alive.
        """
        with self._lock:
            if self._lease and self._lease.alive:
                raise RuntimeError(f"{self._lease.holder} holds the lease; {holder} cannot have it too")
            self._lease = Lease(self, holder)
            return self._lease

    def revoke(self, lease: Lease) -> None:
        """End `lease`, then hold both arms. Idempotent."""
        was_alive = lease.alive
        lease._end("the lease was revoked")
        with self._lock:  # also waits for a hold that the monitor may be sending
            if was_alive:
                self._hold_all(lease.holder, Code.LEASE_REVOKED, "the lease was revoked")

    # Approvals of cuts

    @property
    def approval(self) -> Approval | None:
        """The live approval; None when there is none or it has expired."""
        approval = self._approval
        return approval if approval and approval.granted - FUTURE <= self._bench.now() < approval.expires else None

    @property
    def cuts(self) -> int:
        """Cuts allowed so far in this session."""
        return self._cuts_total

    def approve(self, approval: Approval) -> None:
        """Allow cuts under `approval`, from now until it expires or is withdrawn."""
        with self._lock:
            self._approval, self._cuts_approved = approval, 0

    def withdraw_approval(self) -> None:
        """Allow no cut until the next approval."""
        self._approval = None

    # Trips

    @property
    def tripped(self) -> Trip | None:
        """Why all motion was stopped, until a person clears it."""
        return self._trip

    def trip(self, code: Code, message: str) -> None:
        """Stop everything: lease dead, approval withdrawn, both arms holding. Latched; a later trip changes nothing."""
        lease = self.lease
        if lease:
            lease._end(message)
        with self._lock:
            if self._trip:
                return
            self._trip = Trip(self._bench.now(), code, message)
            self._approval = None
            self._hold_all(lease.holder if lease else "", code, message)

    def clear_trip(self) -> None:
        """Let motion be asked for again: a person's act. If the cause persists, the monitor trips again at its next look."""
        with self._lock:
            if self._trip:
                cleared, self._trip = self._trip, None
                self._report("", "", "clear_trip", Refusal(Code.OK, f"a person cleared: {cleared.message}"), None, accepted=True)

    # The tissue

    def report_strain(self, strain: float, stamp: float) -> None:
        """Take the tissue strain measured at bench time `stamp` [s]; NaN, or a stale or future stamp, means unknown."""
        fresh = self._readings.fresh(stamp, self._limits.data_lost)
        with self._lock:
            self._load.report_strain(strain if fresh else math.nan)

    def tension(self) -> float:
        """Give the filtered force on the grasper [N]; NaN when unknown."""
        return self._load.tension

    def strain(self) -> float:
        """Give the strain reported last; NaN when unknown."""
        return self._load.strain

    # Readings for the guards

    def check_emergency_stop(self) -> Verdict:
        """Whether the emergency stop is free; latched when pressed."""
        return self._readings.check_emergency_stop()

    def check_arms(self) -> Verdict:
        """Whether both arms are enabled, homed and fresh; a fault is latched."""
        return self._readings.check_arms()

    def check_camera(self) -> Verdict:
        """Whether the newest frame is young enough for motion."""
        return self._readings.check_camera()

    def check_workspace(self) -> Verdict:
        """Whether both measured tips lie inside the workspace."""
        return self._readings.check_workspace()

    def check_tension(self) -> Verdict:
        """Whether tension is known and below the abort limit; see `GraspLoad.check`."""
        return self._load.check()

    # One command

    def _command(
        self, lease: Lease, arm: str, command: str, target: Pose | float, sent: list[MoveHandle] | None = None
    ) -> Refusal | None:
        """Check, report, and send one command; the handle of a move is appended to `sent`."""
        if arm not in self._channels:
            raise KeyError(f"there is no arm {arm}; the arms are {', '.join(self._channels)}")
        with self._lock:
            refusal = self._refusal(lease, arm, command, target)
            self._report(lease.holder, arm, command, refusal, _numbers(target), accepted=refusal is None)
            # The record or the monitor may have ended the lease while the decision was being reported.
            refusal = refusal or self._lease_refusal(lease)
            if refusal is None:
                self._send(arm, command, target, sent)
            return refusal

    def _refusal(self, lease: Lease, arm: str, command: str, target: Pose | float) -> Refusal | None:
        refusal = self._lease_refusal(lease) or self._readings.arm(arm) or self._readings.camera(self._limits.camera_stale)
        if refusal:
            if refusal.code is Code.ARM_FAULT:
                self.trip(refusal.code, refusal.message)
            return refusal
        self._load.sample()
        if isinstance(target, Pose):
            return self._pose_refusal(arm, command, target)
        return self._jaw_refusal(arm, float(target))

    def _pose_refusal(self, arm: str, command: str, target: Pose) -> Refusal | None:
        limits, channel = self._limits, self._channels[arm]
        refusal = finite_pose(target) or inside_workspace(target.position, limits)
        if refusal:
            return refusal
        setpoint = self._bench.arms[arm].setpoint_cp()
        if not setpoint.is_finite():
            return Refusal(Code.NOT_FINITE, f"the setpoint of {arm} is not finite")
        loaded = arm == GRASPER and self._load.loaded
        if command == "servo_cp":
            step = float(np.linalg.norm(target.position - (channel.servo or setpoint).position))
            refusal = step_length(target, setpoint, channel.servo, limits) or step_speed(
                step, self._bench.now() - channel.servo_stamp, limits.max_loaded_speed if loaded else limits.max_speed
            )
        elif loaded:
            refusal = Refusal(
                Code.TOO_FAST,
                f"the grasper holds tissue at {self._load.tension:.2f} N: it moves in servo steps of at most "
                f"{limits.max_loaded_speed * 1e3:.0f} mm/s, not in one free motion",
            )
        if refusal:
            return refusal
        for other in self._channels:
            if other != arm and (refusal := tools_apart(setpoint.position, target.position, self._swept(other), limits)):
                return refusal
        return self._load.pulling_refusal(setpoint.position, target) if arm == GRASPER else None

    def _jaw_refusal(self, arm: str, angle: float) -> Refusal | None:
        if not math.isfinite(angle):
            return Refusal(Code.NOT_FINITE, "the commanded jaw opening is not finite")
        if not 0.0 <= angle <= self._limits.max_jaw:
            widest = math.degrees(self._limits.max_jaw)
            return Refusal(
                Code.WORKSPACE, f"a jaw opening of {math.degrees(angle):.0f} degrees lies outside 0 to {widest:.0f} degrees"
            )
        if arm != CUTTER or not self._closes(angle):
            return None
        if self.approval is None:
            given = "has expired" if self._approval else "has not been given"
            return Refusal(Code.CUT_NOT_APPROVED, f"closing the scissors is a cut, and the approval for it {given}")
        for count, limit, scope in (
            (self._cuts_approved, self._limits.max_cuts_per_approval, "under this approval"),
            (self._cuts_total, self._limits.max_cuts_total, "in this session"),
        ):
            if count >= limit:
                return Refusal(Code.CUT_LIMIT, f"all {limit} cuts allowed {scope} have been made")
        return None

    def _send(self, arm: str, command: str, target: Pose | float, sent: list[MoveHandle] | None) -> None:
        device, channel = self._bench.arms[arm], self._channels[arm]
        if isinstance(target, Pose):
            if command == "servo_cp":
                channel.move, channel.servo, channel.servo_stamp = None, target, self._bench.now()
                device.servo_cp(target)
                return
            handle = device.move_cp(target)
            channel.servo, channel.move = None, (handle, target.position)
        else:
            if arm == CUTTER and self._closes(target):
                self._cuts_approved += 1
                self._cuts_total += 1
            channel.jaw = float(target)
            handle = device.move_jaw(float(target))
        if sent is not None:
            sent.append(handle)

    def _closes(self, angle: float) -> bool:
        """Whether `angle` closes the scissors; unknown jaws count as open, and many small closings as many cuts."""
        measured = self._bench.arms[CUTTER].measured_jaw().value
        commanded = self._channels[CUTTER].jaw
        return not (angle >= measured - JAW_NOISE and (commanded is None or angle >= commanded - JAW_ROUNDING))

    def _swept(self, arm: str) -> tuple[Array, Array]:
        """Give the line [m] that the tip of `arm` is still going to sweep: a point when it is not moving by itself."""
        start = self._bench.arms[arm].measured_cp().value.position
        move = self._channels[arm].move
        if move and move[0].report().status is MoveStatus.RUNNING:
            return start, move[1]
        # The setpoint shows a servo command only after the arm's latency.
        servo = self._channels[arm].servo
        return start, (servo or self._bench.arms[arm].setpoint_cp()).position

    # What every command and the monitor ask

    def _lease_refusal(self, lease: Lease) -> Refusal | None:
        if not lease.alive:
            return Refusal(Code.LEASE_REVOKED, f"{lease.holder} may not move the arms any more: {lease._ended_by}")
        if self._trip is None and self._bench.emergency_stop():
            self.trip(Code.EMERGENCY_STOP, "the emergency stop is pressed")
        if self._trip:
            return Refusal(Code.TRIPPED, f"motion is stopped: {self._trip.message}")
        return None

    # The monitor

    def _monitor(self) -> None:
        """Look at everything once; called at each physics step or from the robot's 100 Hz thread. Never raises."""
        with self._lock:
            try:
                self._look()
            except Exception as error:
                log.exception("the safety monitor failed")
                self.trip(Code.INTERNAL_ERROR, f"the safety monitor failed: {error}")

    def _look(self) -> None:
        self._load.sample()
        if self._trip:
            return
        if self._bench.emergency_stop():
            self.trip(Code.EMERGENCY_STOP, "the emergency stop is pressed")
            return
        if fault := self._readings.fault():
            self.trip(fault.code, fault.message)
            return
        load = self._load.check()
        if load.latched:
            self.trip(load.code, load.message)
            return
        if lease := self.lease:
            loss = self._readings.loss()
            if loss is None and not load.ok:
                loss = Refusal(load.code, load.message)
            if loss:
                lease._end(loss.message)
                self._hold_all(lease.holder, loss.code, loss.message)

    # Holding and reporting

    def _hold_for(self, lease: Lease) -> None:
        with self._lock:
            if lease.alive:
                self._hold_all(lease.holder, Code.OK, "")

    def _hold_all(self, holder: str, code: Code, message: str) -> None:
        """Hold first, report after; an arm that cannot be told does not keep the other one moving."""
        answers: list[tuple[str, Refusal, bool]] = []
        for name, arm in self._bench.arms.items():
            self._channels[name].stopped()
            try:
                arm.hold()
                answers.append((name, Refusal(code, message), True))
            except Exception as error:
                log.exception("%s could not be told to hold", name)
                answers.append((name, Refusal(Code.INTERNAL_ERROR, f"{name} could not be told to hold: {error}"), False))
        for name, answer, accepted in answers:
            self._report(holder, name, "hold", answer, None, accepted)

    def _report(
        self, holder: str, arm: str, command: str, why: Refusal | None, target: tuple[float, ...] | None, accepted: bool
    ) -> None:
        code, message = (why.code, why.message) if why else (Code.OK, "")
        try:
            self._on_decision(Decision(self._bench.now(), holder, arm, command, accepted, code, message, target))
        except Exception as error:
            log.exception("a decision could not be recorded")
            self.trip(Code.RECORDER_FAILED, f"a command could not be recorded: {error}")


def _numbers(target: Pose | float) -> tuple[float, ...] | None:
    """Give the target as plain numbers; None if one of them is not finite."""
    values = (*target.position, *target.quaternion) if isinstance(target, Pose) else (target,)
    numbers = tuple(float(value) for value in values)
    return numbers if all(map(math.isfinite, numbers)) else None
