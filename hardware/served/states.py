"""CRTK's operating states as the dVRK grants them, and its own names for what goes on inside."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from hardware.interface import OperatingState

_ALWAYS = {"disable", "unhome"}
_GRANTED = {
    OperatingState.DISABLED: _ALWAYS | {"enable"},
    OperatingState.ENABLED: _ALWAYS | {"enable", "pause", "home"},
    OperatingState.PAUSED: _ALWAYS | {"resume"},
    OperatingState.FAULT: _ALWAYS | {"enable"},
}


def granted(state: OperatingState, command: str) -> bool:
    """Whether `command` means anything in `state`; home must follow enable, and a paused arm is resumed (reference 1.1)."""
    return command in _GRANTED[state]


@dataclass(frozen=True)
class Delays:
    """How long an arm takes for what it does by itself [s]."""

    powering: float = 0.3
    engaging: float = 0.3


class Doing(StrEnum):
    """What an arm is doing, by the dVRK's own names (`desired_state`); several of them look alike from outside."""

    DISABLED = "DISABLED"
    POWERING = "POWERING"  # published as DISABLED and busy
    ENABLED = "ENABLED"
    HOMING = "HOMING"  # published as ENABLED and busy, as is ENGAGING_TOOL
    HOMED = "HOMED"  # without an instrument
    ENGAGING_TOOL = "ENGAGING_TOOL"
    TOOL_ENGAGED = "TOOL_ENGAGED"
    MANUAL = "MANUAL"  # its clutch is pressed: limp, ENABLED and busy
    PAUSED = "PAUSED"
    FAULT = "FAULT"

    @property
    def state(self) -> OperatingState:
        """As CRTK calls it."""
        if self in (Doing.DISABLED, Doing.POWERING):
            return OperatingState.DISABLED
        return OperatingState(self.value) if self in (Doing.PAUSED, Doing.FAULT) else OperatingState.ENABLED

    @property
    def passing(self) -> bool:
        """Whether the arm is busy with it."""
        return self in (Doing.POWERING, Doing.HOMING, Doing.ENGAGING_TOOL, Doing.MANUAL)
