"""What the safety gate says: its decision on each command, approvals of cuts, trips, and readings for the guards."""

from __future__ import annotations

from dataclasses import dataclass

from hardware.codes import Code


@dataclass(frozen=True)
class Decision:
    """One command with the gate's verdict, at bench time `stamp` [s].

    `command` is servo_cp, move_cp, move_jaw, hold or clear_trip. `target` is the position [m] and quaternion (7 numbers, left
    camera frame) or the jaw opening [rad]; None where there is none or where it was not finite.
    """

    stamp: float
    holder: str
    arm: str
    command: str
    accepted: bool
    code: Code
    message: str
    target: tuple[float, ...] | None


@dataclass(frozen=True)
class Approval:
    """A person's permission to cut along one goal, bound to the frame it was drawn on; bench times [s]."""

    goal_id: str
    by: str
    frame_sequence: int
    granted: float
    expires: float


@dataclass(frozen=True)
class Trip:
    """Why all motion was stopped, at bench time `stamp` [s]. Latched until a person clears it."""

    stamp: float
    code: Code
    message: str


@dataclass(frozen=True)
class Verdict:
    """A guard's reading: `latched` conditions need a person, others may pass by themselves."""

    ok: bool
    latched: bool = False
    code: Code = Code.OK
    message: str = ""


@dataclass(frozen=True)
class Refusal:
    """Why one command may not pass."""

    code: Code
    message: str
