"""Instruments of the da Vinci Classic (8 mm) as the dVRK's tool files describe them: wrist geometry and joint limits.

Joints are yaw, pitch, insertion, roll, wrist pitch, wrist yaw; the jaw is told apart. A jaw angle is the full opening between both
jaws; below 0 the motors press closed jaws together.
"""

from __future__ import annotations

import difflib
import math
from dataclasses import dataclass

import numpy as np

from hardware.codes import InputError
from hardware.interface import Array

ARM_LOWER = (-1.588, -0.925025, 0.0)  # yaw [rad], pitch [rad], insertion [m] of the Classic PSM
ARM_UPPER = (1.588, 0.925025, 0.24)


@dataclass(frozen=True)
class Instrument:
    """One instrument. `a6` [m] is the way from the wrist-pitch axis to the wrist-yaw axis; `lower`, `upper` (6,) [rad, m]."""

    name: str
    a6: float
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    jaw_lower: float  # [rad]
    jaw_upper: float  # [rad]
    has_jaw: bool = True  # False: its jaw topics exist, but must never be commanded

    def limits(self) -> tuple[Array, Array]:
        """Lower and upper joint limits, each (6,) [rad, m]."""
        return np.array(self.lower), np.array(self.upper)


def instrument(tool_type: str) -> Instrument:
    """The instrument that the dVRK calls `tool_type`, such as "POTTS_SCISSORS:400001".

    Raises:
        InputError: its geometry is not known here; the sentence names the known ones.
    """
    if tool_type in _BY_NAME:
        return _BY_NAME[tool_type]
    near = difflib.get_close_matches(str(tool_type).upper(), _BY_NAME, 1)
    hint = f"did you mean {near[0]}? " if near else ""
    raise InputError(f"the instrument {tool_type!r} is not known; {hint}known are {', '.join(sorted(_BY_NAME))}")


def _classic(
    name: str, a6: float, wrist_deg: tuple[float, float, float], jaw_deg: tuple[float, float], has_jaw: bool = True
) -> Instrument:
    """An instrument on a Classic arm; `wrist_deg`: symmetric limits of roll, wrist pitch and wrist yaw [deg]."""
    wrist = tuple(map(math.radians, wrist_deg))
    lower, upper = ARM_LOWER + tuple(-limit for limit in wrist), ARM_UPPER + wrist
    jaw = (0.0, 0.5) if not has_jaw else (math.radians(jaw_deg[0]), math.radians(jaw_deg[1]))
    return Instrument(name, a6, lower, upper, *jaw, has_jaw)


_NEEDLE_WRIST, _BIPOLAR_WRIST, _CAUTERY_WRIST = (260.0, 80.0, 80.0), (255.0, 70.0, 90.0), (260.0, 80.0, 85.0)
_NO_JAW = (0.0, 0.0)

# Classic tool files of sawIntuitiveResearchKit 9e535e6 (share/tool)
_BY_NAME = {
    one.name: one
    for one in (
        _classic("LARGE_NEEDLE_DRIVER:400006", 0.0091, _NEEDLE_WRIST, (-40.0, 80.0)),
        _classic("FENESTRATED_BIPOLAR_FORCEPS:400205", 0.0107, _BIPOLAR_WRIST, (-40.0, 80.0)),
        _classic("PROGRASP_FORCEPS:400093", 0.0107, _NEEDLE_WRIST, (-20.0, 80.0)),
        _classic("CADIERE_FORCEPS:400049", 0.0091, _NEEDLE_WRIST, (-20.0, 80.0)),
        _classic("DEBAKEY_FORCEPS:400036", 0.0091, _NEEDLE_WRIST, (-20.0, 80.0)),
        _classic("MARYLAND_BIPOLAR_FORCEPS:400172", 0.0107, _BIPOLAR_WRIST, (-20.0, 80.0)),
        _classic("POTTS_SCISSORS:400001", 0.0091, _NEEDLE_WRIST, (-40.0, 30.0)),
        _classic("ROUND_TIP_SCISSORS:400007", 0.0091, _NEEDLE_WRIST, (-40.0, 40.0)),
        _classic("CURVED_SCISSORS:400178", 0.0091, _NEEDLE_WRIST, (-20.0, 80.0)),
        _classic("MONOPOLAR_CURVED_SCISSORS:400179", 0.0091, _NEEDLE_WRIST, (-20.0, 80.0)),
        _classic("PERMANENT_CAUTERY_SPATULA:400184", 0.0093, _CAUTERY_WRIST, _NO_JAW, has_jaw=False),
        _classic("PERMANENT_CAUTERY_HOOK:400183", 0.0093, _CAUTERY_WRIST, _NO_JAW, has_jaw=False),
    )
}
