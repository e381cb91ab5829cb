"""Everything that can be made to go wrong with the served robot, by name: one set of what is in effect now.

Some faults last until they are cleared; others happen once. Those that need a second process (another publisher, another source of
commands, a master that is gone) are not here: `hardware.served.impostor` is the second node, and a master is stopped from outside.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from enum import StrEnum

from hardware.codes import InputError


class Fault(StrEnum):
    """One fault. The first groups concern an arm, the others the whole robot."""

    # Commands
    NOT_READY = "not_ready"  # motions are rejected with a warning
    LOST_COMMANDS = "lost_commands"  # nothing that is sent arrives
    IK_FAILURE = "ik_failure"  # no inverse kinematics are found
    # Telemetry
    SILENT = "silent"  # the robot's computer died: no message, no obedience, power cut by the watchdog
    FROZEN = "frozen"  # the same values with fresh stamps
    STAMP_ZERO = "stamp_zero"  # the robot calls its data invalid
    STAMP_STALE = "stamp_stale"  # stamps stand still
    NAN_POSE = "nan_pose"
    NON_UNIT_QUATERNION = "non_unit_quaternion"
    # Set-up
    FRAME_ID = "frame_id"  # poses come in another frame
    BASE_JUMP = "base_jump"  # the base frame moved by 5 mm
    TOOL_REMOVED = "tool_removed"  # 7 actuators instead of 6 joints, no pose
    TOOL_CHANGED = "tool_changed"  # another instrument's name
    # Somebody else
    CLUTCH = "clutch"  # the arm's clutch is pressed: limp and busy
    FOREIGN_SERVO = "foreign_servo"  # the setpoint moves without a command
    # Jaw
    JAW_BLOCKED = "jaw_blocked"  # tissue keeps it open
    # Once
    BUSY_PULSE = "busy_pulse"  # busy and not busy, for no reason of ours
    INTERRUPT = "interrupt"  # the motion under way ends with goal_reached false
    FAULT_TRACKING = "fault_tracking"
    FAULT_POWER = "fault_power"
    FAULT_WATCHDOG = "fault_watchdog"
    JAW_SLIPS = "jaw_slips"  # the tissue is lost and the jaw falls shut
    JAW_STALE_GOAL = "jaw_stale_goal"  # the next move takes the jaw along to where it was once sent: open
    LATCHED_ERROR = "latched_error"  # an old text for whoever connects later
    # The robot's computer and the console
    CLOCK_AHEAD = "clock_ahead"  # by 5 s
    CLOCK_BEHIND = "clock_behind"
    EMERGENCY_STOP = "emergency_stop"  # pressed
    TELEOP_FOLLOWING = "teleop_following"
    TELEOP_ENABLED = "teleop_enabled"
    OPERATOR_ABSENT = "operator_absent"
    ENDOSCOPE_MOVED = "endoscope_moved"
    # Camera
    EYE_MISSING = "eye_missing"
    SKEWED_STAMPS = "skewed_stamps"  # of the two eyes, by 50 ms
    ZERO_K = "zero_k"  # not calibrated
    CAMERA_STOPPED = "camera_stopped"


_NAMES = list(Fault)
ONCE = frozenset(_NAMES[_NAMES.index(Fault.BUSY_PULSE) : _NAMES.index(Fault.CLOCK_AHEAD)])
OF_ROBOT = frozenset(_NAMES[_NAMES.index(Fault.CLOCK_AHEAD) :])

OLD_ERROR = "unable to solve inverse kinematics (this was yesterday)"
FAULT_TEXTS = {
    Fault.FAULT_TRACKING: "tracking error, mask (1 for error): [0, 0, 1, 0, 0, 0, 0]",
    Fault.FAULT_POWER: "detected power loss (actuators)",
    Fault.FAULT_WATCHDOG: "IO: watchdog triggered",
}


class Faults:
    """What is in effect, by arm. Who injects and who asks share the bench's lock."""

    def __init__(self, arms: Iterable[str]) -> None:
        self._arms = tuple(arms)
        self._on: set[tuple[Fault, str]] = set()

    def on(self, fault: Fault, arm: str = "") -> bool:
        """Whether `fault` is in effect, on `arm` where it is an arm's."""
        return (fault, arm) in self._on

    def active(self) -> list[str]:
        """What is in effect, as "name" or "name arm", sorted."""
        return sorted(f"{fault} {arm}".strip() for fault, arm in self._on)

    def lasting(self) -> list[tuple[Fault, tuple[str, ...]]]:
        """What is in effect, in the form that `read` gives."""
        return [(fault, (arm,)) for fault, arm in sorted(self._on)]

    def begin(self, fault: Fault, arms: tuple[str, ...]) -> None:
        """Put a lasting fault in effect."""
        self._on |= {(fault, arm) for arm in arms}

    def end(self, fault: Fault, arms: tuple[str, ...]) -> None:
        """End it."""
        self._on -= {(fault, arm) for arm in arms}

    def read(self, name: str, arm: str) -> tuple[Fault, tuple[str, ...]]:
        """The fault called `name`, and whom it concerns: `arm`, all arms if that is empty, and ("",) for one of the whole robot.

        Raises:
            InputError: there is no such fault or arm.
        """
        if name not in _NAMES:
            near = difflib.get_close_matches(name, _NAMES, 1)
            hint = f"did you mean {near[0]}? " if near else ""
            raise InputError(f"there is no fault {name!r}; {hint}the faults are {', '.join(Fault)}")
        fault = Fault(name)
        if arm and arm not in self._arms:
            raise InputError(f"there is no arm {arm!r}; the arms are {', '.join(self._arms)}")
        if fault in OF_ROBOT:
            if arm:
                raise InputError(f"the fault {name} concerns the whole robot, not {arm}; leave the arm out")
            return fault, ("",)
        return fault, ((arm,) if arm else self._arms)
