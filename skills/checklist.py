"""The checklist before motion: arms enabled and homed, camera fresh, limits loaded, disk space."""

import numpy as np

from hardware.codes import Code
from hardware.gate import SafetyGate
from skills.checklist_outcome import CheckOutcome
from skills.skill import Progress, Steps

PATIENCE = 12.0  # [s] for each arm to power and home (the robot allows itself two tries of 3 s)


def checklist(gate: SafetyGate, calibration: str, disk_free: float | None, least_disk: float = 2e8) -> Steps[CheckOutcome]:
    """Enable and home what is not ready, then check everything that a session needs.

    `calibration` says in words what calibration is loaded and its age; `disk_free` [bytes] is None when no record is kept.
    """
    items: list[str] = []
    bench = gate.bench
    for name, arm in bench.arms.items():
        if bench.emergency_stop():
            return CheckOutcome(Code.EMERGENCY_STOP, "the emergency stop is pressed", tuple(items))
        for command, reached in (("enable", lambda s: s.state == "ENABLED"), ("home", lambda s: s.is_homed)):
            if not reached(arm.operating_state()):
                arm.state_command(command)
            until = bench.now() + PATIENCE
            while not reached(arm.operating_state()):
                if bench.now() > until:
                    state = arm.operating_state()
                    return CheckOutcome(
                        Code.CHECKLIST, f"{name} did not {command}: it is {state.state} {state.error}".strip(), tuple(items)
                    )
                yield Progress(f"checklist: {command} {name}")
        if not np.isfinite(arm.measured_cp().value.position).all():
            return CheckOutcome(Code.CHECKLIST, f"{name} reports no finite pose", tuple(items))
        items.append(f"{name} enabled and homed")
    arms = gate.check_arms()
    if not arms.ok:
        return CheckOutcome(arms.code, arms.message, tuple(items))
    camera = gate.check_camera()
    if not camera.ok:
        return CheckOutcome(camera.code, camera.message, tuple(items))
    items += ["camera fresh", calibration, f"tension limit {gate.limits.tension_stop:.1f} N"]
    if disk_free is not None:
        if disk_free < least_disk:
            left = f"{disk_free / 1e6:.0f} MB are free for the record, {least_disk / 1e6:.0f} MB are needed"
            return CheckOutcome(Code.CHECKLIST, left, tuple(items))
        items.append(f"{disk_free / 1e9:.1f} GB free for the record")
    return CheckOutcome(Code.OK, "; ".join(items), tuple(items))
