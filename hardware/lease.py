"""The lease: what a skill gets instead of arms. All checks are the gate's; a lease only knows whether it is alive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from hardware.codes import Code
from hardware.interface import Array, Endoscope, MoveHandle, MoveReport, MoveStatus, Pose, Stamped
from hardware.limits import Limits

if TYPE_CHECKING:
    from hardware.gate import SafetyGate


class Lease:
    """The right to move the arms, granted to one running skill. Every command of a dead lease is refused."""

    def __init__(self, gate: SafetyGate, holder: str) -> None:
        self._gate = gate
        self._alive = True
        self._ended_by = "it was given back"
        self.holder = holder

    @property
    def alive(self) -> bool:
        """Whether commands may still pass."""
        return self._alive

    @property
    def endoscope(self) -> Endoscope:
        """The endoscope; looking needs no live lease."""
        return self._gate.bench.endoscope

    @property
    def limits(self) -> Limits:
        """The gate's limits."""
        return self._gate.limits

    def now(self) -> float:
        """Bench time [s]."""
        return self._gate.bench.now()

    def servo_cp(self, arm: str, pose: Pose) -> MoveReport:
        """Step `arm` to `pose`, near tissue: DONE means accepted, FAILED means refused with code and sentence."""
        refusal = self._gate._command(self, arm, "servo_cp", pose)
        return MoveReport(MoveStatus.FAILED, refusal.code, refusal.message) if refusal else MoveReport(MoveStatus.DONE)

    def move_cp(self, arm: str, pose: Pose) -> MoveHandle:
        """Send `arm` to `pose` in a straight line through free space; a refused one gives a handle that has FAILED."""
        return self._move(arm, "move_cp", pose)

    def move_jaw(self, arm: str, angle: float) -> MoveHandle:
        """Send the jaw of `arm` to the full opening `angle` [rad]; closing the scissors is a cut and needs an approval."""
        return self._move(arm, "move_jaw", angle)

    def hold(self) -> None:
        """Both arms stay where they are; nothing when the lease is dead, as they hold already."""
        self._gate._hold_for(self)

    def measured_cp(self, arm: str) -> Stamped[Pose]:
        """Measured tip pose of `arm`."""
        return self._gate.bench.arms[arm].measured_cp()

    def setpoint_cp(self, arm: str) -> Pose:
        """Pose that `arm` is told to be at now."""
        return self._gate.bench.arms[arm].setpoint_cp()

    def measured_jaw(self, arm: str) -> Stamped[float]:
        """Measured full jaw opening of `arm` [rad]."""
        return self._gate.bench.arms[arm].measured_jaw()

    def measured_cf(self, arm: str) -> Stamped[Array]:
        """Estimated force (3,) [N] on the tip of `arm`, left camera frame, as noisy as it is read."""
        return self._gate.bench.arms[arm].measured_cf()

    def tension(self) -> float:
        """Give the filtered force on the grasper [N]; NaN when unknown."""
        return self._gate.tension()

    def report_strain(self, strain: float, stamp: float) -> None:
        """Tell the gate the tissue strain measured at bench time `stamp` [s]; NaN means that it is unknown."""
        self._gate.report_strain(strain, stamp)

    def _move(self, arm: str, command: str, target: Pose | float) -> MoveHandle:
        sent: list[MoveHandle] = []
        refusal = self._gate._command(self, arm, command, target, sent)
        if refusal:
            return Refused(MoveReport(MoveStatus.FAILED, refusal.code, refusal.message))
        return LeasedMove(self, sent[0])

    def _end(self, reason: str) -> None:
        if self._alive:
            self._alive, self._ended_by = False, reason


@dataclass(frozen=True)
class Refused:
    """The handle of a motion that never began."""

    answer: MoveReport

    def report(self) -> MoveReport:
        """Give the refusal."""
        return self.answer


class LeasedMove:
    """A motion under a lease: once the lease is dead, a motion not seen to be done has failed, wherever the arm is by then."""

    def __init__(self, lease: Lease, handle: MoveHandle) -> None:
        self._lease, self._handle = lease, handle
        self._done = False

    def report(self) -> MoveReport:
        """Give the arm's own report while the lease lives."""
        report = self._handle.report()
        if self._lease.alive:
            self._done = report.status is MoveStatus.DONE
        elif report.status is not MoveStatus.FAILED and not self._done:
            return MoveReport(MoveStatus.FAILED, Code.LEASE_REVOKED, f"the motion was stopped: {self._lease._ended_by}")
        return report
