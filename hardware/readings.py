"""Pure readings of a bench against the limits: arm state, ages of data, workspace. They change nothing and command nothing."""

from __future__ import annotations

import math

from hardware.codes import Code
from hardware.interface import Bench, OperatingState
from hardware.limits import Limits
from hardware.motion_checks import finite_pose, inside_workspace
from hardware.verdicts import Refusal, Verdict

FUTURE = 0.01  # [s]; a stamp further ahead of the clock than this is no fresher than an old one


class Readings:
    """What the bench says now. Each method that may refuse gives a `Refusal`, or None when all is well."""

    def __init__(self, bench: Bench, limits: Limits) -> None:
        self._bench = bench
        self._limits = limits

    def fresh(self, stamp: float, limit: float) -> bool:
        """Whether `stamp` [s] is at most `limit` [s] old; NaN never is, nor is a stamp from the future (a skewed clock)."""
        return -FUTURE <= self._bench.now() - stamp <= limit + 1e-9

    def arm(self, name: str) -> Refusal | None:
        """Refuse motion of an arm that is in fault, not enabled, not homed, or whose data are stale."""
        state = self._bench.arms[name].operating_state()
        if state.state is OperatingState.FAULT:
            return Refusal(Code.ARM_FAULT, f"{name} has a fault: {state.error or 'the robot gives no reason'}")
        if not state.guard.ok:
            return Refusal(state.guard.code, f"{name} may not move: {state.guard.message}")
        if not state.ready:
            homed = "homed" if state.is_homed else "not homed"
            return Refusal(Code.ARM_NOT_READY, f"{name} is {state.state.value.lower()} and {homed}; it must be enabled and homed")
        return self._stale_arm(name, self._limits.arm_stale)

    def camera(self, limit: float) -> Refusal | None:
        """Refuse motion when the newest frame is older than `limit` [s]."""
        stamp = self._bench.endoscope.stamp()
        if self.fresh(stamp, limit):
            return None
        return Refusal(Code.CAMERA_STALE, f"the newest image is {self._age(stamp)}; at most {limit * 1e3:.0f} ms are allowed")

    def fault(self) -> Refusal | None:
        """Give the first arm's fault, if one has any; or else what its driver calls past all waiting."""
        states = {name: arm.operating_state() for name, arm in self._bench.arms.items()}
        for name, state in states.items():
            if state.state is OperatingState.FAULT:
                return self.arm(name)
        for name, state in states.items():
            if not state.guard.ok and state.guard.latched:
                return Refusal(state.guard.code, f"{name} may not move: {state.guard.message}")
        return None

    def loss(self) -> Refusal | None:
        """Why a running skill may not go on for now: an arm no longer ready, data lost or not finite, camera lost."""
        for name, arm in self._bench.arms.items():
            if not arm.operating_state().ready:
                return self.arm(name)
            if refusal := self._stale_arm(name, self._limits.data_lost):
                return refusal
            pose, jaw = arm.measured_cp().value, arm.measured_jaw().value
            if not math.isfinite(float(pose.position @ pose.position + pose.quaternion @ pose.quaternion) + jaw):
                return Refusal(Code.NOT_FINITE, f"the measured position of {name} is not finite")
        return self.camera(self._limits.data_lost)

    def check_arms(self) -> Verdict:
        """Whether both arms are enabled, homed and fresh; a fault is latched."""
        if fault := self.fault():
            return Verdict(False, True, fault.code, fault.message)
        refusal = next((refusal for name in self._bench.arms if (refusal := self.arm(name))), None)
        return Verdict(False, False, refusal.code, refusal.message) if refusal else Verdict(True)

    def check_camera(self) -> Verdict:
        """Whether the newest frame is young enough for motion."""
        refusal = self.camera(self._limits.camera_stale)
        return Verdict(False, False, refusal.code, refusal.message) if refusal else Verdict(True)

    def check_workspace(self) -> Verdict:
        """Whether both measured tips lie inside the workspace."""
        for name, arm in self._bench.arms.items():
            pose = arm.measured_cp().value
            if refusal := finite_pose(pose) or inside_workspace(pose.position, self._limits):
                return Verdict(False, False, refusal.code, f"the tip of {name}: {refusal.message}")
        return Verdict(True)

    def check_emergency_stop(self) -> Verdict:
        """Whether the emergency stop is free."""
        if self._bench.emergency_stop():
            return Verdict(False, True, Code.EMERGENCY_STOP, "the emergency stop is pressed")
        return Verdict(True)

    def _stale_arm(self, name: str, limit: float) -> Refusal | None:
        stamp = self._bench.arms[name].measured_cp().stamp
        if self.fresh(stamp, limit):
            return None
        return Refusal(
            Code.ARM_DATA_STALE, f"the newest position of {name} is {self._age(stamp)}; at most {limit * 1e3:.0f} ms are allowed"
        )

    def _age(self, stamp: float) -> str:
        age = self._bench.now() - stamp
        if math.isnan(age):
            return "of unknown age"
        return f"stamped {-age * 1e3:.0f} ms in the future" if age < 0 else f"{age * 1e3:.0f} ms old"
