"""The limits of the safety gate, in one place, validated once; every session writes them into its record."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from hardware.codes import InputError


@dataclass(frozen=True)
class Limits:
    """All limits of the safety gate, SI units. Forces and strains follow the porcine figures for retraction and sharp dissection.

    Raises:
        InputError: a value is not finite, not positive, or two values contradict each other.
    """

    # Box that the tool tips may not leave [m], left camera frame.
    workspace_lower: tuple[float, float, float] = (-0.090, -0.070, 0.020)
    workspace_upper: tuple[float, float, float] = (0.090, 0.070, 0.200)
    # Motion near tissue (servo_cp); move_cp is for free space.
    max_step: float = 1.0e-3  # [m], from the previous servo command
    step_tolerance: float = 0.5e-3  # [m], what the setpoint may lag behind in addition: 50 ms of latency at 10 mm/s
    max_turn: float = 0.25  # [rad], rotation away from the setpoint in one servo command
    max_speed: float = 10e-3  # [m/s], implied by successive servo commands
    max_loaded_speed: float = 5e-3  # [m/s], the same while the grasper holds tissue under load
    loaded_tension: float = 0.15  # [N], above this a closed grasper counts as holding tissue
    # Jaws
    max_jaw: float = 1.6  # [rad], full opening
    jaw_closed: float = 0.20  # [rad], at or below this the grasper counts as closed
    jaw_open: float = 0.30  # [rad], at or above this it counts as open again
    # Tools
    min_tool_distance: float = 3.0e-3  # [m], between the tips and the lines that they sweep
    # Tissue
    tension_warn: float = 2.0  # [N]
    tension_stop: float = 4.0  # [N], pulling further is refused
    tension_abort: float = 5.0  # [N], trips
    strain_warn: float = 0.30
    strain_stop: float = 0.50  # stretching further is refused; tissue fails from 0.77
    # Ages of data
    arm_stale: float = 0.1  # [s], blocks new motion
    camera_stale: float = 0.2  # [s], blocks new motion
    data_lost: float = 0.5  # [s], arm or camera: revokes the lease and holds
    # Cuts (closings of the scissors)
    max_cuts_per_approval: int = 80
    max_cuts_total: int = 240

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, tuple):
                if len(value) != 3 or not all(math.isfinite(v) for v in value):
                    raise InputError(f"limit {item.name} is {value}; it must be three finite numbers [m]")
            elif not (math.isfinite(value) and value > 0):
                raise InputError(f"limit {item.name} is {value}; it must be a finite number above 0")
        if not all(low < high for low, high in zip(self.workspace_lower, self.workspace_upper, strict=True)):
            raise InputError(
                f"limit workspace_lower {self.workspace_lower} must lie below workspace_upper {self.workspace_upper}"
            )
        for low, high in (
            ("tension_warn", "tension_stop"),
            ("tension_stop", "tension_abort"),
            ("strain_warn", "strain_stop"),
            ("jaw_closed", "jaw_open"),
            ("arm_stale", "data_lost"),
            ("camera_stale", "data_lost"),
            ("max_loaded_speed", "max_speed"),
        ):
            if getattr(self, low) > getattr(self, high):
                raise InputError(
                    f"limit {low} is {getattr(self, low)}; it must not exceed {high}, which is {getattr(self, high)}"
                )
